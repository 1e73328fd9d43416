"""The commands of the simulated oscilloscope, one file a family."""
