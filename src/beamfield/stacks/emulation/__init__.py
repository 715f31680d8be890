"""What all emulators share: the interface, the reading of the map, rays and distances."""
