"""Showing a result: page, figures, terminal."""
