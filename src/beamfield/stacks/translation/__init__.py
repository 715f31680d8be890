"""Translate parameters from one stack to another."""
