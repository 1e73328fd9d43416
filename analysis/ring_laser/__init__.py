"""A simulated ring laser gyro on a turning table: its beat, and what detector and bench add to it."""

from analysis.ring_laser.detector import (
    Detector,
    NoisySignal,
    beat_signal_on_table,
    detector_signal,
    mean_beat_on_table,
    signal_above,
    signal_bounds,
    smooth_interval,
)
from analysis.ring_laser.gyro import Dither, DitheredFringe, Gyro, axis_rate_on_table, beat_phase_on_table
from analysis.two_mode_laser import SteadyBeat, TwoModeLaser, Winking, steady_beat, symmetric_laser
