"""The channel between photodiode and converter, as the settings describe it, taken out of the records."""

from __future__ import annotations

import math
from dataclasses import replace

from analysis import LockInEstimate
from analysis.front_end import ChannelResponse, correct_response
from station.errors import RunError
from station.settings_sections import FrontEndSettings


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
    return replace(corrected, noise_model=f"{each.noise_model}; corrected for the response of the channel")
