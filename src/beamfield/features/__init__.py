"""Features from scans (6.6.1): few numbers (range, bearing, signature) with a covariance instead of many ranges."""
