"""Worlds, drives and logs whose truth is known."""
