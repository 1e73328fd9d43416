"""Byte streams and VISA sessions that lead to the simulated oscilloscope."""
