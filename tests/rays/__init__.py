"""Adversarial rays against an exact traversal: `make rays`."""
