"""Figures of merit of a fibre gyro's scale factor."""
