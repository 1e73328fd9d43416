"""A batch of saved records to estimates, one row a record: the same numbers whatever the batch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis import LockInEstimate, estimate_lock_in
from analysis.lock_in_run import Batch, Method
from instrument.facts import HIGHEST_CODE, NO_DATA
from station.sources.batches import RecordBatch

_IN_CACHE = 16
"""Records of 2500 samples that are 0.3 MB as volts."""

# name of the column: field of the estimate, and what of it
COLUMNS: Mapping[str, tuple[str, Any]] = {
    "lock_in_rate_dps": ("lock_in_rate", None),
    "lock_in_rate_noise_u_dps": ("lock_in_rate_u", None),
    "lock_in_rate_noise_low_95_dps": ("lock_in_rate_low_95", None),
    "lock_in_rate_noise_high_95_dps": ("lock_in_rate_high_95", None),
    "input_rate_dps": ("input_rate", None),
    "beat_frequency_hz": ("beat_frequency", None),
    "beat_frequency_u_hz": ("beat_frequency_u", None),
    "ratio": ("ratio", None),
    "ratio_u": ("ratio_u", None),
    "ratio_misfit_u": ("misfit_u", None),
    "complex_ratio_re": ("complex_ratio", np.real),
    "complex_ratio_im": ("complex_ratio", np.imag),
    "complex_ratio_var_re": ("complex_ratio_covariance", lambda c: c[:, 0, 0]),
    "complex_ratio_cov_re_im": ("complex_ratio_covariance", lambda c: c[:, 0, 1]),
    "complex_ratio_var_im": ("complex_ratio_covariance", lambda c: c[:, 1, 1]),
    "backscatter_phase_rad": ("backscatter_phase", None),
    "amplitude_v": ("amplitude", None),
    "noise_rms_v": ("noise_rms", None),
    "third_harmonic_re": ("third_harmonic", np.real),
    "third_harmonic_im": ("third_harmonic", np.imag),
    "third_harmonic_u": ("third_harmonic_u", None),
    "periods": ("periods", None),
    "flag_bits": ("flags", None),
}


def batch_arrays(batch: RecordBatch, room: NDArray[np.float64] | None = None) -> Batch:
    """Volts and clipped samples of a batch; all its records must have one time base."""
    codes, wide = batch.codes, batch.codes.dtype != np.int8
    highest = HIGHEST_CODE * 256 if wide else HIGHEST_CODE
    clipped = (codes >= highest) | (codes <= -highest)
    volts = _volts(batch, room)
    if not wide:
        blank = codes == NO_DATA
        if blank.any():
            volts[blank] = np.nan
            clipped &= ~blank
    rows = np.arange(len(batch))
    return Batch(rows, batch.sample_interval, volts[np.newaxis], clipped[np.newaxis])


def _volts(batch: RecordBatch, room: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """(code - YOFF) YMULT + YZERO, some records at a time: they stay in the processor's cache meanwhile."""
    fits = room is not None and room.shape[1:] == batch.codes.shape[1:] and len(room) >= len(batch)
    volts = room[: len(batch)] if room is not None and fits else np.empty(batch.codes.shape)
    # one number for all rows is quicker than one for each, and most batches have one preamble
    alike = all(preamble is batch.preambles[0] for preamble in batch.preambles)
    preambles = batch.preambles[:1] if alike else batch.preambles
    yoff, ymult, yzero = (
        np.array([getattr(preamble, name) for preamble in preambles])[:, np.newaxis]
        for name in ("yoff", "ymult", "yzero")
    )
    for first in range(0, len(batch), _IN_CACHE):
        rows = slice(first, first + _IN_CACHE)
        of = slice(None) if alike else rows
        some = volts[rows]
        some[...] = batch.codes[rows]
        some -= yoff[of]
        some *= ymult[of]
        if yzero.any():
            some += yzero[of]
    return volts


def estimate_batch(batch: RecordBatch, method: Method, room: NDArray[np.float64] | None = None) -> LockInEstimate:
    """Estimate every record of a batch by itself."""
    arrays = batch_arrays(batch, room)
    return estimate_lock_in(
        arrays.volts[0],
        arrays.sample_interval,
        scale_factor=method.scale_factor,
        input_rate=method.input_rate,
        relation=method.relation,
        clipped=arrays.clipped[0],
        nan_policy="omit",
    )


def columns_of(estimate: LockInEstimate) -> dict[str, NDArray[Any]]:
    """Return estimates (n,) as columns, units in their names; :func:`estimate_of` is the way back."""
    return {
        name: np.ascontiguousarray(getattr(estimate, field) if part is None else part(getattr(estimate, field)))
        for name, (field, part) in COLUMNS.items()
    }
