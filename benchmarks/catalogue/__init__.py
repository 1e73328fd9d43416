"""How long `gyrolock runs` takes for many runs."""
