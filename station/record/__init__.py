"""The record of a test: one file that says everything, readable by other programs, and what proves it."""
