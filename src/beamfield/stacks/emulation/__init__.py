"""Shared by all emulators: the interface, the reading of the map, rays and distances."""
