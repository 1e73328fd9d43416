"""Scale factor and bias of a fibre gyro over a temperature ramp."""
