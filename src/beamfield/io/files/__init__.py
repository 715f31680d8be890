"""Shared by all formats: atomic files, lines, rows, YAML."""
