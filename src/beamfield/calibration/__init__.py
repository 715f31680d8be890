"""Learn measurement models from logs: algorithms, no files."""
