"""Scale factor of a fibre gyro on the bench: by rate table, by injected staircase, and its figures of merit."""
