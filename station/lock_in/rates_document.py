"""A fit over several rates as plain JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from analysis import RatesFit, RatesFlag, flag_names
from analysis.frequency_method import FrequencyFit, FrequencyFlag
from analysis.lock_in_run import RateGroup, SeveralRates
from station.lock_in.rates_sentences import describe_frequencies, describe_rates


def several_rates_document(several: SeveralRates, without_beat: Sequence[str] = ()) -> dict[str, Any]:
    """Return what each rate says, and what all of them say together.

    Parameters
    ----------
    several : SeveralRates
    without_beat : sequence of str, optional
        Rates that gave no record.

    Returns
    -------
    dict
        Units stand in the names; a number that cannot be given is ``None``.
    """
    return {
        "rates": [_group(group) for group in several.groups],
        "by_beat": None if several.by_beat is None else fit_document(several.by_beat),
        "by_table": None if several.by_table is None else fit_document(several.by_table),
        "by_frequency": None if several.by_frequency is None else frequency_document(several.by_frequency),
        "problem": several.problem or None,
        "rates_without_beat": list(without_beat),
    }


def fit_document(fit: RatesFit) -> dict[str, Any]:
    """Return one fit as plain JSON.

    Parameters
    ----------
    fit : RatesFit

    Returns
    -------
    dict
    """
    return {
        "lock_in_rate_dps": _number(fit.lock_in_rate),
        "lock_in_rate_u_dps": _number(fit.lock_in_rate_u),
        "lock_in_rate_low_95_dps": _number(fit.lock_in_rate_low_95),
        "lock_in_rate_high_95_dps": _number(fit.lock_in_rate_high_95),
        "backscatter_phase_rad": _number(fit.backscatter_phase),
        "backscatter_phase_u_rad": _number(fit.backscatter_phase_u),
        "distortion": _number(fit.distortion),
        "distortion_u": _number(fit.distortion_u),
        "distortion_dbc": _number(20 * math.log10(abs(fit.distortion))) if fit.distortion else None,
        "gain_corner_hz": _number(fit.gain_corner_hz),
        "gain_corner_low_95_hz": _number(fit.gain_corner_low_95_hz),
        "gain_corner_high_95_hz": _number(fit.gain_corner_high_95_hz),
        "model": fit.model,
        "models": [
            {
                "model": each.model,
                "lock_in_rate_dps": _number(each.lock_in_rate),
                "lock_in_rate_u_dps": _number(each.lock_in_rate_u),
                "chi_square": _number(each.chi_square),
                "degrees_of_freedom": each.degrees_of_freedom,
            }
            for each in fit.models
        ],
        "chi_square": _number(fit.chi_square),
        "degrees_of_freedom": fit.degrees_of_freedom,
        "p_value": _number(fit.p_value),
        "u_over_u_with_distortion_known": _number(fit.cost),
        "left_out": [
            {
                "input_rate_dps": _number(rate),
                "lock_in_rate_dps": _number(value),
                "lock_in_rate_u_dps": _number(u),
                "deviation_in_u": _number(deviation),
            }
            for rate, value, u, deviation in zip(
                fit.left_out.rate,
                fit.left_out.lock_in_rate,
                fit.left_out.lock_in_rate_u,
                fit.left_out.deviation,
                strict=True,
            )
        ],
        "locked_up_to_dps": _number(fit.at_least) or None,
        "flags": [str(flag.name).lower() for flag in RatesFlag if flag & fit.flags],
        "sentences": list(describe_rates(fit)),
    }


def frequency_document(fit: FrequencyFit) -> dict[str, Any]:
    """Return the fit of beat frequency against rate as plain JSON.

    Parameters
    ----------
    fit : FrequencyFit

    Returns
    -------
    dict
    """
    return {
        "lock_in_rate_dps": _number(fit.lock_in_rate),
        "lock_in_rate_u_dps": _number(fit.lock_in_rate_u),
        "lock_in_rate_low_95_dps": _number(fit.lock_in_rate_low_95),
        "lock_in_rate_high_95_dps": _number(fit.lock_in_rate_high_95),
        "scale_factor_pulses_per_deg": _number(fit.scale_factor),
        "scale_factor_u_pulses_per_deg": _number(fit.scale_factor_u),
        "bias_rate_dps": _number(fit.bias_rate),
        "bias_rate_u_dps": _number(fit.bias_rate_u),
        "chi_square": _number(fit.chi_square),
        "degrees_of_freedom": fit.degrees_of_freedom,
        "p_value": _number(fit.p_value),
        "flags": [str(flag.name).lower() for flag in FrequencyFlag if flag & fit.flags],
        "sentences": list(describe_frequencies(fit)),
    }


def _group(group: RateGroup) -> dict[str, Any]:
    one = group.combined
    return {
        "over_expected_lock_in": group.over_lock_in,
        "table_rate_dps": group.table_rate,
        "input_rate_by_table_dps": group.input_rate,
        "input_rate_dps": _number(one.input_rate),
        "beat_frequency_hz": _number(one.beat_frequency),
        "ratio": _number(one.ratio),
        "ratio_u": _number(one.ratio_u),
        "lock_in_rate_dps": _number(one.lock_in_rate),
        "lock_in_rate_u_dps": _number(one.lock_in_rate_u),
        "records": len(group.rows),
        "records_rejected": int(one.records_rejected),
        "flags": flag_names(int(one.flags)),
    }


def _number(value: object) -> float | None:
    number = float(value)  # type: ignore[arg-type]  # a zero-dimensional array or a scalar
    return number if math.isfinite(number) else None
