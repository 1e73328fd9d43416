"""Results of a fibre gyro as constants of its own logic: VHDL, C and CSV text."""
