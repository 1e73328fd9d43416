"""Propagation of distributions through the whole measurement: the check of a budget by simulation."""

from benchmarks.monte_carlo.propagation import MonteCarlo, simulate_measurements

__all__ = ["MonteCarlo", "simulate_measurements"]
