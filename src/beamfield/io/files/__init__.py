"""What all formats share: whole files, lines, rows, YAML."""
