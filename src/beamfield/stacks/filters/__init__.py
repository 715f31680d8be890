"""The particle filters of the stacks as they are, for replaying logs."""
