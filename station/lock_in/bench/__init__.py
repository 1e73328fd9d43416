"""The bench of the ring laser gyro: real or simulated."""
