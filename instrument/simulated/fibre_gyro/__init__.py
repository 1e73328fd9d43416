"""A fibre gyro on a serial line, simulated."""
