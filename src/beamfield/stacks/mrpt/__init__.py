"""MRPT's likelihood models."""
