"""The calibration report: figures and one HTML page."""
