"""beamfield's own files of model parameters."""
