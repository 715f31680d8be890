"""What is wrong with a parameter file, and what to do about it."""
