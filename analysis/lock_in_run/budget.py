"""The uncertainty budget of a run, at one rate or through the fit over several."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from analysis.arrays import Complexes, Floats
from analysis.budget import (
    BenchKnowledge,
    Bounded,
    Budget,
    BudgetInput,
    Corner,
    Distribution,
    OperatingPoint,
    Reference,
    TableGeometry,
    bounded,
    lock_in_budget,
    operating_point,
)
from analysis.budget.channel_inputs import CORNERS, response_input, separated_input
from analysis.errors import NoFit
from analysis.lock_in_run.records import RecordArrays, RunKnowledge
from analysis.lock_in_run.result import LockInRun
from analysis.lock_in_run.third_harmonic import third_order_limit
from analysis.lockin_equation import lock_in_from_beat, lock_in_from_rate
from analysis.lockin_rate import LockInEstimate
from analysis.rotation import earth_rate_on_axis
from analysis.several_rates import Model, RatesFit, RatesFlag, ReceiverKnowledge, fit_again

_RECTANGLE = math.sqrt(3.0)
_SAMPLES_FITTED = 6
_EAST = 90.0
_CORNER_NAMES = {name for name, *_ in CORNERS}
_HARDLY = 0.7
"""Share of its uncertainty beforehand that an unknown of the fit has left, if the records hardly show it."""

_FITTED: dict[Model, str] = {
    "distortion": "distortion",
    "gain": "the gain corner",
    "both": "distortion and the gain corner",
    "all": "distortion, gain corner and bandwidth",
}

OF_EACH_RECORD = ("noise", "quantization", "beat_frequency", "scatter")
"""Lines that are another's in every record; those that remain act on all records of one rate alike."""


def known_of_bench(found: LockInRun, slow: RecordArrays, knowledge: RunKnowledge) -> BenchKnowledge:
    """What was stated of the bench, and what the records themselves say of table and channel."""
    stated = knowledge.bench
    return replace(
        stated,
        table=_table_geometry(found, knowledge),
        third_order_limit=third_order_limit(slow, found.each, stated.third_order_limit),
        separated=stated.separated | ({"distortion"} if found.quadratures is not None else set()),
    )


def run_budget(found: LockInRun, slow: RecordArrays, bench: BenchKnowledge) -> Budget:
    """Make the budget of a run that gave a lock-in rate; what nobody stated counts with its bound."""
    if found.several is not None and found.several.by_beat is not None:
        one, rows = found.several.reference_group.combined, found.several.reference_group.rows
        point = _operating_point(found.each[rows], one, slow)
        return _rates_budget(found.each, found.several.by_beat, point, bench, int(slow.samples.min()))
    return _one_rate_budget(found, found.each, found.combined, slow, bench)


def record_uncertainties(found: LockInRun, slow: RecordArrays, bench: BenchKnowledge) -> Floats:
    """Standard uncertainty of each record alone, every input counted, deg/s; arguments as above."""
    each = found.each
    groups = [(np.arange(each.flags.size), found.combined)]
    if found.several is not None:
        groups = [(group.rows, group.combined) for group in found.several.groups]
    us = np.full(each.flags.size, math.nan)
    for rows, one in groups:
        if np.isfinite(one.lock_in_rate_u) and each[rows].usable.any():
            budget = _one_rate_budget(found, each[rows], one, slow, bench)
            alike = math.hypot(*(line.contribution for line in budget.inputs if line.name not in OF_EACH_RECORD))
            us[rows] = np.hypot(each.lock_in_rate_u[rows], alike)
    return us


def _one_rate_budget(
    found: LockInRun, each: LockInEstimate, one: LockInEstimate, slow: RecordArrays, bench: BenchKnowledge
) -> Budget:
    reference: Reference = "rate" if one.rate_given else "beat"
    if one.relation == "exact":
        return lock_in_budget(_operating_point(each, one, slow), bench, reference)
    # a formula of the paper: the sensitivities are those of the exact relation, the rest is its error
    r, value = float(one.ratio), float(one.lock_in_rate)
    if one.rate_given:
        exact = float(lock_in_from_rate(r, abs(float(one.input_rate)), "exact"))
    else:
        exact = float(lock_in_from_beat(r, float(one.beat_frequency) / one.scale_factor))
    budget = lock_in_budget(
        _operating_point(each, replace(one, lock_in_rate=np.asarray(exact)), slow), bench, reference
    )
    error = value - exact
    note = f"{error / exact:+.2%} off the exact relation: a limit, not corrected for" if exact else ""
    quantity, u = f"formula {found.method.relation} of the paper", abs(error) / _RECTANGLE
    line = BudgetInput("relation", quantity, "deg/s", error, u, "rectangular", 1.0, note=note, common=True)
    return Budget(value, reference, (*budget.inputs, line))


def _operating_point(each: LockInEstimate, one: LockInEstimate, slow: RecordArrays) -> OperatingPoint:
    return operating_point(
        each, one, samples=int(slow.samples.min()), level_spacing=float(np.mean(slow.level_spacing))
    )


def _table_geometry(found: LockInRun, knowledge: RunKnowledge) -> TableGeometry | None:
    """How the rate on the axis came about; ``None`` where no table with a known rate was used."""
    tilt, check = found.tilt, found.table_check
    if tilt is None or check is None:
        return None
    vertical = float(earth_rate_on_axis(knowledge.latitude_deg, tilt.tilt_deg, _EAST))
    table_rate = (check.input_rate - vertical) / math.cos(math.radians(tilt.tilt_deg))
    return TableGeometry(
        table_rate=table_rate,
        table_rate_u=1e-6 * knowledge.table_rate_u_ppm * abs(table_rate),
        tilt_deg=tilt.tilt_deg,
        tilt_u_deg=tilt.tilt_u_deg,
        latitude_deg=knowledge.latitude_deg,
        latitude_u_deg=knowledge.latitude_u_deg,
    )


def _rates_budget(
    each: LockInEstimate, fit: RatesFit, point: OperatingPoint, bench: BenchKnowledge, samples: int
) -> Budget:
    """Budget of a fit over several rates: what acts on every rate in its own way is put through the fit."""
    bench = replace(bench, separated=bench.separated | fit.counted)
    slowest = float(np.min(each.beat_frequency[fit.used]))
    known, receiver = bounded(bench, slowest), ReceiverKnowledge.of(bench)
    # what is common stands as at one rate; the channel comes below
    at_one_rate = lock_in_budget(point, bench)
    scale = fit.lock_in_rate / at_one_rate.lock_in_rate if at_one_rate.lock_in_rate else 1.0
    common = [line for line in at_one_rate.inputs if line.common and line.name not in _CORNER_NAMES]
    lines = [replace(line, sensitivity=line.sensitivity * scale) for line in common]
    hardly_seen = _hardly_seen(fit, receiver, slowest)
    lines += [*_from_fit(fit, samples, hardly_seen), *_from_channel(each, fit, known, point, receiver)]
    return Budget(fit.lock_in_rate, "beat", tuple(lines))


def _hardly_seen(fit: RatesFit, receiver: ReceiverKnowledge, slowest_beat_hz: float) -> list[str]:
    """What nobody stated and the records do not tell either: the fit knows of it no more than its bound."""
    prior = receiver.prior(slowest_beat_hz).sd
    unknowns = (
        ("distortion", receiver.second_order_limit, fit.distortion_u, prior[2]),
        ("gain corner", receiver.gain_corner.hz, fit.gain_time_u, prior[3]),
        ("bandwidth", receiver.bandwidth.hz, fit.lag_square_u, prior[4]),
        ("third order", receiver.third_order_limit, fit.third_order_u, prior[5]),
    )
    return [name for name, stated, u, before in unknowns if math.isnan(stated) and u > _HARDLY * before]


def _from_fit(fit: RatesFit, samples: int, hardly_seen: list[str]) -> Iterator[BudgetInput]:
    """Noise of the records, and what it costs to find distortion and the like from the same records."""
    scattered = bool(fit.flags & RatesFlag.MISFIT)
    freedom = float(fit.degrees_of_freedom if scattered else fit.used.sum() * (samples - _SAMPLES_FITTED))
    # without what rules the interval beside the records: other solutions, coupling of the beams
    noise_u = min(math.sqrt(float(fit.covariance[0, 0])), fit.lock_in_rate_u) / max(fit.cost, 1.0)
    note = "enlarged to the scatter between records" if scattered else "from what the fit leaves of the records"
    yield BudgetInput(
        "noise", "noise of the records", "deg/s", fit.lock_in_rate, noise_u, "normal", 1.0, freedom, note
    )
    if fit.model != "lock-in":
        rest = math.sqrt(max(fit.lock_in_rate_u**2 - noise_u**2, 0.0))
        quantity = f"noise, by way of {_FITTED[fit.model]}"
        note = f"{_FITTED[fit.model]} fitted to the same records"
        if hardly_seen:
            note = f"not stated: bound of {', '.join(hardly_seen)}, which these rates hardly show"
        yield BudgetInput(
            "separation", quantity, "deg/s", 0.0, rest, "normal", 1.0, freedom, note, stated=not hardly_seen
        )


def _from_channel(
    each: LockInEstimate, fit: RatesFit, known: Bounded, point: OperatingPoint, receiver: ReceiverKnowledge
) -> Iterator[BudgetInput]:
    """Filters of channel and laser: the fit again with the ratios that would be seen without them."""
    for name, field, quantity, factor in CORNERS:
        corner: Corner = getattr(known.knowledge, field)
        if name in known.knowledge.separated:
            yield separated_input(name, quantity)
        elif corner.hz in (0.0, math.inf):
            yield BudgetInput(name, quantity, "Hz", corner.hz, 0.0, "rectangular", 0.0, note="none")
        elif corner.corrected:
            wider = replace(corner, hz=corner.hz + corner.u_hz)
            shift = _shift(each, fit, _without(factor, wider, corner), point, receiver)
            yield _line(name, quantity, corner, abs(shift), "normal", "corrected for")
        else:
            u = abs(_shift(each, fit, _without(factor, corner), point, receiver)) / _RECTANGLE
            line = _line(name, quantity, corner, u, "rectangular", "not corrected for")
            bound = f"{corner.hz:.4g} Hz; the fit repeated with its effect"
            yield replace(line, note=known.note(name, bound, line.note), stated=name not in known.assumed)
    if math.isfinite(known.knowledge.response_u):
        yield response_input(known.knowledge.response_u, -fit.lock_in_rate)


def _line(name: str, quantity: str, corner: Corner, u: float, kind: Distribution, what: str) -> BudgetInput:
    note = f"corner {corner.hz:g} Hz, {what}: the fit repeated with its effect"
    return BudgetInput(name, f"{quantity}: shift of the fit", "deg/s", 0.0, u, kind, 1.0, note=note)


def _without(
    factor: Callable[[Floats, float], Complexes], corner: Corner, corrected: Corner | None = None
) -> Callable[[Floats], Complexes]:
    """What takes a filter out of the ratios, by their beat frequencies; `corrected`: what has been taken out."""

    def of(frequency: Floats) -> Complexes:
        seen = factor(frequency, corner.hz)
        return np.asarray(1 / (seen if corrected is None else seen / factor(frequency, corrected.hz)))

    return of


def _shift(
    each: LockInEstimate,
    fit: RatesFit,
    factor: Callable[[Floats], Complexes],
    point: OperatingPoint,
    receiver: ReceiverKnowledge,
) -> float:
    """Change of the lock-in rate in deg/s if the ratios were multiplied by a factor of their beat frequency."""
    try:
        before, after = (fit_again(fit, factor=one, receiver=receiver) for one in (np.ones_like, factor))
    except NoFit:
        # as at the rate that determines the result best
        place = int(np.nanargmin(np.abs(each.beat_frequency - point.beat_frequency)))
        return fit.lock_in_rate * float(np.abs(factor(each.beat_frequency[place : place + 1])[0]) - 1)
    return after.lock_in_rate - before.lock_in_rate
