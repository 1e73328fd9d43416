"""From settings and options to a plan, and the plan as JSON."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from analysis.plan import (
    Plan,
    PlannedRate,
    PlanRequest,
    TableSpread,
    UncertaintyCurve,
    budget_elsewhere,
    plan_measurement,
    uncertainty_curve,
)
from station.errors import NoUsableSignal, UsageError
from station.lock_in.knowledge import bench_knowledge
from station.lock_in.presentation.budget_table import budget_document
from station.lock_in.rate_plan import rate_plan
from station.lock_in.settings import Settings
from station.scope.autoset import oscilloscope_steps

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
    curve: UncertaintyCurve  # for the plan's number of records
    # (float, float): Lock-in rate in deg/s, and the relative uncertainty that the same settings give if that is
    # the true one
    elsewhere: tuple[tuple[float, float], ...]


def make_plan(settings: Settings, options: PlanOptions) -> PlannedMeasurement:
    """Plan a measurement."""
    try:
        request = plan_request(settings, options)
        plan = plan_measurement(request)
        curve = uncertainty_curve(request, plan.records)
    except ValueError as error:
        raise UsageError(str(error)) from None
    return PlannedMeasurement(plan, curve, _elsewhere(plan))


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
        seconds_between_records=_between_records(settings, options),
    )


def plan_document(planned: PlannedMeasurement, sentences: list[str]) -> dict[str, Any]:
    """Return a plan as plain JSON."""
    plan, curve = planned.plan, planned.curve
    return {
        "lock_in_rate_dps": plan.request.lock_in_rate,
        "scale_factor_pulses_per_deg": plan.request.scale_factor,
        "reference": plan.request.reference,
        "wanted_u_percent": 100 * plan.request.wanted_u,
        "reached": plan.reached,
        "predicted_u_percent": 100 * plan.budget.relative_u,
        "predicted_u_dps": plan.budget.combined_u,
        "floor_u_percent": 100 * plan.floor_u,
        "records_per_rate": plan.records,
        "records": plan.records * len(plan.rates),
        "duration_s": plan.duration_s,
        "rates": [_rate_document(rate) for rate in plan.rates],
        "if_lock_in_rate_is": [
            {"lock_in_rate_dps": rate, "predicted_u_percent": 100 * u} for rate, u in planned.elsewhere
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


def _rate_document(rate: PlannedRate) -> dict[str, Any]:
    return {
        "rate_over_lock_in": rate.over_lock_in,
        "input_rate_dps": rate.input_rate,
        "table_rate_dps": rate.table_rate,
        "beat_frequency_hz": rate.beat_frequency,
        "seconds_per_division_s": rate.seconds_per_division,
        "volts_per_division_v": rate.volts_per_division,
        "record_s": rate.shape.duration,
        "periods": rate.periods,
        "samples_per_period": rate.samples_per_period,
        "amplitude_levels": rate.levels,
        "noise_rms_v": rate.shape.total_noise,
        "records": rate.shape.records,
    }


def _given(option: float | None, default: float) -> float:
    return default if option is None else option


def _measured_rates(
    settings: Settings, options: PlanOptions, lock_in_rate: float, scale_factor: float
) -> tuple[tuple[float, ...], bool]:
    """W/WL of the rates that a measurement of such a gyro goes to, and whether in both senses.

    Where the table turns already, a measurement has no choice, and the advice is the best rate to turn it at.
    """
    if settings.table.kind == "none" and not settings.named_rates:
        return (), False
    gyro = {"expected_lock_in_rate_dps": lock_in_rate, "scale_factor_pulses_per_deg": scale_factor}
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


def _table(settings: Settings, options: PlanOptions) -> TableSpread | None:
    tilt = _tilt(settings, options)
    if tilt is None:
        if options.reference == "rate":
            raise ValueError("with the rate as reference, --tilt says how the gyro's axis stands to the table's")
        return None
    stated = settings.budget
    return TableSpread(
        tilt_deg=tilt,
        tilt_u_deg=options.tilt_u_deg,
        latitude_deg=settings.site.latitude_deg,
        latitude_u_deg=stated.latitude_u_deg if stated is not None else 0.0,
        rate_u_ppm=stated.table_rate_u_ppm if stated is not None else 0.0,
    )


def _between_records(settings: Settings, options: PlanOptions) -> float:
    """Seconds that a record needs to come over the link."""
    if options.transfer_s is not None:
        return options.transfer_s
    baud = options.baud if options.baud is not None else settings.scope.baud_rate
    if not baud and (settings.simulated or settings.scope.resource.upper().startswith("ASRL")):
        baud = _FACTORY_BAUD
    return _BYTES_PER_RECORD * _SERIAL_BITS / baud if baud else _FAST_LINK_S


def _elsewhere(plan: Plan) -> tuple[tuple[float, float], ...]:
    """What the same rate, scope settings and records give if the lock-in rate is not the expected one."""
    factor = plan.request.lock_in_factor
    found = []
    for true in (plan.request.lock_in_rate / factor, plan.request.lock_in_rate * factor) if factor > 1 else ():
        try:
            u = budget_elsewhere(plan, true).relative_u
        except ValueError:  # locked
            u = math.inf
        found.append((true, u))
    return tuple(found)
