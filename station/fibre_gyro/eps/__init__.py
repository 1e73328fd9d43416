"""2 pi error of a fibre gyro's modulator, in open loop."""
