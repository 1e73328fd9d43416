"""Which description of frames fits a gyro: ``gyrolock fog sniff``, and the descriptions that are known."""
