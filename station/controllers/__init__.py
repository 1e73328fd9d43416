"""Rate table, temperature chamber and power supply that a bench is driven by, each described by a template."""
