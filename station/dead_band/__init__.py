"""Measurement: the dead band of a ring laser gyro, by a sweep of the rate through zero."""
