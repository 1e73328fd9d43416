"""What is known of the lock-in rate from one or many records."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from html import escape
from typing import Any

import numpy as np

from analysis.arrays import Bools, Complexes, Floats, Indices, Ints
from analysis.flags import FATAL, flag_names
from analysis.lockin_equation import Relation


@dataclass(frozen=True, repr=False)
class LockInEstimate:
    """Estimates of one or many records; every array has the leading shape of the records.

    lock_in_rate, lock_in_rate_u : deg/s, and its standard uncertainty
    lock_in_rate_low_95, lock_in_rate_high_95 : deg/s, 95 % interval; not symmetric, and it begins at 0 where the
        second harmonic does not stand out of the noise
    input_rate : deg/s, as given (signed), or from the record itself: W = (f/K)(1 + r^2)/(1 - r^2)
    beat_frequency, beat_frequency_u : Hz
    ratio, ratio_u : r = A2/A1, freed of the bias that noise gives to the size of a small complex number
    misfit_u : what the u of the ratio holds that is no noise: what the residual, and the parts of the record, show
    complex_ratio : rho = c2 |c1| / c1^2, independent of the time origin
    complex_ratio_covariance : (..., 2, 2) of its real and imaginary part, from noise alone
    backscatter_phase : rad, beta less the readout phase
    amplitude, noise_rms : volts, A of A sin(phi), and the standard deviation of what the fit leaves
    third_harmonic, third_harmonic_u : third harmonic beyond that of the lock-in waveform, over the amplitude, its
        phase referred to three times the fundamental's: third-order distortion; u of either part, inf: not known
    periods : beat periods in the record
    records, records_rejected : how many records the value rests on, and how many could not be used
    flags : bits of `Flag`
    noise_model : what the uncertainties rest on, in words
    """

    lock_in_rate: Floats
    lock_in_rate_u: Floats
    lock_in_rate_low_95: Floats
    lock_in_rate_high_95: Floats
    input_rate: Floats
    beat_frequency: Floats
    beat_frequency_u: Floats
    ratio: Floats
    ratio_u: Floats
    misfit_u: Floats
    complex_ratio: Complexes
    complex_ratio_covariance: Floats
    backscatter_phase: Floats
    amplitude: Floats
    noise_rms: Floats
    third_harmonic: Complexes
    third_harmonic_u: Floats
    periods: Floats
    records: Ints
    records_rejected: Ints
    flags: Ints
    scale_factor: float
    relation: Relation
    rate_given: bool
    noise_model: str

    def __getitem__(self, key: int | slice | Bools | Indices) -> LockInEstimate:
        """Some of the records; indexes the leading axes of every field."""
        picked = {f.name: getattr(self, f.name) for f in fields(self)}
        for name, value in picked.items():
            if isinstance(value, np.ndarray):
                picked[name] = np.asarray(value[key])
        return LockInEstimate(**picked)

    def reshaped(self, *shape: int) -> LockInEstimate:
        """The same records in another leading shape."""
        changed = {f.name: getattr(self, f.name) for f in fields(self)}
        inner = self.flags.ndim
        for name, value in changed.items():
            if isinstance(value, np.ndarray):
                changed[name] = value.reshape((*shape, *value.shape[inner:]))
        return LockInEstimate(**changed)

    def changed(self, change: Callable[[LockInEstimate, slice], LockInEstimate]) -> LockInEstimate:
        """The records (n,) as a function makes others of them, which is told which ones it is given."""
        return change(self, slice(0, len(self)))

    def described(self, noise_model: str) -> LockInEstimate:
        """The same records, with other words on what their uncertainties rest on."""
        return replace(self, noise_model=noise_model)

    @property
    def usable(self) -> Bools:
        """Where a lock-in rate could be given at all."""
        return np.asarray((self.flags & int(FATAL)) == 0)

    def plot(self, axes: Any = None) -> Any:
        """Draw the lock-in rate of every record with Matplotlib, into `axes` or a new figure; returns the axes."""
        if axes is None:
            import matplotlib.pyplot as plt

            _, axes = plt.subplots()
        values, u = self.lock_in_rate.ravel(), self.lock_in_rate_u.ravel()
        axes.errorbar(np.arange(values.size) + 1, values, u, fmt="o", capsize=2.5)
        axes.set(xlabel="record", ylabel="lock-in rate / deg/s")
        return axes

    def __len__(self) -> int:
        return len(self.flags)

    def __repr__(self) -> str:
        of = f" of {' x '.join(map(str, self.flags.shape))} records" if self.flags.ndim else ""
        known = np.isfinite(self.lock_in_rate)
        ends = np.sort(self.lock_in_rate[known])[:: max(1, int(known.sum()) - 1)]
        u = f" deg/s, u {np.median(self.lock_in_rate_u[known]):.2g}" if ends.size else "no lock-in rate"
        flags = ", ".join(flag_names(int(np.bitwise_or.reduce(self.flags, axis=None)))) or "no flags"
        return f"<LockInEstimate{of}: {' to '.join(f'{end:.6g}' for end in ends)}{u}; {flags}>"

    def _repr_html_(self) -> str:
        first = self.reshaped(-1)[:20]
        rows = [["lock-in rate, deg/s", "u, deg/s", "beat, Hz", "flags"]]
        columns = (first.lock_in_rate, first.lock_in_rate_u, first.beat_frequency, first.flags)
        for *values, flags in zip(*columns, strict=True):
            rows.append([*(f"{value:.6g}" for value in values), ", ".join(flag_names(flags))])
        cells = "".join(f"<tr><td>{'</td><td>'.join(row)}</td></tr>" for row in rows)
        return f"<table><caption>{escape(repr(self))}</caption>{cells}</table>"
