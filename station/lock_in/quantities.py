"""The numbers of a lock-in rate, each declared once, and the JSON document that they make.

Units stand in the keys; uncertainties are standard ones unless the key says 95, and count every input unless it
says noise.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from analysis import RatesFit, RatesFlag, flag_names
from analysis.beam_swings import BeamsFlag
from analysis.frequency_method import FrequencyFlag
from analysis.lock_in_run import RateGroup
from station.lock_in.evaluate import LockInEvaluation, describe_method
from station.lock_in.messages import beams_sentences
from station.results import numbers
from station.results.numbers import (
    AMPLITUDE,
    BACKSCATTER_PHASE,
    BEAT_FREQUENCY,
    BIAS_RATE,
    INPUT_RATE,
    LOCK_IN_RATE_NOISE_U,
    NOISE_RMS,
    RATIO,
    SCALE_FACTOR,
)
from station.results.quantity import Quantity, QuantityGroup, document, rows

LOCK_IN_RATE = replace(
    numbers.LOCK_IN_RATE,
    interval="interval_95",
    limit=True,
    headline=True,
    trend=True,
    doc="all uncertainties included",
)
LOCK_IN_RATE_U = Quantity("lock_in_rate_u", "dps", limit=True)
LOCK_IN_RATE_HIGH_95 = Quantity("lock_in_rate_high_95", "dps", lambda found: found.interval_95[1], limit=True)
RESULT = (
    LOCK_IN_RATE,
    LOCK_IN_RATE_U,
    LOCK_IN_RATE_HIGH_95,
    replace(LOCK_IN_RATE_NOISE_U, of="noise_u"),
    replace(SCALE_FACTOR, of="method.scale_factor"),
)
# of one rate: null in a run at several, where each rate has its own
OF_ONE_RATE = (INPUT_RATE, BEAT_FREQUENCY, RATIO)
OF_ALL = (BACKSCATTER_PHASE, AMPLITUDE, NOISE_RMS)
TILT = (Quantity("tilt", "deg", "tilt_deg", "tilt_u_deg", limit=True, doc="of the axis from the table's"),)

RECORD = (
    replace(LOCK_IN_RATE, of="each.lock_in_rate", u="record_u", interval="record_intervals_95"),
    replace(LOCK_IN_RATE_NOISE_U, of="each.lock_in_rate_u"),
)
TABLE_CHECK = (
    Quantity("lock_in_rate", "dps", u=True, doc="by the rate of the table; u by noise and table"),
    Quantity("input_rate", "dps", doc="by the table"),
    Quantity("beat_over_table", u=True, doc="beat frequency over the one that the table's rate gives"),
    Quantity("p_value", doc="of beat over table being 1, by noise and table"),
    Quantity("p_value_by_all", doc="with all that the budget counts"),
    Quantity("lock_in_rate_by_frequencies", "dps", "by_frequencies", u=True),
    Quantity("least_error_seen", doc="of the lock-in rate that this check shows, as a share"),
)
OF_WAY = (
    Quantity("scale_factor", "pulses_per_deg", u=True, trend=True, doc="by a known tilt or by the earth rate"),
    Quantity("p_value"),
)
_FIT = (
    Quantity("lock_in_rate", "dps", u=True, interval=True),
    Quantity("chi_square"),
    Quantity("degrees_of_freedom"),
    Quantity("p_value"),
)
RATES_FIT = (
    *_FIT,
    Quantity("backscatter_phase", "rad", "backscatter_phase", u=True),
    Quantity("distortion", u=True, doc="second harmonic of the receiver over the fundamental"),
    Quantity(
        "gain_corner", "hz", "gain_corner_hz", interval=("gain_corner_low_95_hz", "gain_corner_high_95_hz"),
        doc="of the laser",
    ),
    Quantity("bandwidth", "hz", "bandwidth_hz", doc="of the receiver"),
    Quantity("bandwidth_low_95", "hz", "bandwidth_low_95_hz"),
    Quantity("third_order", u=True, doc="third harmonic of the receiver over the fundamental"),
    Quantity("phase_between_senses", "rad", "phase_between_senses", u=True, doc="of the backscatter"),
    Quantity("phase_drift", "rad", "phase_drift", u=True, doc="of the backscatter, over the run"),
    Quantity("lock_in_drift", u=True, doc="of the lock-in rate over the run, relative"),
    Quantity("scale_factor_by_rates", "pulses_per_deg", "scale_factor", u=True),
    Quantity("u_over_u_with_distortion_known", of="cost"),
)  # fmt: skip
MODEL = (Quantity("lock_in_rate", "dps", u=True), Quantity("chi_square"), Quantity("degrees_of_freedom"))
ALTERNATIVE = (Quantity("lock_in_rate", "dps", u=True), Quantity("distortion"), Quantity("chi_square"))
LEFT_OUT = (
    Quantity("input_rate", "dps", "rate", doc="that is left out"),
    Quantity("lock_in_rate", "dps", u=True, doc="of the others"),
    Quantity("deviation_in_u", of="deviation"),
    Quantity("p_value"),
)
FREQUENCY_FIT = (*_FIT, Quantity("scale_factor", "pulses_per_deg", u=True), BIAS_RATE)
GROUP = (
    *OF_ONE_RATE,
    Quantity("lock_in_rate", "dps", doc="of this rate alone"),
    replace(LOCK_IN_RATE_NOISE_U, of="lock_in_rate_u"),
)
OF_TABLE = (
    Quantity("over_expected_lock_in", of="over_lock_in"),
    Quantity("table_rate", "dps"),
    Quantity("input_rate_by_table", "dps", "input_rate"),
)
QUADRATURES = (
    Quantity("gain_ratio", u=True, doc="amplitude of the cosine channel over the sine channel's"),
    Quantity("phase_error", "rad", u=True, doc="beyond a right angle"),
    Quantity("distortion", u=True, doc="of sine and cosine channel"),
    Quantity("images", doc="of the first three harmonics"),
    Quantity("sine_alone", "dps", doc="lock-in rate by the sine channel"),
    Quantity("cosine_alone", "dps"),
)
_TURN = 2 * math.pi
BEAMS = (
    *_FIT,
    Quantity("backscatter_1", "hz", "backscatter_1", u=True, scale=1 / _TURN, doc="of the first beam"),
    Quantity("backscatter_2", "hz", "backscatter_2", u=True, scale=1 / _TURN),
    Quantity("backscatter_phase_sum", "rad", "phase_sum", u=True, doc="of both beams: 0 where they only lock"),
    BACKSCATTER_PHASE,
    Quantity(
        "gain_corner", "hz", "gain_rate", interval=("gain_rate_low_95", "gain_rate_high_95"), scale=1 / _TURN,
        doc="of the laser",
    ),
    Quantity("distortion", u=True, doc="second harmonic of the receiver over the fundamental"),
    Quantity("routes_chi_square", doc="between the routes"),
    Quantity("routes_p_value"),
)  # fmt: skip
ROUTE = (Quantity("lock_in_rate", "dps", u=True, interval=True, doc="by this route alone"),)
OF_SETTING = (
    Quantity("input_rate", "dps", "rate"),
    replace(BEAT_FREQUENCY, u=False),
    Quantity("corrected_frequency", "hz", "corrected_frequency", u=True, doc="the beat without backscatter"),
    Quantity("push", doc="of the beat by the difference of the beams, relative"),
)
_SEVERAL = "several_rates"

QUANTITIES = (
    QuantityGroup((*RESULT, *OF_ALL, *TILT, *OF_ONE_RATE)),
    QuantityGroup(TABLE_CHECK, "table_check"),
    QuantityGroup(OF_WAY, "table_check.scale_factors", "by"),
    QuantityGroup((*GROUP, *OF_TABLE), f"{_SEVERAL}.rates", "over_expected_lock_in"),
    *(QuantityGroup(RATES_FIT, f"{_SEVERAL}.{by}") for by in ("by_beat", "by_table")),
    QuantityGroup(FREQUENCY_FIT, f"{_SEVERAL}.by_frequency"),
    *(QuantityGroup(MODEL, f"{_SEVERAL}.{by}.models", "model") for by in ("by_beat", "by_table")),
    *(QuantityGroup(ALTERNATIVE, f"{_SEVERAL}.{by}.alternatives") for by in ("by_beat", "by_table")),
    *(QuantityGroup(LEFT_OUT, f"{_SEVERAL}.{by}.left_out") for by in ("by_beat", "by_table")),
    QuantityGroup(QUADRATURES, "quadratures"),
    QuantityGroup(BEAMS, "beams"),
    QuantityGroup(ROUTE, "routes", "route"),
    QuantityGroup(OF_SETTING, "beams.settings"),
)

_AT_ONCE = 2000  # records whose documents are made together


def result_document(found: LockInEvaluation) -> dict[str, Any]:
    """Return the numbers of a result, with what it was found by."""
    made = document(found, RESULT)
    one_rate = document(found.combined, OF_ONE_RATE)
    made |= one_rate if found.several is None else dict.fromkeys(one_rate)
    made |= document(found.combined, OF_ALL)
    if found.several is not None and (used := found.each.usable).any():
        made[AMPLITUDE.key()] = found.each.amplitude[used].mean()
        made[NOISE_RMS.key()] = np.sqrt(np.mean(found.each.noise_rms[used] ** 2))
    made |= {
        "records": len(found.waveforms) + len(found.damaged),
        "records_rejected": found.records_rejected,
        "method": found.method_text,
        "noise_model": found.combined.noise_model,
    }
    if found.tilt is not None:
        made |= document(found.tilt, TILT)
    if (check := found.table_check) is not None:
        ways = [{"by": one.by, **document(one, OF_WAY)} for one in check.scale_factors]
        made["table_check"] = document(check, TABLE_CHECK) | {"scale_factors": ways}
    if (several := found.several) is not None:
        by_frequency = several.by_frequency
        made[_SEVERAL] = {
            "rates": [_group(group) for group in several.groups],
            "by_beat": None if several.by_beat is None else _rates_fit(several.by_beat),
            "by_table": None if several.by_table is None else _rates_fit(several.by_table),
            "by_frequency": None
            if by_frequency is None
            else document(by_frequency, FREQUENCY_FIT)
            | {"flags": [str(flag.name).lower() for flag in FrequencyFlag if flag & by_frequency.flags]},
            "problem": several.problem or None,
            "rates_without_beat": found.without_beat,
        }
    if several is not None and (beams := several.beams) is not None:
        made["beams"] = document(beams, BEAMS) | {
            "settings": rows(beams, OF_SETTING),
            "flags": [str(flag.name).lower() for flag in BeamsFlag if flag & beams.flags],
            "sentences": beams_sentences(several),
        }
        made["routes"] = [{"route": one.name, **document(one, ROUTE)} for one in beams.routes]
    if (pairs := found.quadratures) is not None:
        plain = {"records": pairs.records, "sense": pairs.sense, "flags": pairs.flags}
        made["quadratures"] = document(pairs, QUADRATURES) | plain
    if found.truth is not None:
        hidden = () if found.several is None else one_rate
        made["truth"] = {name: None if name in hidden else value for name, value in found.truth.items()}
    return made


def record_documents(found: LockInEvaluation, called: str) -> Iterator[dict[str, Any]]:
    """Yield one document for each record, with the keys of :func:`result_document`."""
    common = {"method": describe_method(found.method), SCALE_FACTOR.key(): found.method.scale_factor}
    for first in range(0, len(found.names), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        some = replace(found, each=found.each[part], record_u=found.record_u[part], names=found.names[part])
        columns = document(some, RECORD) | document(some.each, (*OF_ONE_RATE, *OF_ALL))
        flags = some.each.flags.tolist()
        for name, bits, *values in zip(
            some.names, flags, *(one.tolist() for one in columns.values()), strict=True
        ):
            yield {called: name, **dict(zip(columns, values, strict=True)), **common, "flags": flag_names(bits)}


def _rates_fit(fit: RatesFit) -> dict[str, Any]:
    return document(fit, RATES_FIT) | {
        "model": fit.model,
        "distortion_dbc": 20 * math.log10(abs(fit.distortion)) if fit.distortion else None,
        "alternatives": [document(one, ALTERNATIVE) for one in fit.alternatives],
        "counted": sorted(fit.counted),
        "models": [{"model": one.model, **document(one, MODEL)} for one in fit.models],
        "left_out": rows(fit.left_out, LEFT_OUT),
        "locked_up_to_dps": fit.at_least or None,
        "flags": [str(flag.name).lower() for flag in RatesFlag if flag & fit.flags],
    }


def _group(group: RateGroup) -> dict[str, Any]:
    return document(group.combined, GROUP) | document(group, OF_TABLE[:1]) | {
        OF_TABLE[1].key(): group.table_rate,
        OF_TABLE[2].key(): group.input_rate,
        "records": len(group.rows),
        "records_rejected": int(group.combined.records_rejected),
        "flags": flag_names(int(group.combined.flags)),
    }  # fmt: skip
