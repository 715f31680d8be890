"""The smallest valid example of every format that beamfield reads, made by code."""
