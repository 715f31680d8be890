"""The syntaxes of parameter files: YAML, launch files and ini files, with the places of values in their text."""
