"""The ring laser gyro on its bench, real or simulated: what all measurements of it share."""
