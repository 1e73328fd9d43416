"""The modulator's staircase, seen by the oscilloscope."""
