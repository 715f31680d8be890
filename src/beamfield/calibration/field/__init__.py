"""Learn the likelihood field: its density along the axis of a beam, and how much its beams count."""
