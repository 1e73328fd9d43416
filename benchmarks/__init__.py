"""Measurements of what the programs reach; each is one command, `python -m benchmarks.<name>`."""
