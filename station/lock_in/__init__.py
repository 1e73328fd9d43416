"""Measurement 1: the lock-in rate of a ring laser gyro."""
