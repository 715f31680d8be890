"""Read and write stacks' parameter files."""
