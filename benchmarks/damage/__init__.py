"""Damaged files, and calls that fail."""
