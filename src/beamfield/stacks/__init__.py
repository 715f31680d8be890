"""Other programs' measurement models: their formulas, parameter names and files."""
