"""What each input contributes to the uncertainty of the scale factor of one axis."""

from __future__ import annotations

import math
from typing import Any

from station.fibre_gyro.common import PPM
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.table.evaluate import AxisResult
from station.results.contributions import Contribution, budget_document
from station.results.numbers import ppm, with_uncertainty

_NO_DRIFT = "too few runs, or no clock that tells when they were taken: counted as scatter"


def axis_budget(one: AxisResult, settings: FogSettings) -> dict[str, Any]:
    """Return the budget of the scale factor of one axis, as JSON."""
    fit = one.fit
    parts = {name: PPM * value / abs(fit.scale_factor) for name, value in fit.contributions.items()}
    lines = [
        Contribution("noise", "noise within the runs", parts["noise"], True, _noise_note(one)),
        _slow_noise(one, parts["slow noise"]),
        _stated(settings, parts["stated"]),
        Contribution(
            "scatter",
            "scatter from run to run beyond these",
            parts["scatter"],
            not fit.scatter_assumed,
            "10 ppm: no run repeats another" if fit.scatter_assumed else _freedom(one),
        ),
        _table_rate(settings, parts["table rate"]),
        _drift(one),
        _left_out(one),
    ]
    if "clock" in parts:
        quantity, note = "clock of the gyro against the computer's", "an angle in each word: K holds its interval"
        lines.append(Contribution("clock", quantity, parts["clock"], True, note))
    return budget_document("scale factor", lines, PPM * fit.scale_factor_u / abs(fit.scale_factor))


def noise_sentence(one: AxisResult) -> str:
    """Say whether the noise model or the scatter of the runs rules the uncertainty of K; empty without a model."""
    if one.noise is None:
        return ""
    parts = {name: PPM * value / abs(one.fit.scale_factor) for name, value in one.fit.contributions.items()}
    by_model = math.hypot(parts["slow noise"], parts["noise"] if one.noise_by_model else 0.0)
    by_runs = math.hypot(parts["scatter"], 0.0 if one.noise_by_model else parts["noise"])
    rules = "the noise model rules" if by_model >= by_runs else "the scatter rules"
    within = "" if one.noise_by_model else " The words scatter by more than it says: their own noise counts."
    return (
        f"{one.axis}: to u(K) the noise model of {one.noise.source} contributes {by_model:.2g} ppm, what the runs "
        f"scatter beyond it {by_runs:.2g} ppm: {rules}.{within}"
    )


def _noise_note(one: AxisResult) -> str:
    walk = f"{one.fit.angle_random_walk:.2g} deg/√h"
    if one.noise is not None and one.noise_by_model:
        return f"{walk}, by the noise model"
    return f"{walk}, by the scatter of the words over the turns"


def _slow_noise(one: AxisResult, part: float) -> Contribution:
    quantity = "bias instability and rate random walk"
    if one.noise is None:
        note = "no noise model (--noise): counted as far as the runs scatter by it"
        return Contribution("slow noise", quantity, 0.0, False, note)
    return Contribution("slow noise", quantity, part, True, one.noise.source)


def _stated(settings: FogSettings, part: float) -> Contribution:
    stated = settings.table.irreproducibility_ppm
    note = "table.irreproducibility_ppm: counted as far as the runs scatter by it" if stated is None else (
        f"table.irreproducibility_ppm = {stated:g}"
    )  # fmt: skip
    quantity = "irreproducibility of table rate and scale factor"
    return Contribution("irreproducibility", quantity, part, stated is not None, note)


def _freedom(one: AxisResult) -> str:
    return f"the residuals of {len(one.keys)} runs, {one.fit.degrees_of_freedom} degrees of freedom"


def _table_rate(settings: FogSettings, part: float) -> Contribution:
    stated = settings.table.rate_u_ppm
    note = "table.rate_u_ppm: K is in units of the table's own deg/s" if stated is None else "table.rate_u_ppm"
    return Contribution("table rate", "rate of the table, common to all runs", part, stated is not None, note)


def _drift(one: AxisResult) -> Contribution:
    drift, u = one.fit.drift_dph_per_h
    quantity = "drift of the bias"
    if not math.isfinite(drift):
        return Contribution("drift", quantity, 0.0, False, _NO_DRIFT)
    change = ppm(PPM * one.fit.drift_in_scale_factor / one.fit.scale_factor)
    note = f"{with_uncertainty(drift, u)} deg/h per h taken out, which changed K by {change}; the rest is in noise"
    return Contribution("drift", quantity, 0.0, True, note)


def _left_out(one: AxisResult) -> Contribution:
    missing, far = (sum(getattr(window, name) for window in one.windows) for name in ("missing", "outliers"))
    note = f"{missing} missing, {far} outliers, of {sum(window.samples for window in one.windows)}: left out"
    return Contribution("words", "missing and outlying words", 0.0, True, note)
