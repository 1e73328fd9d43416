"""The commands of ``gyrolock``, one module each."""
