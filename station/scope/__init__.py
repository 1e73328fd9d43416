"""What every measurement does with an oscilloscope."""
