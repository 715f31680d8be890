"""Fit a stack's parameters in its own formula."""
