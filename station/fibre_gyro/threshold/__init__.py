"""Threshold, resolution and dead zone of a fibre gyro."""
