"""Files of occupancy grids."""
