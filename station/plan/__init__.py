"""Planning a measurement."""
