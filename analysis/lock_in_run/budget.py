"""The uncertainty budget of a run, at one rate or through the fit over several."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from analysis.arrays import Complexes
from analysis.budget import (
    BenchKnowledge,
    Budget,
    BudgetInput,
    Corner,
    Distribution,
    OperatingPoint,
    TableGeometry,
    lock_in_budget,
    operating_point,
)
from analysis.channel import gain_on_ratio, high_pass_on_ratio, low_pass_on_ratio
from analysis.errors import NoBudget, NoFit
from analysis.lock_in_run.records import RecordArrays, RunKnowledge
from analysis.lock_in_run.result import LockInRun
from analysis.lockin_rate import LockInEstimate
from analysis.rotation import earth_rate_on_axis
from analysis.several_rates import RatesFit, RatesFlag, fit_rates

_RECTANGLE = math.sqrt(3.0)
_SAMPLES_FITTED = 6
_EAST = 90.0


def run_budget(found: LockInRun, slow: RecordArrays, knowledge: RunKnowledge) -> Budget:
    """Make the budget of a run.

    Parameters
    ----------
    found : LockInRun
        All but the budget.
    slow : RecordArrays
        The records that it was found from.
    knowledge : RunKnowledge

    Raises
    ------
    NoBudget
        Without a usable lock-in rate; with a rate that was given, of which nobody said how well it is known; for
        the approximations of the paper, whose own error is none of its inputs; if what is stated contradicts
        itself.
    """
    _check_result(found)
    bench = replace(knowledge.bench, table=_table_geometry(found, knowledge))
    if found.quadratures is not None:
        bench = replace(bench, distortion_separated=True)
    if found.several is not None and found.several.by_beat is not None:
        one, rows = found.several.reference_group.combined, np.array(found.several.reference_group.rows)
        point = _operating_point(found.each[rows], one, slow)
        return _rates_budget(found.each, found.several.by_beat, point, bench, int(slow.samples.min()))
    return lock_in_budget(_operating_point(found.each, found.combined, slow), bench)


def _check_result(found: LockInRun) -> None:
    rate, rate_u = float(found.combined.lock_in_rate), float(found.combined.lock_in_rate_u)
    if not found.usable:
        raise NoBudget("there is no lock-in rate")
    if found.method.relation != "exact":
        raise NoBudget("the approximations of the paper are wrong by more than their noise")
    if found.method.input_rate is not None:
        raise NoBudget("the rate was given, and nobody said how well it is known")
    if rate <= 0 or not math.isfinite(rate_u):
        raise NoBudget("the records do not tell the lock-in rate from zero")


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
    separated = not math.isnan(fit.distortion) or bench.distortion_separated
    # what is common stands as at one rate; the channel comes below
    plain = replace(
        bench,
        distortion_separated=separated,
        bandwidth=Corner(math.inf),
        high_pass=Corner(0.0),
        gain=Corner(math.inf),
        response_u=math.nan,
    )
    at_one_rate = lock_in_budget(point, plain)
    scale = fit.lock_in_rate / at_one_rate.lock_in_rate
    lines = [replace(line, sensitivity=line.sensitivity * scale) for line in at_one_rate.inputs if line.common]
    lines += _from_fit(fit, samples)
    unstated = list(at_one_rate.unstated)
    for line, missing in _from_channel(each, fit, bench):
        if line is None:
            unstated.append(missing)
        else:
            lines.append(line)
    return Budget(fit.lock_in_rate, "beat", tuple(lines), tuple(unstated))


def _from_fit(fit: RatesFit, samples: int) -> Iterator[BudgetInput]:
    """Noise of the records, and what it costs to find distortion and gain corner from the same records."""
    scattered = bool(fit.flags & RatesFlag.MISFIT)
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
    each: LockInEstimate, fit: RatesFit, bench: BenchKnowledge
) -> Iterator[tuple[BudgetInput | None, str]]:
    """Filters of channel and laser: the fit again with the ratios that would be seen without them."""
    frequency = each.beat_frequency
    for name, quantity, corner, factor in (
        ("bandwidth", "bandwidth of the channel", bench.bandwidth, low_pass_on_ratio),
        ("high_pass", "AC coupling of the channel", bench.high_pass, high_pass_on_ratio),
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
    if math.isfinite(bench.response_u):
        quantity, slope = "response of the channel at 2f over f, measured", -fit.lock_in_rate
        u = bench.response_u
        yield BudgetInput("response", quantity, "1", 1.0, u, "normal", slope, note="corrected"), ""
    yield _gain(each, fit, bench.gain)


def _gain(each: LockInEstimate, fit: RatesFit, corner: Corner) -> tuple[BudgetInput | None, str]:
    quantity = "gain saturation of the laser"
    if not math.isnan(fit.gain_time):
        note = "does not enter: fitted"
        return BudgetInput("gain_corner", quantity, "Hz", 0.0, 0.0, "rectangular", 0.0, note=note), ""
    if math.isnan(corner.hz):
        return None, quantity
    shift = _shift(each, fit, 1 / gain_on_ratio(each.beat_frequency, corner.hz))
    return _line("gain_corner", quantity, corner, abs(shift) / _RECTANGLE, "rectangular", "not fitted"), ""


def _line(name: str, quantity: str, corner: Corner, u: float, kind: Distribution, what: str) -> BudgetInput:
    note = f"corner {corner.hz:g} Hz, {what}: the fit repeated with its effect"
    return BudgetInput(name, f"{quantity}: shift of the fit", "deg/s", 0.0, u, kind, 1.0, note=note)


def _shift(each: LockInEstimate, fit: RatesFit, factor: Complexes) -> float:
    """Change of the lock-in rate in deg/s if the ratios were multiplied by a factor."""
    moved = replace(each, complex_ratio=each.complex_ratio * factor)
    try:
        again = fit_rates(moved, input_rate=fit.rate, reference=fit.reference, model=fit.model)
    except NoFit as reason:
        raise NoBudget(f"with the effect of the channel nothing can be fitted: {reason}") from None
    return again.lock_in_rate - fit.lock_in_rate
