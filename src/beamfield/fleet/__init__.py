"""Many robots and many logs: a catalogue of beams in Parquet, and work on it by Dask. Needs the extra ``fleet``."""
