"""Digital closed-loop fibre gyro: its scale factor by rate table and by injected staircase, and its simulation."""
