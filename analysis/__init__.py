"""Mathematics of the lock-in measurement, on arrays."""
