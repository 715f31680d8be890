"""Read and write files: formats, no algorithms."""
