"""Saved records through the estimator, batch by batch."""
