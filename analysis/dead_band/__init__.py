"""Search for the dead band of a ring laser: edges of the band without pulses, and the corner as a whole."""

from analysis.dead_band.corner_fit import COUNTED_U
from analysis.dead_band.edges import DeadBand, DeadBandFlag, find_dead_band
from analysis.dead_band.noisy_corner import falling, rounded_pulse_rate, simulate_sweep

__all__ = [
    "COUNTED_U",
    "DeadBand",
    "DeadBandFlag",
    "falling",
    "find_dead_band",
    "rounded_pulse_rate",
    "simulate_sweep",
]
