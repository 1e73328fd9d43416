"""Rate-table run of a fibre gyro."""
