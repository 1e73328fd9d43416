"""The harmonics of a single record, also where they are none of a gyro."""

from __future__ import annotations

import numpy as np

from analysis import fit_harmonics
from instrument import Waveform


def harmonics_of(waveform: Waveform, count: int = 5) -> list[dict[str, float]] | None:
    """Return frequency, amplitude and phase of the harmonics of a record; ``None`` if it has none.

    Returns
    -------
    list of dict or None
        ``order``, ``frequency_hz``, ``amplitude_v``, ``phase_rad`` (at the first sample).
    """
    if np.nanmax(waveform.volts) == np.nanmin(waveform.volts):
        return None
    fit = fit_harmonics(waveform.volts, waveform.sample_interval, harmonics=count, nan_policy="omit")
    if not np.isfinite(fit.frequency):
        return None
    return [
        {
            "order": order,
            "frequency_hz": order * float(fit.frequency),
            "amplitude_v": float(np.abs(amplitude)),
            "phase_rad": float(np.angle(amplitude)),
        }
        for order, amplitude in enumerate(fit.amplitudes, start=1)
    ]
