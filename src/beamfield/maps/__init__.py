"""Maps (section 6.2) and what is computed from them."""
