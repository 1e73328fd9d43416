"""A plan from settings and options: prediction, JSON, sentences and its plot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis import harmonic_ratio, lock_in_from_rate
from analysis.arrays import NORMAL_95
from analysis.budget import TableGeometry
from analysis.plan import (
    FEWEST_RECORDS,
    MOST_RECORDS,
    Plan,
    PlannedRate,
    PlanRequest,
    UncertaintyCurve,
    budget_elsewhere,
    plan_measurement,
    plan_of_lasers,
    plan_of_records,
    predicted_budget,
    uncertainty_curve,
)
from analysis.rotation import EARTH_RATE_DPS
from instrument.scpi import DIVISIONS
from station.errors import NoUsableSignal, StationError, UsageError
from station.lock_in import dithered
from station.lock_in.rate_plan import rate_plan, records_at_each
from station.lock_in.result import budget_document
from station.lock_in.settings import Settings, beams_knowledge, bench_knowledge
from station.measurements import measurement
from station.report.figure import ACCENT, INK, SECOND, SOFT, THIRD, legend_above, write_picture
from station.results.numbers import BEAT_FREQUENCY, INPUT_RATE, LOCK_IN_RATE, NOISE_RMS, SCALE_FACTOR
from station.results.result import TextTable, with_prefix
from station.scope.autoset import oscilloscope_steps

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BYTES_PER_RECORD = 5500  # each record is sent twice
"""2500 points, their preamble, and the questions that bring them."""

_SERIAL_BITS = 10
_FACTORY_BAUD = 9600
_FAST_LINK_S = 0.1

PAPER_OVER_LOCK_IN = 20.0
"""Zhan et al., Acta Optica Sinica 29, 960 (2009) recommend about 20 times the lock-in rate."""


@dataclass(frozen=True)
class PlanOptions:
    """What the command line says; ``None`` takes the settings."""

    wanted_percent: float = 1.0  # relative standard uncertainty
    lock_in_rate_dps: float | None = None
    lock_in_factor: float = 2.0  # the lock-in rate may be this factor larger or smaller
    scale_factor: float | None = None
    amplitude_v: float | None = None
    noise_v: float | None = None
    distortion_dbc: float | None = None
    # w/WL; empty: the best one; ``None``: those that ``gyrolock measure`` goes to
    rates: tuple[float, ...] | None = None
    both_senses: bool = False
    reference: str = "beat"  # {"beat", "rate"}
    tilt_deg: float | None = None
    tilt_u_deg: float = 0.01
    transfer_s: float | None = None  # seconds between records
    baud: int | None = None


@dataclass(frozen=True)
class PlannedMeasurement:
    """A plan with what surrounds it."""

    plan: Plan
    # lock-in rate, deg/s, and the relative uncertainty that the same settings give if it is the true one
    elsewhere: tuple[tuple[float, float], ...]
    # relative uncertainties that the same records give with single beams, of half of all lasers and of nine in ten
    beams: tuple[float, float] | None = None
    alone: tuple[float, float] | None = None  # the same by the beat alone, where it cannot tell the laser

    @property
    def reached(self) -> bool:
        """Whether what is wanted is reached, by the beat alone or with the single beams."""
        return self.plan.reached or (self.beams is not None and self.beams[0] <= self.plan.request.wanted_u)

    @cached_property
    def curve(self) -> UncertaintyCurve:
        """For the plan's number of records."""
        return uncertainty_curve(self.plan.request, self.plan.records)


def make_plan(settings: Settings, options: PlanOptions) -> PlannedMeasurement:
    """Plan a measurement."""
    try:
        request = plan_request(settings, options)
        plan = plan_measurement(request)
    except ValueError as error:
        raise UsageError(str(error)) from None
    factor = plan.request.lock_in_factor
    found = []
    for true in (plan.request.lock_in_rate / factor, plan.request.lock_in_rate * factor) if factor > 1 else ():
        try:
            u = budget_elsewhere(plan, true).relative_u
        except ValueError:  # locked
            u = math.inf
        found.append((true, u))
    channels, knowledge = len(settings.beams.channels), beams_knowledge(settings)
    beams = plan_of_lasers(plan, channels, knowledge) if channels else None
    return PlannedMeasurement(plan, tuple(found), beams, plan_of_lasers(plan, 0, knowledge))


def plan_request(settings: Settings, options: PlanOptions) -> PlanRequest:
    """Put settings and options together."""
    simulated = settings.simulation
    knowledge = bench_knowledge(settings)
    if options.distortion_dbc is not None:
        knowledge = replace(knowledge, distortion_limit=10 ** (options.distortion_dbc / 20))
    amplitude = _given(options.amplitude_v, simulated.amplitude_v if simulated else 0.4)
    probe = settings.scope.probe
    lock_in_rate = _given(options.lock_in_rate_dps, settings.gyro.expected_lock_in_rate_dps)
    scale_factor = _given(options.scale_factor, settings.gyro.scale_factor_pulses_per_deg)
    rates, both_senses = options.rates, options.both_senses
    if rates is None:
        rates, chosen = _measured_rates(settings, options, lock_in_rate, scale_factor)
        both_senses = both_senses or chosen
    baud = options.baud if options.baud is not None else settings.scope.baud_rate
    if not baud and (settings.simulated or settings.scope.resource.upper().startswith("ASRL")):
        baud = _FACTORY_BAUD
    transfer = _BYTES_PER_RECORD * _SERIAL_BITS / baud if baud else _FAST_LINK_S
    return PlanRequest(
        lock_in_rate=lock_in_rate,
        lock_in_factor=options.lock_in_factor,
        wanted_u=options.wanted_percent / 100,
        scale_factor=scale_factor,
        amplitude=amplitude,
        noise_rms=_given(options.noise_v, simulated.detector_noise_v if simulated else 0.01 * amplitude),
        noise_levels=simulated.scope_noise_levels if simulated else 0.5,
        oscilloscope=oscilloscope_steps(probe),
        knowledge=knowledge,
        reference="rate" if options.reference == "rate" else "beat",
        table=_table(settings, options),
        rates_over_lock_in=rates,
        both_senses=both_senses,
        periods_min=settings.measurement.periods_min,
        samples_per_period_min=settings.measurement.samples_per_period_min,
        fill_levels=settings.measurement.fill_levels,
        seconds_between_records=_given(options.transfer_s, transfer),
    )


def plan_document(planned: PlannedMeasurement, sentences: list[str]) -> dict[str, Any]:
    """Return a plan as plain JSON."""
    plan, curve = planned.plan, planned.curve
    return {
        LOCK_IN_RATE.key(): plan.request.lock_in_rate,
        SCALE_FACTOR.key(): plan.request.scale_factor,
        "reference": plan.request.reference,
        "wanted_u_percent": 100 * plan.request.wanted_u,
        "reached": planned.reached,
        "predicted_u_percent": 100 * plan.budget.relative_u,
        "predicted_u_dps": plan.budget.combined_u,
        "floor_u_percent": 100 * plan.floor_u,
        "records_per_rate": plan.records,
        "records": plan.records * len(plan.rates),
        "duration_s": plan.duration_s,
        **{
            key: us and {"predicted_u_percent": 100 * us[0], "nine_in_ten_u_percent": 100 * us[1]}
            for key, us in (("of_any_laser", planned.alone), ("with_beams", planned.beams))
        },
        "rates": [
            {
                "rate_over_lock_in": rate.over_lock_in,
                INPUT_RATE.key(): rate.input_rate,
                "table_rate_dps": rate.table_rate,
                BEAT_FREQUENCY.key(): rate.beat_frequency,
                "seconds_per_division_s": rate.seconds_per_division,
                "volts_per_division_v": rate.volts_per_division,
                "record_s": rate.shape.duration,
                "periods": rate.periods,
                "samples_per_period": rate.samples_per_period,
                "amplitude_levels": rate.levels,
                NOISE_RMS.key(): rate.shape.total_noise,
                "records": rate.shape.records,
            }
            for rate in plan.rates
        ],
        "if_lock_in_rate_is": [
            {LOCK_IN_RATE.key(): rate, "predicted_u_percent": 100 * u} for rate, u in planned.elsewhere
        ],
        "budget": budget_document(plan.budget),
        "curve": {
            "records_per_rate": curve.records,
            "rate_over_lock_in": curve.over_lock_in,
            **{
                f"{name}_u_percent": 100 * getattr(curve, name)
                for name in ("total", "noise", "distortion", "reference", "channel")
            },
        },
        "reasons": sentences,
    }


def _given(option: float | None, default: float) -> float:
    return default if option is None else option


def _measured_rates(
    settings: Settings, options: PlanOptions, lock_in_rate: float, scale_factor: float
) -> tuple[tuple[float, ...], bool]:
    """W/WL of the rates that a measurement of such a gyro goes to, and whether in both senses."""
    # Where the table turns already, a measurement has no choice, and the advice is the best rate to turn it at.
    if settings.table.kind == "none" and not settings.named_rates:
        return (), False
    gyro = {"expected_lock_in_rate_dps": lock_in_rate, SCALE_FACTOR.key(): scale_factor}
    expected = settings.model_copy(update={"gyro": settings.gyro.model_copy(update=gyro)})
    try:
        steps = rate_plan(expected, _tilt(settings, options) or 0.0, options.lock_in_factor).steps
    except NoUsableSignal as error:
        raise ValueError(str(error)) from None
    return tuple(sorted({step.over_lock_in for step in steps})), any(step.sense < 0 for step in steps)


def _tilt(settings: Settings, options: PlanOptions) -> float | None:
    if options.tilt_deg is None and settings.simulation is not None:
        return settings.simulation.tilt_deg
    return options.tilt_deg


def _table(settings: Settings, options: PlanOptions) -> TableGeometry | None:
    tilt = _tilt(settings, options)
    if tilt is None:
        if options.reference == "rate":
            raise ValueError("with the rate as reference, --tilt says how the gyro's axis stands to the table's")
        return None
    stated = settings.budget
    return TableGeometry(
        table_rate=1.0,
        table_rate_u=1e-6 * stated.table_rate_u_ppm if stated is not None else 0.0,
        tilt_deg=tilt,
        tilt_u_deg=options.tilt_u_deg,
        latitude_deg=settings.site.latitude_deg,
        latitude_u_deg=stated.latitude_u_deg if stated is not None else 0.0,
    )


# --------------------
# What a step of a campaign will take and give: its time, and the uncertainty of the lock-in rate


_TRIALS = 3  # records that the search for the beat takes at each rate, as a rule


@dataclass(frozen=True)
class Prediction:
    """What is known of a step beforehand."""

    # on a real bench, without warm-up and settling of the campaign; ``None`` where nobody knows it
    seconds: float | None
    u: float | None = None  # standard uncertainty of the lock-in rate, deg/s, every input counted
    u95: float | None = None  # half of its 95 % interval
    why_not: str = ""  # why there is no uncertainty
    rates: tuple[float, ...] = ()  # in expected lock-in rates, negative in the other sense; records at each
    records: int = 0


def predict(name: str, settings: Mapping[str, Any]) -> Prediction:
    """Predict one measurement."""
    kind = measurement(name)
    values = kind.kind.model.model_validate(dict(settings))
    if isinstance(values, Settings):
        return _lock_in(values) if name == "measure" else _dithered(values)
    return Prediction(kind.seconds(values), why_not="is not predicted for this measurement")


def _lock_in(settings: Settings) -> Prediction:
    try:
        tilt = settings.simulation.tilt_deg if settings.simulation is not None else 0.0
        steps = rate_plan(settings, tilt)
        ratios = tuple(sorted({step.over_lock_in for step in steps.steps}))
        both = any(step.sense < 0 for step in steps.steps)
        records = records_at_each(settings, steps)
        request = plan_request(settings, PlanOptions(rates=ratios, both_senses=both))
        planned = plan_of_records(request, records)
        beams = len(settings.beams.channels)
        lasers = plan_of_lasers(planned, beams, beams_knowledge(settings))
    except (ValueError, NoUsableSignal) as error:
        return Prediction(None, why_not=str(error))
    each = planned.duration_s / sum(rate.shape.records for rate in planned.rates)
    changes = len(planned.rates)
    seconds = planned.duration_s + changes * (_TRIALS * each + settings.table.settle_s)
    if settings.table.kind != "none":
        senses = 2 if settings.table.both_senses else 1
        seconds += senses * (settings.table.settle_s + settings.measurement.tilt_records * each)
    rates = tuple(sorted(step.sense * step.over_lock_in for step in steps.steps))
    u, u95 = planned.budget.combined_u, planned.budget.expanded_u_95
    if lasers is not None and math.isfinite(lasers[0]) and (beams or lasers[0] > planned.budget.relative_u):
        u, u95 = (factor * lasers[0] * request.lock_in_rate for factor in (1.0, NORMAL_95))
    return Prediction(seconds, u, u95, "", rates, records)


def _dithered(settings: Settings) -> Prediction:
    records, expected = settings.dither.records, settings.gyro.expected_lock_in_rate_dps
    try:
        request = plan_request(settings, PlanOptions(rates=()))
        base = dithered.time_base(settings)
    except (ValueError, StationError) as error:
        return Prediction(None, why_not=str(error))
    _, u = dithered.predicted_u(settings, base, request)
    whole = math.hypot(u / math.sqrt(records), dithered.common_share(settings) * expected)
    seconds = (records + _TRIALS) * (base * DIVISIONS + request.seconds_between_records)
    return Prediction(seconds, whole, NORMAL_95 * whole, records=records)


def plan_dithered(settings: Settings, options: PlanOptions) -> dict[str, Any]:
    """Plan a measurement of a gyro that dithers: what each time base gives, as plain JSON."""
    try:
        request = plan_request(settings, replace(options, rates=()))
    except ValueError as error:
        raise UsageError(str(error)) from None
    expected = request.lock_in_rate
    gyro = settings.gyro.model_copy(update={SCALE_FACTOR.key(): request.scale_factor})
    settings = settings.model_copy(update={"gyro": gyro})
    floor, rows = dithered.common_share(settings), list[dict[str, Any]]()
    for base in dithered.time_bases(settings):
        periods, u = dithered.predicted_u(settings, base, request)
        needed = (u / expected) ** 2 / max(request.wanted_u**2 - floor**2, 1e-300)
        records = max(FEWEST_RECORDS, math.ceil(needed)) if needed <= MOST_RECORDS else None
        each = base * DIVISIONS + request.seconds_between_records
        rows.append(
            {
                "seconds_per_division_s": base,
                "dither_periods": periods,
                "u_percent_of_one_record": 100 * u / expected,
                "records": records,
                "duration_s": None if records is None else records * each,
            }
        )
    enough = [row for row in rows if row["records"] is not None]
    best = min(enough or rows, key=lambda row: row["duration_s"] if enough else row["u_percent_of_one_record"])
    return {
        LOCK_IN_RATE.key(): expected,
        SCALE_FACTOR.key(): request.scale_factor,
        "wanted_u_percent": 100 * request.wanted_u,
        "floor_u_percent": 100 * floor,
        "reached": bool(enough),
        "time_bases": rows,
        "best": best,
    }


def dithered_words(plan: Mapping[str, Any]) -> tuple[str, TextTable]:
    """Return a plan of a gyro that dithers as a sentence and a table."""
    best, wanted = plan["best"], plan["wanted_u_percent"]
    where = f"{best['dither_periods']:.2g} dither periods ({with_prefix(best['seconds_per_division_s'], 's/div')})"
    said = (
        f"{best['records']} records of {where}, about {duration_words(best['duration_s'])}: the lock-in rate to "
        f"{wanted:.3g} % (k = 1)."
        if plan["reached"]
        else f"{wanted:.3g} % cannot be reached: scale factor and time base are known to "
        f"{plan['floor_u_percent']:.2g} %, and no more than {MOST_RECORDS} records are planned. "
        f"A record of {where} tells most."
    )
    rows = tuple(
        (
            with_prefix(row["seconds_per_division_s"], "s/div"),
            f"{row['dither_periods']:.2g}",
            f"{row['u_percent_of_one_record']:.2g} %",
            "none" if row["records"] is None else str(row["records"]),
        )
        for row in plan["time_bases"]
    )
    return said, TextTable(("time base", "dither periods", "u of one record", "records"), rows)


# --------------------
# A plan in words: what to set, what will come of it, and why not 20 times the lock-in rate


_LARGE_SWING = 0.05


def plan_sentences(planned: PlannedMeasurement) -> list[str]:
    """Say what the plan comes to and what to mind."""
    plan = planned.plan
    parts = [f"{100 * u:.2g} % if it is {rate:.3g} deg/s" for rate, u in planned.elsewhere if math.isfinite(u)]
    locked = [f"{rate:.3g}" for rate, u in planned.elsewhere if not math.isfinite(u)]
    said = [f"The lock-in rate is only expected; the same settings give {' and '.join(parts)}."] if parts else []
    if locked:
        said.append(
            f"At a lock-in rate of {locked[0]} deg/s the gyro would be locked at this rate: choose a faster one."
        )
    first = [_outcome(plan), *_beams(planned)]
    if planned.reached and not plan.reached:  # by the beams: that is what is asked for
        first = [first[1], f"By the beat alone {first[0]}"]
    return [*first, *_why_not_faster(plan), *_senses(planned), *said, *_warnings(plan)]


def rate_words(rate: PlannedRate) -> tuple[str, ...]:
    """Return one rate of a plan as text: rate, beat, time base, vertical scale, record, records."""
    table = f", table {rate.table_rate:+.4g} deg/s" if math.isfinite(rate.table_rate) else ""
    return (
        f"{rate.over_lock_in:.3g} WL = {rate.input_rate:+.4g} deg/s{table}",
        with_prefix(rate.beat_frequency, "Hz"),
        with_prefix(rate.seconds_per_division, "s/div"),
        f"{with_prefix(rate.volts_per_division, 'V/div')} ({rate.levels:.0f} levels)",
        f"{rate.periods:.0f} periods of {rate.samples_per_period:.0f} samples",
        f"{rate.shape.records}",
    )


def duration_words(seconds: float) -> str:
    """Write a duration."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s" if whole else "less than 1 s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def _outcome(plan: Plan) -> str:
    wanted, got = 100 * plan.request.wanted_u, 100 * plan.budget.relative_u
    total = plan.records * len(plan.rates)
    taken = f"{total} record{'s' if total > 1 else ''}, about {duration_words(plan.duration_s)}"
    if plan.reached:
        return f"{taken}: the lock-in rate to {got:.2g} % (k = 1), where {wanted:.3g} % is wanted."
    line = next(iter(plan.budget.inputs))
    return (
        f"{wanted:.3g} % cannot be reached: no number of records goes below {100 * plan.floor_u:.2g} %, "
        f"most of it from this: {line.quantity}. {taken}: {got:.2g} %."
    )


def _beams(planned: PlannedMeasurement) -> list[str]:
    """What the single beams will add; nobody knows the laser, so that it is a median."""
    if planned.beams is None:
        return []
    if not math.isfinite(planned.beams[0]):
        return ["With the single beams: the slowest rate is too slow for most lasers; the beat alone counts."]
    half, most = (f"{100 * u:.2g} %" for u in planned.beams)
    total = planned.plan.records * len(planned.plan.rates)  # never one: they tell nothing at one rate
    return [
        f"With the single beams {total} records: {half} (k = 1) for half of all lasers, {most} for nine in ten."
    ]


def _why_not_faster(plan: Plan) -> list[str]:
    """Compare the plan's slowest rate with the paper's advice, in numbers."""
    request, chosen = plan.request, plan.rates[0].over_lock_in
    if chosen >= 0.9 * PAPER_OVER_LOCK_IN:
        return []
    here, there = (float(harmonic_ratio(1 / over)) for over in (chosen, PAPER_OVER_LOCK_IN))
    alone, noises = replace(request, both_senses=False), ("noise", "quantization")
    budgets = (predicted_budget(alone, over, 1).inputs for over in (chosen, PAPER_OVER_LOCK_IN))
    noise_here, noise_there = (math.hypot(*(one.contribution for one in b if one.name in noises)) for b in budgets)
    more = (noise_there / noise_here) ** 2
    limit = request.knowledge.distortion_limit
    said = [
        f"Why not 20 times the lock-in rate: there the second harmonic is {100 * there:.2g} % of the fundamental, "
        f"at {chosen:.3g} times it is {100 * here:.2g} %. The same noise weighs {noise_there / noise_here:.1f} "
        f"times as much at 20, so that it takes {more:.0f} times as many records"
        + (
            f"; distortion of {20 * math.log10(limit):.0f} dBc can falsify records of one sense by "
            f"±{100 * _largest(limit, there):.2g} % there and by ±{100 * _largest(limit, here):.2g} % here."
            if limit > 0 and math.isfinite(limit)
            else "; distortion of detector and oscilloscope weighs as much more."
        )
    ]
    low = float(lock_in_from_rate(here, 1.0, "paper-13")) * chosen - 1
    said.append(
        "The advice to stay far away belongs to the approximate formula, equation (13) of Zhan et al. (2009), "
        f"which would be wrong by {100 * low:+.2g} % here; the exact relation holds at every rate above lock-in. "
        "What limits the slow side is that the lock-in rate is only guessed and that no table turns perfectly "
        "steadily."
    )
    return said


def _largest(limit: float, ratio: float) -> float:
    """Largest relative error of one record with distortion `limit`, its own reference."""
    return limit / ratio * (1 + ratio**2)


def _senses(planned: PlannedMeasurement) -> list[str]:
    request = planned.plan.request
    if request.reference == "rate":
        own = plan_measurement(replace(request, reference="beat"))
        said = (
            "The table's rate is the reference, so tilt and earth rate weigh more the slower it turns. With each "
            f"record as its own reference {own.records * len(own.rates)} records from "
            f"{own.rates[0].over_lock_in:.3g} times lock-in on give {100 * own.budget.relative_u:.2g} %."
        )
        return [said, *_separation(planned)]
    return _separation(planned)


def _separation(planned: PlannedMeasurement) -> list[str]:
    plan, request = planned.plan, planned.plan.request
    rates = len({rate.over_lock_in for rate in plan.rates})
    if request.both_senses:
        said = (
            "Both senses of rotation separate distortion from lock-in at no cost: it adds to the complex ratio of "
            "both alike, while lock-in turns round with the sense."
        )
        more = " Several rates show the bandwidth of the channel and the gain corner of the laser too."
        return [said + more * (rates > 1)]
    if request.distortion_separated:
        both = plan_measurement(replace(request, both_senses=True))
        few, most = "tell distortion from lock-in, but", "most of the uncertainty"
        if planned.alone:
            half, nine = (f"{100 * u:.2g} %" if math.isfinite(u) else "anything" for u in planned.alone)
            few = f"may have two solutions ({half} for half of all lasers, {nine} for nine in ten), and"
        return [
            f"{rates} rates in one sense {few} what separates them costs {most}. In both senses "
            f"(--both-senses) {both.records * len(both.rates)} records give {100 * both.budget.relative_u:.2g} %."
        ]
    line = next(iter(plan.budget.inputs))
    if line.name == "distortion" and plan.budget.share(line) > 0.3:
        return [
            f"Distortion makes {100 * plan.budget.share(line):.0f} % of the variance. Taken in both senses of "
            "rotation (--both-senses), the same records are free of it."
        ]
    return []


def _warnings(plan: Plan) -> list[str]:
    said = []
    table, slowest = plan.request.table, plan.rates[0]
    if table is not None:
        latitude, tilt = math.radians(table.latitude_deg), math.radians(table.tilt_deg)
        swing = EARTH_RATE_DPS * math.cos(latitude) * abs(math.sin(tilt)) / abs(slowest.input_rate)
        if swing > _LARGE_SWING:
            said.append(
                f"The earth's rotation changes the rate on the axis by ±{100 * swing:.0f} % in a table turn: "
                "take the records at one azimuth, and let each be its own reference."
            )
        if abs(slowest.input_rate) * (1 - swing) < 1.05 * plan.request.lock_in_rate:
            said.append("At some azimuths the rate would come too close to lock-in: less tilt or a faster rate.")
    for rate in plan.rates:
        if rate.samples_per_period < plan.request.samples_per_period_min * 0.999 or rate.periods < 3:
            said.append(
                f"No time base of the oscilloscope suits a beat of {with_prefix(rate.beat_frequency, 'Hz')}: "
                f"{rate.periods:.1f} periods of {rate.samples_per_period:.1f} samples."
            )
    return said


# --------------------
# Uncertainty of the lock-in rate against the rate at which it is measured


_SIZE = (8.4, 4.8)
_DEPTH, _HIGHEST = 12.0, 20.0  # the plot reaches these factors below and above the smallest uncertainty


def write_plan_plot(path: Path, planned: PlannedMeasurement) -> None:
    """Draw the curve of a plan into a .svg, .png or .pdf file."""
    write_picture(path, "plan", _SIZE, lambda figure: _draw(figure, planned))


def _draw(figure: Figure, planned: PlannedMeasurement) -> None:
    axes = figure.add_subplot()
    curve, plan = planned.curve, planned.plan
    over, total = curve.over_lock_in, 100 * curve.total
    lowest = min(float(total.min()) / _DEPTH, 50 * plan.budget.relative_u)
    axes.plot(over, total, color=INK, linewidth=2.2, label="all together", zorder=5)
    reference = "scale factor, time base" if plan.request.reference == "beat" else "rate on the axis"
    for name, label, color in (
        ("noise", "noise and rounding", ACCENT),
        ("distortion", "distortion", SECOND),
        ("reference", reference, THIRD),
        ("channel", "bandwidth, gain", SOFT),
    ):
        part = 100 * getattr(curve, name)
        if np.any(part > lowest):
            axes.plot(over, part, color=color, label=label)
    axes.set(
        xscale="log",
        yscale="log",
        xlim=(1, float(over[-1])),
        ylim=(lowest, min(1.5 * float(total.max()), _HIGHEST * float(total.min()))),
    )
    axes.set_xlabel("rate on the axis over lock-in rate, W/WL")
    each = f"{curve.records} record{'s' if curve.records > 1 else ''} at one rate"
    senses = " in each sense" if plan.request.both_senses else ""
    axes.set_ylabel(f"standard uncertainty of the lock-in rate, %\n({each}{senses})")
    ticks = [1, 2, 3, 5, 8, 15, 20, 30, 50, 100]
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.minorticks_off()
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    _mark(axes, planned)
    legend_above(axes, columns=5)


def _mark(axes: Axes, planned: PlannedMeasurement) -> None:
    """Mark the wanted uncertainty, the plan's rates and the paper's advice."""
    plan, curve = planned.plan, planned.curve
    rates = sorted({rate.over_lock_in for rate in plan.rates})
    lines = [(100 * plan.request.wanted_u, "wanted", SOFT)]
    if len(rates) > 1:
        lines.append((100 * plan.budget.relative_u, "all rates together", ACCENT))
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.0}
    for percent, text, color in lines:
        axes.axhline(percent, color=color, linewidth=0.9, linestyle=(0, (5, 3)))
        at = axes.get_yaxis_transform()
        axes.text(
            0.99,
            percent,
            text,
            transform=at,
            ha="right",
            va="center",
            color=color,
            fontsize=8.5,
            bbox=box,
            zorder=7,
        )
    verticals = [(rates[0], "plan", ACCENT, 0.97), *((rate, "", ACCENT, 0.97) for rate in rates[1:])]
    verticals.append((PAPER_OVER_LOCK_IN, "20, as in the paper", SECOND, 0.91))
    for rate, text, color, height in verticals:
        axes.axvline(rate, color=color, linewidth=0.9, linestyle=(0, (2, 2)))
        at = axes.get_xaxis_transform()
        axes.text(rate * 1.03, height, text, transform=at, va="top", color=color, fontsize=8.5, bbox=box, zorder=7)
    places = [*rates, PAPER_OVER_LOCK_IN]
    values = np.interp(np.log(places), np.log(curve.over_lock_in), 100 * curve.total)
    axes.plot(places, values, "o", color=INK, ms=6, zorder=6)
