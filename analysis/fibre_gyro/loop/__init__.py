"""The digital closed loop of a fibre gyro, at every transit time or by its output words."""
