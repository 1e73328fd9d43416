"""Saved runs: keeping what was taken, whatever happens."""
