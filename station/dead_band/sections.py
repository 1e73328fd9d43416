"""The dead band in the report: figure and table of the sweep, and the facts at its end."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from analysis import beat_frequency
from station.dead_band.evaluate import DeadBandFound
from station.dead_band.result import signed_beat
from station.dead_band.settings import DeadBandSettings
from station.report.figure import ACCENT, INK, LINE, SECOND, SOFT, legend_above, svg_element
from station.results.numbers import with_prefix, with_uncertainty
from station.results.parts import FactTable, PlacedFigure, Section, TextTable
from station.results.result import Result
from station.runs.store import SavedRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SIZE = (10.0, 4.2)
_CURVE_POINTS = 801
_CAPTION = (
    "Beat frequency against the rate on the axis, with the sense of rotation. Without lock-in the beats would lie "
    "on the broken line; the closer to the band, the slower they are. In the shaded band there is none."
)


def sections(found: DeadBandFound, run: SavedRun, settings: DeadBandSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    return [
        Section("What this result shows, and what it cannot", sentences=result.sentences),
        Section("Beat against rate", figures=(PlacedFigure(sweep_svg(found), _CAPTION),)),
        Section("Edges", table=_edges_table(found)),
        Section("Rates", table=_rates_table(found)),
    ]


def facts(found: DeadBandFound, run: SavedRun, settings: DeadBandSettings) -> list[FactTable]:
    """Return how the sweep was taken and evaluated."""
    table, identity = settings.table, run.facts.get("identity", {})
    bases = sorted(set(found.records.duration.tolist()))
    sweep = [
        (
            "rates on the axis",
            f"{found.records.rate.min():+.5g} to {found.records.rate.max():+.5g} deg/s and back",
        ),
        ("records", str(len(found.records.rate))),
        ("tilt of the axis", f"{table.tilt_deg:g}°"),
        ("latitude", f"{settings.site.latitude_deg:g}°"),
        ("scale factor K", f"{found.scale_factor:g} pulses/deg, for time bases and slow beats"),
    ]
    scope = [
        ("instrument", identity.get("text", "not known")),
        ("resource", settings.scope.resource or "simulated bench"),
        (
            "length of a record",
            " to ".join(with_prefix(base, "s") for base in dict.fromkeys((bases[0], bases[-1]))),
        ),
    ]
    causes = [(name.replace("_", " "), f"{u:.2g} deg/s") for name, u in found.parts.items() if u > 0]
    return [
        FactTable("Sweep", sweep),
        FactTable("Standard uncertainty of the lock-in rate", causes),
        FactTable("Oscilloscope", scope),
    ]


def sweep_svg(found: DeadBandFound) -> str:
    """Draw the beat against the rate, up and down, with the hyperbola and the dead band."""
    return svg_element("sweep", _SIZE, lambda figure: draw_sweep(found, figure))


def draw_sweep(found: DeadBandFound, figure: Figure) -> None:
    """Draw on a figure what :func:`sweep_svg` shows."""
    axes, records, band, fit = figure.add_subplot(), found.records, found.band, found.hyperbola
    middle = band.bias_rate if math.isfinite(band.bias_rate) else 0.0
    edges = middle - band.lock_in_rate, middle + band.lock_in_rate
    axes.axvspan(*edges, color=LINE, label="dead band")
    beat, up = signed_beat(found), np.array([direction == "up" for direction in records.direction])
    if fit is not None and math.isfinite(fit.lock_in_rate):
        rate = np.linspace(records.rate.min(), records.rate.max(), _CURVE_POINTS) - fit.bias_rate
        curve = np.sign(rate) * beat_frequency(fit.scale_factor, rate, fit.lock_in_rate)
        axes.plot(
            rate + fit.bias_rate, fit.scale_factor * rate, "--", color=SOFT, linewidth=0.8, label="no lock-in"
        )
        axes.plot(rate + fit.bias_rate, curve, color=INK, linewidth=1.0, label="fitted hyperbola")
    for chosen, marker, color, label in ((up, "^", ACCENT, "up"), (~up, "v", SECOND, "down")):
        axes.plot(
            records.rate[chosen], beat[chosen], marker, color=color, mfc="none", ms=5, linestyle="", label=label
        )
    axes.set(xlabel="rate on the axis, without the vertical earth rate, deg/s", ylabel="beat frequency, Hz")
    legend_above(axes, columns=5)


def _edges_table(found: DeadBandFound) -> TextTable:
    rows = []
    for name, value, half in zip(
        ("positive, beat begins", "positive, beat ends", "negative, beat begins", "negative, beat ends"),
        (*found.band.edges[0], *-found.band.edges[1]),
        found.band.edge_half_widths.ravel(),
        strict=True,
    ):
        if math.isfinite(value):
            rows.append((name, f"{value:+.6f}", f"± {half:.2g}"))
    return TextTable(("edge", "rate, deg/s", "half of the step, deg/s"), tuple(rows))


def _rates_table(found: DeadBandFound) -> TextTable:
    records, beat = found.records, signed_beat(found)
    rows = tuple(
        (
            records.direction[row],
            f"{records.rate[row]:+.6f}",
            f"{records.table_rate[row]:+.6f}",
            _beat_text(float(beat[row]), float(records.beat_u[row])),
            with_prefix(float(records.duration[row]), "s"),
            with_prefix(float(records.swing[row]), "V"),
        )
        for row in range(len(records.rate))
    )
    return TextTable(("direction", "axis, deg/s", "table, deg/s", "beat, Hz", "record", "swing"), rows)


def _beat_text(beat: float, beat_u: float) -> str:
    if beat == 0:
        return "locked"
    return with_uncertainty(beat, beat_u) if math.isfinite(beat) else "less than two periods"
