"""The noise model as numbers and sentences."""

from __future__ import annotations

from typing import Any

from station.fibre_gyro.allan.evaluate import AllanFound, NoiseOf
from station.fibre_gyro.common import COUNTS_PER_DPS
from station.fibre_gyro.settings import FogSettings
from station.results.numbers import with_uncertainty
from station.results.parts import TextTable
from station.results.result import Measured, Result
from station.runs.store import SavedRun

UNITS = {
    "quantization": ("quantization_deg", "quantization", "deg", 1.0),
    "angle_random_walk": ("angle_random_walk_deg_per_sqrt_h", "angle random walk", "deg/√h", 60.0),
    "bias_instability": ("bias_instability_dph", "bias instability", "deg/h", 3600.0),
    "rate_random_walk": ("rate_random_walk_dph_per_sqrt_h", "rate random walk", "deg/h/√h", 216_000.0),
    "rate_ramp": ("rate_ramp_dph_per_h", "rate ramp", "deg/h/h", 3600.0**2),
}
"""Of each term: its name in JSON, in words, its unit, and how many of that one in deg and s is."""
_DESCRIBE = (
    "That is the shipped gyro: with another scale factor all numbers here are wrong by its ratio. Describe the "
    "coil in [gyro], or change gyro.counts_per_code in the ratio of a measured K to this one."
)
LIMITED = ("angle_random_walk_deg_per_sqrt_h", "bias_instability_dph", "rate_random_walk_dph_per_sqrt_h")


def result(found: AllanFound, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    records = [_record(one) for one in found.records]
    several = len(records) > 1
    first = found.records[0]
    walk = first.fit.coefficients.get("angle_random_walk")
    value = "no angle random walk"
    if walk is not None:
        u = first.fit.coefficients_u["angle_random_walk"]
        value = f"N = {with_uncertainty(60 * walk, 60 * u)} deg/√h"
    lines = (
        f"{first.key}: {first.duration_s / 3600:.3g} h of output; by maximum likelihood, "
        f"in the model: {', '.join(UNITS[name][1] for name in first.fit.chosen)}.",
    )
    counts = not run.facts.simulated and any(one.by_design for one in found.records)
    design = _by_design(settings) if counts else ""
    watched = tuple(_to_watch(found))
    if design and not settings.gyro_is_described:
        watched = (*watched, f"{design} {_DESCRIBE}")
    return Result(
        name="result",
        value=value,
        document={**({} if several else records[0]), "records": records, "left_out": found.left_out},
        measured=tuple(Measured(n, one[n], one["name"] if several else "") for one in records for n in LIMITED),
        lines=lines,
        summary=[("", line) for line in lines],
        sentences=(*_sentences(found), *([design] if design and settings.gyro_is_described else [])),
        to_watch=watched,
        flags=watched,
        left_out=found.left_out,
        tables=tuple(term_table(one) for one in found.records),
    )


def _record(one: NoiseOf) -> dict[str, Any]:
    fit, document = one.fit, {"name": one.key, "duration_s": one.duration_s, "terms": one.fit.chosen}
    for term, (name, _, _, scale) in UNITS.items():
        document[name] = scale * fit.coefficients.get(term, 0.0)
        document[f"{name}_u"] = scale * fit.coefficients_u[term] if term in fit.coefficients_u else None
        document[f"{name}_low_95"] = scale * fit.low_95[term]
        document[f"{name}_high_95"] = scale * fit.high_95[term]
    return {
        **document,
        "temperature_slope_dph_per_k": 3600 * fit.temperature_slope,
        "temperature_slope_u_dph_per_k": 3600 * fit.temperature_slope_u,
        "words": fit.words,
        "missing": fit.missing,
        "outliers": fit.outliers,
        "tau_s": one.curve.tau_s,
        "allan_deviation_dph": 3600 * one.curve.deviation,
    }


def term_table(one: NoiseOf) -> TextTable:
    """Return all terms of one record: value or bound, and interval."""
    rows = []
    for term, (_, words, unit, scale) in UNITS.items():
        fit = one.fit
        low, high = scale * fit.low_95[term], scale * fit.high_95[term]
        if term in fit.coefficients:
            said = with_uncertainty(scale * fit.coefficients[term], scale * fit.coefficients_u[term])
        else:
            said = "not seen"
        rows.append((words, said, f"{low:.3g} to {high:.3g}", unit))
    return TextTable((one.key, "coefficient", "95 %", "unit"), tuple(rows))


def _sentences(found: AllanFound) -> list[str]:
    return [
        "Fitted is the likelihood of the output itself, not the slopes of the curve: the curve is for the eye. A "
        "term stands in the model if the data ask for it (Bayesian information criterion); of the others it is "
        "told how large they may be.",
        *(
            f"{one.key}: a drift with the temperature of {3600 * one.fit.temperature_slope:.3g}"
            f"({3600 * one.fit.temperature_slope_u:.1g}) deg/h per kelvin was taken out."
            for one in found.records
            if one.fit.temperature_slope == one.fit.temperature_slope
        ),
    ]


def _by_design(settings: FogSettings) -> str:
    return (
        f"The output is in counts; it was turned into deg/h by the scale factor by design, "
        f"{settings.nominal_scale_factor:.6g} {COUNTS_PER_DPS}."
    )


def _to_watch(found: AllanFound) -> list[str]:
    said = [f"{one.sentence}." for one in found.left_out]
    for one in found.records:
        if one.fit.missing:
            said.append(f"{one.key}: {one.fit.missing} of {one.fit.words} output words are missing.")
        if one.fit.outliers:
            words = "1 output word lies" if one.fit.outliers == 1 else f"{one.fit.outliers} output words lie"
            said.append(f"{one.key}: {words} far from all others: left out.")
    return said
