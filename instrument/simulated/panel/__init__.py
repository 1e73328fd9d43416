"""The settings of the simulated oscilloscope as such, and the language they are set in."""
