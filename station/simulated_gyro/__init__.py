"""A simulated ring laser gyro on a turning table: its beat, and what detector and bench add to it.

`motion` the table, `gyro` the fringes at a given rate, `winking` those of a laser with slow gain, `beat` the phase
over time, `detector` the volts with distortion and filters, `signals` the whole as functions of absolute time.
"""

from station.simulated_gyro.beat import axis_rate_on_table, beat_phase_on_table
from station.simulated_gyro.detector import Detector, detector_signal
from station.simulated_gyro.gyro import Gyro, harmonic_ratio
from station.simulated_gyro.motion import Segment
from station.simulated_gyro.signals import beat_signal_on_table, with_detector_noise
from station.simulated_gyro.winking import Winking

__all__ = [
    "Detector",
    "Gyro",
    "Segment",
    "Winking",
    "axis_rate_on_table",
    "beat_phase_on_table",
    "beat_signal_on_table",
    "detector_signal",
    "harmonic_ratio",
    "with_detector_noise",
]
