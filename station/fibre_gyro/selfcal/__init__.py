"""Self-calibration of a fibre gyro by an injected staircase."""
