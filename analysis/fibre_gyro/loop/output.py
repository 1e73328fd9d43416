"""What a fibre gyro gives: output words, and a trace of its staircase and detector signal."""

from __future__ import annotations

from dataclasses import dataclass

from analysis.arrays import Bools, Floats, Ints


@dataclass(frozen=True)
class OutputBlock:
    """Consecutive output words; shape (n,), or (runs, n) of several gyros side by side.

    Attributes
    ----------
    times_s : ndarray, shape (n,)
        End of each output period since the start of the gyro.
    counts : ndarray
        Mean feedback step over the period with its sign reversed, codes each transit time.
    normal_error, reset_error : ndarray
        Mean demodulated error, counts of the detector's converter, of the sample pairs without and with a 2 pi
        reset; nan where there was none.
    reset_pairs : ndarray of int
        Number of sample pairs with a reset.
    """

    times_s: Floats
    interval_s: float
    counts: Floats
    normal_error: Floats
    reset_error: Floats
    reset_pairs: Ints


@dataclass(frozen=True)
class Trace:
    """The signals of one gyro at every transit time; shape (n,) each.

    Attributes
    ----------
    times_s : ndarray
        Since the start of the gyro.
    staircase : ndarray of int
        The staircase in whole codes, without the bias.
    code : ndarray of int
        What the converter gets: staircase and bias.
    modulator_rad : ndarray
        Phase of the modulator, with the errors of converter and 2 pi voltage, without a second electrode.
    difference_rad : ndarray
        Phase difference of the two beams: Sagnac phase and modulator now less modulator one transit time ago.
    intensity : ndarray
        At the detector without noise; 1 is the peak of the fringe.
    adc : ndarray of int
        As converted, with noise.
    reset : ndarray of bool
        The staircase or the code wrapped since the sample before.
    """

    times_s: Floats
    staircase: Ints
    code: Ints
    modulator_rad: Floats
    difference_rad: Floats
    intensity: Floats
    adc: Ints
    reset: Bools
