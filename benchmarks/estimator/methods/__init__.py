"""The methods compared, in the order of the tables."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from benchmarks.estimator.methods.fft_peaks import read_peaks
from benchmarks.estimator.methods.general_fit import fit_curve
from benchmarks.estimator.methods.ours import estimate
from benchmarks.estimator.methods.reading import Floats, Reading, exact, formula_13
from benchmarks.estimator.methods.sine_fits import fit_two_harmonics, fit_two_tones

__all__ = ["METHODS", "OURS", "Method", "Reading"]

OURS = "gyrolock"


@dataclass(frozen=True)
class Method:
    """A way to read a lock-in rate from a record.

    read takes codes (R, N) and the table's rate |W| (R,), which only formula (13) uses; at_most bounds the number
    of records for a slow one.
    """

    name: str
    read: Callable[[Floats, Floats], Reading]
    at_most: int


METHODS = (
    Method(OURS, estimate, 10**9),
    Method("FFT peaks, rectangular, (13) [the paper]", partial(read_peaks, "boxcar", formula_13), 20_000),
    Method("FFT peaks, rectangular, exact relation", partial(read_peaks, "boxcar", exact), 20_000),
    Method("FFT peaks, Hann, (13)", partial(read_peaks, "hann", formula_13), 20_000),
    Method("FFT peaks, Hann, exact relation", partial(read_peaks, "hann", exact), 20_000),
    Method("FFT peaks, flat-top, (13)", partial(read_peaks, "flattop", formula_13), 20_000),
    Method("FFT peaks, flat-top, exact relation", partial(read_peaks, "flattop", exact), 20_000),
    Method("two sine fits (IEEE 1057), exact relation", fit_two_tones, 2_000),
    Method("sine fit with second harmonic, exact relation", fit_two_harmonics, 2_000),
    Method("scipy curve_fit, the same six parameters", fit_curve, 600),
)
