"""Logs of scans in text formats."""
