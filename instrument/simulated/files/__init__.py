"""Files that the simulated oscilloscope writes: memory card, waveforms, pictures."""
