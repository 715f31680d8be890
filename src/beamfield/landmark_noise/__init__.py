"""Learn the noise of a landmark sensor from sightings with true poses (6.6.2)."""
