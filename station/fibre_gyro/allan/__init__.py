"""Noise model of a fibre gyro at rest."""
