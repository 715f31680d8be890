"""Files of landmarks, lines, and what robots saw of them."""
