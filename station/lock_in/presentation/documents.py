"""The result as the JSON document holds it, with the names that programs rely on."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from analysis import FrequencyFit, LockInEstimate, RatesFit, RatesFlag, flag_names
from analysis.frequency_method import FrequencyFlag
from analysis.lock_in_run import RateGroup
from station.lock_in.found import LockInFound, describe_method
from station.lock_in.presentation.budget_table import budget_document
from station.lock_in.presentation.rates_sentences import describe_frequencies, describe_rates
from station.lock_in.presentation.table_sentences import table_sentences
from station.results.as_json import picked

_AT_ONCE = 2000
"""Records whose documents are made together."""

# name in JSON: field of the estimate. What belongs to one rate alone is null in a run at several.
_OF_ONE_RATE = {
    "input_rate_dps": "input_rate",
    "beat_frequency_hz": "beat_frequency",
    "beat_frequency_u_hz": "beat_frequency_u",
    "ratio": "ratio",
    "ratio_u": "ratio_u",
}
_OF_ALL = {
    "backscatter_phase_rad": "backscatter_phase",
    "amplitude_v": "amplitude",
    "noise_rms_v": "noise_rms",
}
_TABLE_CHECK = {
    "lock_in_rate_dps": "lock_in_rate",
    "lock_in_rate_u_dps": "lock_in_rate_u",
    "input_rate_dps": "input_rate",
    "beat_over_table": "beat_over_table",
    "beat_over_table_u": "beat_over_table_u",
    "p_value": "p_value",
    "p_value_by_all": "p_value_by_all",
    "lock_in_rate_by_frequencies_dps": "by_frequencies",
    "lock_in_rate_by_frequencies_u_dps": "by_frequencies_u",
    "least_error_seen": "least_error_seen",
}
_SCALE_FACTOR = {
    "by": "by",
    "scale_factor_pulses_per_deg": "scale_factor",
    "scale_factor_u_pulses_per_deg": "scale_factor_u",
    "p_value": "p_value",
}
_FIT = {
    "lock_in_rate_dps": "lock_in_rate",
    "lock_in_rate_u_dps": "lock_in_rate_u",
    "lock_in_rate_low_95_dps": "lock_in_rate_low_95",
    "lock_in_rate_high_95_dps": "lock_in_rate_high_95",
    "chi_square": "chi_square",
    "degrees_of_freedom": "degrees_of_freedom",
    "p_value": "p_value",
}
_RATES_FIT = _FIT | {
    "backscatter_phase_rad": "backscatter_phase",
    "backscatter_phase_u_rad": "backscatter_phase_u",
    "distortion": "distortion",
    "distortion_u": "distortion_u",
    "gain_corner_hz": "gain_corner_hz",
    "gain_corner_low_95_hz": "gain_corner_low_95_hz",
    "gain_corner_high_95_hz": "gain_corner_high_95_hz",
    "bandwidth_hz": "bandwidth_hz",
    "bandwidth_low_95_hz": "bandwidth_low_95_hz",
    "third_order": "third_order",
    "third_order_u": "third_order_u",
    "scale_factor_by_rates_pulses_per_deg": "scale_factor",
    "scale_factor_by_rates_u_pulses_per_deg": "scale_factor_u",
    "model": "model",
    "u_over_u_with_distortion_known": "cost",
}
_MODEL = {
    "model": "model",
    "lock_in_rate_dps": "lock_in_rate",
    "lock_in_rate_u_dps": "lock_in_rate_u",
    "chi_square": "chi_square",
    "degrees_of_freedom": "degrees_of_freedom",
}
_FREQUENCY_FIT = _FIT | {
    "scale_factor_pulses_per_deg": "scale_factor",
    "scale_factor_u_pulses_per_deg": "scale_factor_u",
    "bias_rate_dps": "bias_rate",
    "bias_rate_u_dps": "bias_rate_u",
}
_ALTERNATIVE = {
    "lock_in_rate_dps": "lock_in_rate",
    "lock_in_rate_u_dps": "lock_in_rate_u",
    "distortion": "distortion",
    "chi_square": "chi_square",
}
_LEFT_OUT = {
    "input_rate_dps": "rate",
    "lock_in_rate_dps": "lock_in_rate",
    "lock_in_rate_u_dps": "lock_in_rate_u",
    "deviation_in_u": "deviation",
    "p_value": "p_value",
}
_GROUP = {
    "input_rate_dps": "input_rate",
    "beat_frequency_hz": "beat_frequency",
    "ratio": "ratio",
    "ratio_u": "ratio_u",
    "lock_in_rate_dps": "lock_in_rate",
    "lock_in_rate_noise_u_dps": "lock_in_rate_u",
}
_QUADRATURES = {
    "records": "records",
    "sense": "sense",
    "gain_ratio": "gain_ratio",
    "gain_ratio_u": "gain_ratio_u",
    "phase_error_rad": "phase_error",
    "phase_error_u_rad": "phase_error_u",
    "distortion": "distortion",
    "distortion_u": "distortion_u",
    "images": "images",
    "sine_alone_dps": "sine_alone",
    "cosine_alone_dps": "cosine_alone",
    "flags": "flags",
}


def result_document(found: LockInFound) -> dict[str, Any]:
    """Return the combined result.

    Units stand in the names; uncertainties are standard ones unless the name says 95, and count every input unless
    it says noise.
    """
    low, high = found.interval_95
    document = {
        "lock_in_rate_dps": found.lock_in_rate,
        "lock_in_rate_u_dps": found.lock_in_rate_u,
        "lock_in_rate_low_95_dps": low,
        "lock_in_rate_high_95_dps": high,
        "lock_in_rate_noise_u_dps": found.noise_u,
        **_of_one_rate(found),
        **_of_all(found),
        "records": len(found.waveforms) + len(found.damaged),
        "records_rejected": found.records_rejected,
        "method": found.method_text,
        "noise_model": found.combined.noise_model,
        "scale_factor_pulses_per_deg": found.method.scale_factor,
    }
    if found.tilt is not None:
        document |= {"tilt_deg": found.tilt.tilt_deg, "tilt_u_deg": found.tilt.tilt_u_deg}
    if found.table_check is not None:
        ways = [picked(one, _SCALE_FACTOR) for one in found.table_check.scale_factors]
        document["table_check"] = picked(found.table_check, _TABLE_CHECK) | {
            "scale_factors": ways,
            "sentences": table_sentences(found),
        }
    if found.several is not None:
        document["several_rates"] = _several_rates(found)
    if found.quadratures is not None:
        document["quadratures"] = picked(found.quadratures, _QUADRATURES)
    if found.budget is not None:
        document["budget"] = budget_document(found.budget)
    if found.truth is not None:
        alone = _OF_ONE_RATE if found.several is not None else ()
        document["truth"] = {name: None if name in alone else value for name, value in found.truth.items()}
    return document


def _of_one_rate(found: LockInFound) -> dict[str, Any]:
    """Rate, beat and ratio; several rates have no one value of them: each has its own under ``several_rates``."""
    if found.several is not None:
        return dict.fromkeys(_OF_ONE_RATE)
    return picked(found.combined, _OF_ONE_RATE)


def _of_all(found: LockInFound) -> dict[str, Any]:
    """Phase, amplitude and noise; of several rates the mean amplitude and the rms noise of all records used."""
    document = picked(found.combined, _OF_ALL)
    if found.several is not None and (used := found.each.usable).any():
        document["amplitude_v"] = found.each.amplitude[used].mean()
        document["noise_rms_v"] = np.sqrt(np.mean(found.each.noise_rms[used] ** 2))
    return document


def record_documents(found: LockInFound, called: str) -> Iterator[dict[str, Any]]:
    """Yield one document for each record, with the names of :func:`result_document`."""
    common = {
        "method": describe_method(found.method),
        "scale_factor_pulses_per_deg": found.method.scale_factor,
    }
    for first in range(0, len(found.names), _AT_ONCE):
        rows = slice(first, first + _AT_ONCE)
        some = replace(found, each=found.each[rows], record_u=found.record_u[rows], names=found.names[rows])
        low, high = some.record_intervals_95
        columns = {
            "lock_in_rate_dps": some.each.lock_in_rate,
            "lock_in_rate_u_dps": some.record_u,
            "lock_in_rate_low_95_dps": low,
            "lock_in_rate_high_95_dps": high,
            "lock_in_rate_noise_u_dps": some.each.lock_in_rate_u,
            **picked(some.each, _OF_ONE_RATE | _OF_ALL),
        }
        flags = some.each.flags.tolist()
        for name, bits, *values in zip(
            some.names, flags, *(one.tolist() for one in columns.values()), strict=True
        ):
            yield {called: name, **dict(zip(columns, values, strict=True)), **common, "flags": flag_names(bits)}


def _several_rates(found: LockInFound) -> dict[str, Any] | None:
    """What each rate says, and what all of them say together."""
    several = found.several
    if several is None:
        return None
    by_frequency = several.by_frequency
    return {
        "rates": [_group(group) for group in several.groups],
        "by_beat": None if several.by_beat is None else _rates_fit(several.by_beat),
        "by_table": None if several.by_table is None else _rates_fit(several.by_table),
        "by_frequency": None if by_frequency is None else _frequency_fit(by_frequency),
        "problem": several.problem or None,
        "rates_without_beat": found.without_beat,
    }


def _rates_fit(fit: RatesFit) -> dict[str, Any]:
    columns = [getattr(fit.left_out, attribute) for attribute in _LEFT_OUT.values()]
    return picked(fit, _RATES_FIT) | {
        "distortion_dbc": 20 * math.log10(abs(fit.distortion)) if fit.distortion else None,
        "alternatives": [picked(one, _ALTERNATIVE) for one in fit.alternatives],
        "counted": sorted(fit.counted),
        "models": [picked(one, _MODEL) for one in fit.models],
        "left_out": [dict(zip(_LEFT_OUT, row, strict=True)) for row in zip(*columns, strict=True)],
        "locked_up_to_dps": fit.at_least or None,
        "flags": [str(flag.name).lower() for flag in RatesFlag if flag & fit.flags],
        "sentences": describe_rates(fit),
    }


def _frequency_fit(fit: FrequencyFit) -> dict[str, Any]:
    return picked(fit, _FREQUENCY_FIT) | {
        "flags": [str(flag.name).lower() for flag in FrequencyFlag if flag & fit.flags],
        "sentences": describe_frequencies(fit),
    }


def _group(group: RateGroup) -> dict[str, Any]:
    one: LockInEstimate = group.combined
    return picked(one, _GROUP) | {
        "over_expected_lock_in": group.over_lock_in,
        "table_rate_dps": group.table_rate,
        "input_rate_by_table_dps": group.input_rate,
        "records": len(group.rows),
        "records_rejected": int(one.records_rejected),
        "flags": flag_names(int(one.flags)),
    }
