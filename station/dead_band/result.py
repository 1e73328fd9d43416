"""The dead band as numbers and sentences."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from analysis import DeadBand, FrequencyFit
from analysis.dead_band import DeadBandFlag
from station.dead_band.evaluate import DeadBandFound
from station.dead_band.settings import DeadBandSettings, LimitSettings
from station.results.numbers import with_uncertainty
from station.results.result import Measured, Result
from station.runs.store import SavedRun

LIMITED = tuple(LimitSettings.model_fields)
_FAR = 3.0  # standard uncertainties


def result(found: DeadBandFound, run: SavedRun, settings: DeadBandSettings) -> Result:
    """Put into numbers and sentences what was found."""
    band, document = found.band, _document(found)
    lock_in = _with_u(band.lock_in_rate, found.lock_in_rate_u)
    return Result(
        name="dead band",
        value=_with_u(2 * band.lock_in_rate, 2 * found.lock_in_rate_u),
        document=document,
        measured=tuple(Measured(name, float(document[name])) for name in LIMITED),
        lines=(f"Half of it is the lock-in rate, {lock_in}; from {_count(found)}.",),
        summary=_summary(found),
        sentences=tuple(_sentences(found)),
        to_watch=tuple(_to_watch(found)),
        flags=tuple(_flags(found)),
        left_out=found.left_out,
        truth=_truth(run),
    )


def _with_u(value: float, u: float) -> str:
    return with_uncertainty(value, u, "deg/s")


def _count(found: DeadBandFound) -> str:
    return f"{int(found.records.step[-1]) + 1} rates, {len(found.records.rate)} records"


def _truth(run: SavedRun) -> str:
    truth = run.facts.truth
    if truth is None:
        return ""
    lock_in, bias = truth["lock_in_rate_dps"], truth["bias_rate_dps"]
    return f"the truth is a lock-in rate of {lock_in:g} deg/s and a bias of {bias:+.6g} deg/s"


def _document(found: DeadBandFound) -> dict[str, Any]:
    band, records, fit = found.band, found.records, found.hyperbola
    return {
        "dead_band_dps": 2 * band.lock_in_rate,
        "dead_band_u_dps": 2 * found.lock_in_rate_u,
        "lock_in_rate_dps": band.lock_in_rate,
        "lock_in_rate_u_dps": found.lock_in_rate_u,
        "lock_in_rate_u_parts_dps": {
            name.replace(", ", "_").replace(" ", "_"): u for name, u in found.parts.items()
        },
        "bias_rate_dps": band.bias_rate,
        "bias_rate_u_dps": found.bias_rate_u,
        "earth_rate_on_axis_dps": found.earth_rate,
        "hysteresis_dps": band.hysteresis,
        "hysteresis_u_dps": band.hysteresis_u,
        "bias_drift_dps": band.drift,
        "bias_drift_u_dps": band.drift_u,
        "edges": _edges(found),
        "corner": _corner(band),
        "hyperbola": None if fit is None else _hyperbola(fit),
        "scale_factor_pulses_per_deg": found.scale_factor,
        "records": len(records.rate),
        "left_out": found.left_out,
    }


def _edges(found: DeadBandFound) -> list[dict[str, Any]]:
    band = found.band
    return [
        {
            "sense": sense,
            "from": coming,
            "rate_dps": sense * float(band.edges[k, m]),
            "half_gap_dps": float(band.edge_half_widths[k, m]),
        }
        for k, sense in enumerate((1, -1))
        for m, coming in enumerate(("inside", "outside"))
        if math.isfinite(band.edges[k, m])
    ]


def _corner(band: DeadBand) -> dict[str, Any]:
    """The fitted corner; a random walk that rounds nothing is not known."""
    rounded = bool(band.flags & DeadBandFlag.ROUNDED)
    return {
        "lock_in_rate_dps": band.corner_rate,
        "lock_in_rate_u_dps": band.corner_rate_u,
        "random_walk_deg_per_sqrt_s": band.random_walk if rounded else None,
        "random_walk_u_deg_per_sqrt_s": band.random_walk_u if rounded else None,
    }


def _hyperbola(fit: FrequencyFit) -> dict[str, Any]:
    return {
        "lock_in_rate_dps": fit.lock_in_rate,
        "lock_in_rate_u_dps": fit.lock_in_rate_u,
        "bias_rate_dps": fit.bias_rate,
        "bias_rate_u_dps": fit.bias_rate_u,
        "scale_factor_pulses_per_deg": fit.scale_factor,
        "scale_factor_u_pulses_per_deg": fit.scale_factor_u,
        "chi_square": fit.chi_square,
        "degrees_of_freedom": fit.degrees_of_freedom,
    }


def record_rows(found: DeadBandFound) -> list[dict[str, Any]]:
    """Return one JSON object for each record."""
    records = found.records
    return [
        {
            "record": number + 1,
            "direction": records.direction[number],
            "table_rate_dps": records.table_rate[number],
            "rate_dps": records.rate[number],
            "beat_frequency_hz": signed_beat(found)[number],
            "beat_frequency_u_hz": records.beat_u[number],
            "locked": bool(records.beat[number] == 0),
            "swing_v": records.swing[number],
        }
        for number in range(len(records.rate))
    ]


def signed_beat(found: DeadBandFound) -> Any:
    """Beat frequency in Hz with the sense of the rate on the axis, bias included, shape (n,)."""
    bias = found.band.bias_rate
    seen = found.records.rate - (bias if math.isfinite(bias) else 0.0)
    return np.sign(seen) * found.records.beat


def _summary(found: DeadBandFound) -> list[tuple[str, str]]:
    band, fit = found.band, found.hyperbola
    rows = [
        ("lock-in rate", with_uncertainty(band.lock_in_rate, found.lock_in_rate_u, "deg/s")),
        ("bias rate", with_uncertainty(band.bias_rate, found.bias_rate_u, "deg/s")),
        ("earth rate", f"{found.earth_rate:.6f} deg/s on the axis, vertical part"),
        ("hysteresis", _with_u(band.hysteresis, band.hysteresis_u)),
        ("drift of the bias", f"{_with_u(band.drift, band.drift_u)} from the first rate to the last"),
    ]
    if fit is not None and math.isfinite(fit.lock_in_rate):
        rows.append(("by the hyperbola", _with_u(fit.lock_in_rate, fit.lock_in_rate_u)))
    rows.append(("records", _count(found)))
    return rows


def _sentences(found: DeadBandFound) -> Iterator[str]:
    """Say what the band means, and what this test does not see."""
    band, fit = found.band, found.hyperbola
    half = float(np.nanmax(band.edge_half_widths))
    yield (
        f"The beat ends and begins {_with_u(band.lock_in_rate, found.lock_in_rate_u)} from the middle of the band "
        f"(k = 1); the steps of the table leave an edge open by ± {half:.2g} deg/s."
    )
    if math.isfinite(band.bias_rate):
        rest = _with_u(band.bias_rate + found.earth_rate, found.bias_rate_u)
        yield (
            f"The middle lies at {_with_u(band.bias_rate, found.bias_rate_u)}. The earth turns the axis by "
            f"{found.earth_rate:+.5f} deg/s, which moves the middle the other way; the rest, {rest}, is the own "
            "bias of the gyro and what is not known of the table."
        )
    if fit is not None and math.isfinite(fit.lock_in_rate):
        yield (
            "The same records, as beat frequency against rate, lie on a hyperbola with lock-in rate "
            f"{_with_u(fit.lock_in_rate, fit.lock_in_rate_u)} and bias {_with_u(fit.bias_rate, fit.bias_rate_u)}. "
            "It uses the beats beyond the band and is finer than the steps, but leans on the lock-in equation; "
            "the edges do not."
        )
    yield (
        "The edges need neither waveform nor scale factor: distortion of the detector, which the harmonic method "
        "of `gyrolock measure` must know, does not move them. That method is finer and works far beyond lock-in, "
        "where the rate need not be held so well; it tells nothing of hysteresis."
    )
    yield (
        "Not seen: what happens between two steps, a beat of less than one period in a record, and a bias that "
        "drifts otherwise than evenly; an even drift is found from the beats beyond the band and taken out."
    )


def _flags(found: DeadBandFound) -> list[str]:
    band, apart = found.band, _apart(found)
    flags = [str(flag.name).lower() for flag in DeadBandFlag if flag & band.flags]
    if found.hyperbola is None:
        flags.append("no_hyperbola")
    return [*flags, "hyperbola_disagrees"] if abs(apart) > _FAR else flags


def _apart(found: DeadBandFound) -> float:
    """Distance of the hyperbola's lock-in rate from the edges', in standard uncertainties; 0 if it has none."""
    fit = found.hyperbola
    if fit is None or not math.isfinite(fit.lock_in_rate):
        return 0.0
    return (fit.lock_in_rate - found.band.lock_in_rate) / math.hypot(fit.lock_in_rate_u, found.lock_in_rate_u)


def _to_watch(found: DeadBandFound) -> Iterator[str]:
    band = found.band
    for one in found.left_out:
        yield f"{one.sentence}."
    texts = {
        DeadBandFlag.ONE_SENSE: "An edge was found in one sense only: bias and earth rate are in this number.",
        DeadBandFlag.HYSTERESIS: f"The beat ends {band.hysteresis:.2g} deg/s below the rate at which it begins; "
        "that is part of the uncertainty, and no single lock-in rate fits both ways.",
        DeadBandFlag.ROUNDED: "Noise lets the gyro slip inside the band: the whole corner fits a lock-in rate of "
        f"{band.corner_rate:.5g} ± {band.corner_rate_u:.2g} deg/s with a random walk of "
        f"{60 * band.random_walk:.2g} deg/sqrt(h).",
        DeadBandFlag.NO_SILENT_RATE: "On some branch no rate was silent: take smaller steps about zero.",
        DeadBandFlag.NO_PULSES: "On some branch no rate gave a beat: sweep further.",
        DeadBandFlag.DRIFT: f"The bias drifted by {_with_u(band.drift, band.drift_u)} during the sweep; edges and "
        "hyperbola are taken to the middle of the sweep. A drift that was not even is only partly taken out.",
        DeadBandFlag.PULSES_INSIDE: "Silent rates lie beyond the first one with a beat: noise, or a table that "
        "does not hold its rate.",
    }
    yield from (text for bit, text in texts.items() if band.flags & bit)
    if found.parts["slow_beats"] > found.parts["steps_hysteresis_noise"]:
        yield (
            "The records are too short for this band: beats too slow to be seen matter more than the steps of the "
            "table. Take more periods in a record, if its time base allows."
        )
    if found.parts["earth_rate"] > 0.01 * band.lock_in_rate:
        yield (
            "The axis is tilted and the azimuth is not known: the horizontal earth rate may move the edges by "
            f"{found.parts['earth_rate']:.2g} deg/s."
        )
    if found.hyperbola is None:
        yield "Too few rates gave a beat of some periods for a hyperbola: sweep further."
    elif abs(apart := _apart(found)) > _FAR:
        yield (
            f"The hyperbola's lock-in rate lies {apart:+.1f} standard uncertainties from that of the edges: noise "
            "moves the edges, or the beat does not follow the lock-in equation."
        )
