"""Learn the intrinsic parameters of the beam model: 6.3.2, 6.3.3."""
