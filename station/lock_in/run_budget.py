"""The uncertainty budget of an evaluated run, at one rate or at several."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis import LockInEstimate, RatesFit, RatesFlag, fit_rates
from analysis.budget import (
    BenchKnowledge,
    Budget,
    BudgetInput,
    Corner,
    Distribution,
    lock_in_budget,
    operating_point,
)
from station.lock_in.budget import bench_knowledge, table_geometry

if TYPE_CHECKING:
    from station.lock_in.evaluate import Evaluation
    from station.settings.load import Settings

Complexes = NDArray[np.complex128]
Floats = NDArray[np.float64]
_RECTANGLE = math.sqrt(3.0)
_SAMPLES_FITTED = 6
_COMMON = ("scale_factor", "time_base", "table_rate", "tilt", "latitude", "earth_rate", "azimuth", "distortion")
"""Lines that are the same for one rate and for several."""


def run_budget(evaluation: Evaluation, settings: Settings) -> Budget | None:
    """Make the budget of an evaluated run.

    Parameters
    ----------
    evaluation : Evaluation
    settings : Settings
        Those of the run.

    Returns
    -------
    Budget or None
        ``None`` without a usable lock-in rate, and for the approximations of the paper, whose own error is none of
        its inputs.
    """
    method, several = evaluation.method, evaluation.several
    if not evaluation.usable or method.relation != "exact" or float(evaluation.combined.lock_in_rate) <= 0:
        return None
    if method.input_rate is not None and evaluation.table_check is None:
        return None
    knowledge = bench_knowledge(settings, table_geometry(evaluation, settings))
    if evaluation.quadratures is not None:
        knowledge = replace(knowledge, distortion_separated=True)
    try:
        if several is not None and several.by_beat is not None:
            return _rates_budget(evaluation, several.by_beat, knowledge)
        samples, spacing = _converter(evaluation)
        point = operating_point(evaluation.each, evaluation.combined, samples=samples, level_spacing=spacing)
        return lock_in_budget(point, knowledge, "beat" if method.input_rate is None else "rate")
    except ValueError:
        return None


def _converter(evaluation: Evaluation) -> tuple[int, float]:
    """Samples in a record, and volts per level."""
    spacing = float(np.mean([abs(wave.preamble.ymult) for wave in evaluation.waveforms]))
    return min(wave.codes.size for wave in evaluation.waveforms), spacing


def _rates_budget(evaluation: Evaluation, fit: RatesFit, knowledge: BenchKnowledge) -> Budget:
    """Budget of a fit over several rates: what acts on every rate in its own way is put through the fit."""
    several = evaluation.several
    assert several is not None  # the caller has looked
    one = several.reference_group.combined
    separated = not math.isnan(fit.distortion) or knowledge.distortion_separated
    known = replace(knowledge, distortion_separated=separated)
    each = evaluation.each[np.asarray(several.reference_group.rows)]
    samples, spacing = _converter(evaluation)
    point = operating_point(each, one, samples=samples, level_spacing=spacing)
    common = lock_in_budget(point, known, "beat")
    scale = fit.lock_in_rate / common.lock_in_rate
    lines = [replace(line, sensitivity=line.sensitivity * scale) for line in common.inputs if line.name in _COMMON]
    lines += _from_fit(evaluation, fit)
    unstated = [text for text in common.unstated if "bandwidth" not in text and "gain" not in text]
    for line, missing in _from_channel(evaluation.each, fit, knowledge):
        if line is None:
            unstated.append(missing)
        else:
            lines.append(line)
    return Budget(fit.lock_in_rate, "beat", tuple(lines), tuple(unstated))


def _from_fit(evaluation: Evaluation, fit: RatesFit) -> Iterator[BudgetInput]:
    """Noise of the records, and what it costs to find distortion and gain corner from the same records."""
    scattered = bool(fit.flags & RatesFlag.MISFIT)
    samples, _ = _converter(evaluation)
    freedom = float(fit.degrees_of_freedom if scattered else fit.used.sum() * (samples - _SAMPLES_FITTED))
    noise_u = fit.lock_in_rate_u / max(fit.cost, 1.0)
    note = "enlarged to the scatter between records" if scattered else "from what the fit leaves of the records"
    yield BudgetInput(
        "noise", "noise of the records", "deg/s", fit.lock_in_rate, noise_u, "normal", 1.0, freedom, note
    )
    fitted = {"distortion": "distortion", "gain": "the gain corner"}.get(
        fit.model, "distortion and the gain corner"
    )
    if fit.model != "lock-in":
        rest = math.sqrt(max(fit.lock_in_rate_u**2 - noise_u**2, 0.0))
        quantity = f"noise, by way of {fitted}"
        note = f"{fitted} fitted to the same records"
        yield BudgetInput("separation", quantity, "deg/s", 0.0, rest, "normal", 1.0, freedom, note)


def _from_channel(
    each: LockInEstimate, fit: RatesFit, knowledge: BenchKnowledge
) -> Iterator[tuple[BudgetInput | None, str]]:
    """Filters of channel and laser: the fit again with the ratios that would be seen without them."""
    frequency = each.beat_frequency
    for name, quantity, corner, factor in (
        ("bandwidth", "bandwidth of the channel", knowledge.bandwidth, _low_pass),
        ("high_pass", "AC coupling of the channel", knowledge.high_pass, _high_pass),
    ):
        if math.isnan(corner.hz):
            yield None, quantity
        elif corner.hz in (0.0, math.inf):
            yield BudgetInput(name, quantity, "Hz", corner.hz, 0.0, "rectangular", 0.0, note="none"), ""
        elif corner.corrected:
            moved = factor(frequency, corner.hz + corner.u_hz) / factor(frequency, corner.hz)
            shift = _shift(each, fit, 1 / moved)
            yield _line(name, quantity, corner, abs(shift), "normal", "corrected for"), ""
        else:
            shift = _shift(each, fit, 1 / factor(frequency, corner.hz))
            yield _line(name, quantity, corner, abs(shift) / _RECTANGLE, "rectangular", "not corrected for"), ""
    if math.isfinite(knowledge.response_u):
        quantity = "response of the channel at 2f over f, measured"
        slope = -fit.lock_in_rate
        yield (
            BudgetInput("response", quantity, "1", 1.0, knowledge.response_u, "normal", slope, note="corrected"),
            "",
        )
    yield _gain(each, fit, knowledge.gain)


def _gain(each: LockInEstimate, fit: RatesFit, corner: Corner) -> tuple[BudgetInput | None, str]:
    quantity = "gain saturation of the laser"
    if not math.isnan(fit.gain_time):
        note = "does not enter: fitted"
        return BudgetInput("gain_corner", quantity, "Hz", 0.0, 0.0, "rectangular", 0.0, note=note), ""
    if math.isnan(corner.hz):
        return None, quantity
    shift = _shift(each, fit, np.asarray(1 + 1j * each.beat_frequency / corner.hz))
    return _line("gain_corner", quantity, corner, abs(shift) / _RECTANGLE, "rectangular", "not fitted"), ""


def _line(name: str, quantity: str, corner: Corner, u: float, kind: Distribution, what: str) -> BudgetInput:
    note = f"corner {corner.hz:g} Hz, {what}: the fit repeated with its effect"
    return BudgetInput(name, f"{quantity}: shift of the fit", "deg/s", 0.0, u, kind, 1.0, note=note)


def _shift(each: LockInEstimate, fit: RatesFit, factor: Complexes) -> float:
    """Change of the lock-in rate in deg/s if the ratios were multiplied by a factor."""
    moved = replace(each, complex_ratio=each.complex_ratio * factor)
    again = fit_rates(moved, input_rate=fit.rate, reference=fit.reference, model=fit.model)
    return again.lock_in_rate - fit.lock_in_rate


def _low_pass(frequency: Floats, corner_hz: float) -> Complexes:
    """Factor that one pole puts on the complex ratio of second and first harmonic."""
    first, second = 1j * frequency / corner_hz, 2j * frequency / corner_hz
    return _on_ratio(np.asarray(1 / (1 + first)), np.asarray(1 / (1 + second)))


def _high_pass(frequency: Floats, corner_hz: float) -> Complexes:
    """The same for AC coupling."""
    first, second = 1j * frequency / corner_hz, 2j * frequency / corner_hz
    return _on_ratio(np.asarray(first / (1 + first)), np.asarray(second / (1 + second)))


def _on_ratio(first: Complexes, second: Complexes) -> Complexes:
    return np.asarray(second * np.abs(first) / first**2)
