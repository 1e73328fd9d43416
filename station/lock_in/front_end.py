"""The channel between photodiode and converter, as the settings describe it, taken out of the records."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from analysis import LockInEstimate, fit_harmonics
from analysis.channel import ChannelResponse, correct_response
from station.errors import RunError
from station.lock_in.settings import FrontEndSettings

Array = NDArray[np.float64]
_HARMONICS = 5


def channel_response(front_end: FrontEndSettings) -> ChannelResponse | None:
    """Return the response that the settings describe.

    Parameters
    ----------
    front_end : FrontEndSettings

    Returns
    -------
    ChannelResponse or None
        ``None`` if there is nothing to correct. Without uncertainties: what all records share does not average
        out, so it stands in the budget and not with each record.
    """
    if not (front_end.low_pass_hz or front_end.ac_corner_hz or front_end.response):
        return None
    return ChannelResponse(
        low_pass_hz=[front_end.low_pass_hz] if front_end.low_pass_hz else [],
        high_pass_hz=[front_end.ac_corner_hz] if front_end.ac_corner_hz else [],
        table_hz=[row[0] for row in front_end.response],
        table_gain=[row[1] for row in front_end.response],
        table_phase_rad=[math.radians(row[2]) for row in front_end.response],
    )


def without_channel(each: LockInEstimate, response: ChannelResponse) -> LockInEstimate:
    """Return the estimates that the records would have given without the channel.

    Parameters
    ----------
    each : LockInEstimate
        Fields of shape (n,).
    response : ChannelResponse

    Returns
    -------
    LockInEstimate

    Raises
    ------
    RunError
        If a beat or its second harmonic lies outside a measured table.
    """
    try:
        corrected = correct_response(each, response)
    except ValueError as error:
        raise RunError(f"front_end.response: {error}") from None
    return replace(corrected, noise_model=noise_model_without_channel(each))


def noise_model_without_channel(each: LockInEstimate) -> str:
    """Say what the uncertainties rest on, and that the channel is taken out."""
    return f"{each.noise_model}; corrected for the response of the channel"


def equalised(volts: Array, sample_interval: float, response: ChannelResponse) -> Array:
    """Give the harmonics of records the size and phase that they had before the channel; noise stays as it is.

    For two channels that are corrected with each other: distortion arises before the filters, and is a real share
    of the beat only there.

    Parameters
    ----------
    volts : ndarray, shape (n_records, n_samples)
    sample_interval : float
        s.
    response : ChannelResponse

    Returns
    -------
    ndarray, shape (n_records, n_samples)
        Records without a beat come back as they are.

    Raises
    ------
    RunError
        If a beat or its second harmonic lies outside a measured table.
    """
    fit = fit_harmonics(volts, sample_interval, harmonics=_HARMONICS, nan_policy="omit")
    beating = np.isfinite(fit.frequency)
    frequency = np.where(beating, fit.frequency, 1.0)
    times, restored = np.arange(volts.shape[-1]) * sample_interval, volts.copy()
    for order in range(1, _HARMONICS + 1):
        inside = beating & response.reach(order * frequency)
        if order <= 2 and not np.all(inside | ~beating):
            raise RunError(
                f"front_end.response: {order * frequency[beating & ~inside][0]:.6g} Hz lies outside the table"
            )
        gain = np.ones(frequency.shape, dtype=np.complex128)
        gain[inside] = response.at(order * frequency[inside])
        change = np.where(inside, fit.amplitudes[..., order - 1] * (1 / gain - 1), 0.0)
        turns = 2 * np.pi * order * frequency[:, np.newaxis] * times
        restored += (change[:, np.newaxis] * np.exp(1j * turns)).real
    return restored
