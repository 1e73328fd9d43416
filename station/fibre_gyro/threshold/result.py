"""Threshold, resolution and dead zone as numbers and sentences."""

from __future__ import annotations

import math
from typing import Any

from analysis.fibre_gyro import Edge
from station.fibre_gyro.common import COUNTS_PER_DPS, undecided_limits
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.threshold.evaluate import AxisThreshold, Series, ThresholdFound
from station.results.result import Measured, Result
from station.runs.store import SavedRun

LIMITED = ("threshold_dps", "resolution_dps", "dead_zone_dps")
_SENSES = {1: "positive", -1: "negative"}


def result(found: ThresholdFound, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    axes = [_axis(one) for one in found.axes]
    alone = len(axes) == 1
    lines = tuple(line for one in found.axes for line in _lines(one, several=not alone))
    watched = (*_to_watch(found, settings), *undecided_limits(axes, LIMITED, settings))
    first = found.axes[0]
    return Result(
        name="result",
        value=f"Threshold {in_words(first.ladder.says.threshold)}",
        document={**(axes[0] if alone else {}), "axes": axes, "left_out": found.left_out},
        measured=tuple(_measured(one, name, "" if alone else one["axis"]) for one in axes for name in LIMITED),
        lines=lines,
        summary=[("", line) for line in lines],
        sentences=_sentences(found, settings),
        to_watch=watched,
        flags=watched,
        left_out=found.left_out,
    )


def in_words(edge: Edge) -> str:
    """Write an edge with its interval, or as a bound."""
    if edge.seen:
        return f"{edge.value:.3g} deg/s (95 %: {edge.low_95:.3g} to {edge.high_95:.3g})"
    if math.isinf(edge.high_95):
        return f"above {edge.low_95:.3g} deg/s" if edge.low_95 else "not known"
    return f"below {edge.high_95:.3g} deg/s"


def _measured(axis: dict[str, Any], name: str, of: str) -> Measured:
    """A bound stands for what is below it."""
    value = axis[name]
    return Measured(name, axis[name.replace("_dps", "_high_95_dps")] if value is None else value, of)


def _edge(name: str, edge: Edge | None) -> dict[str, Any]:
    if edge is None:
        return dict.fromkeys((f"{name}_dps", f"{name}_low_95_dps", f"{name}_high_95_dps"))
    return {
        f"{name}_dps": edge.value if edge.seen else None,
        f"{name}_low_95_dps": edge.low_95,
        f"{name}_high_95_dps": edge.high_95 if math.isfinite(edge.high_95) else math.nan,
    }


def _axis(one: AxisThreshold) -> dict[str, Any]:
    says, resolution = one.ladder.says, one.resolution
    return {
        "axis": one.axis,
        **_edge("threshold", says.threshold),
        **_edge("resolution", resolution.says.threshold if resolution else None),
        **_edge("dead_zone", says.width),
        **_edge("dead_zone_above", says.rising),
        **_edge("dead_zone_below", says.falling),
        "resolution_at_dps": resolution.reference_dps if resolution else None,
        "reference_dps": one.ladder.reference_dps,
        "scale_factor_counts_per_dps": one.scale_factor,
        "wander_dph": 3600 * one.ladder.found.wander / abs(one.scale_factor),
        "points": _points(one.ladder),
        "resolution_points": _points(resolution) if resolution else [],
    }


def _points(series: Series) -> list[dict[str, Any]]:
    found = series.found
    names = ("name", "input_dps", "ratio", "ratio_u")
    rows = zip(series.keys, found.input_dps, found.ratio, found.ratio_u, strict=True)
    return [dict(zip(names, row, strict=True)) for row in rows]


def _lines(one: AxisThreshold, *, several: bool) -> tuple[str, ...]:
    begin = f"Axis {one.axis}: threshold {in_words(one.ladder.says.threshold)}; dead" if several else "Dead"
    lines = [f"{begin} zone {in_words(one.ladder.says.width)} wide."]
    if one.resolution:
        at = f"about {one.resolution.reference_dps:.3g} deg/s"
        lines.append(f"Resolution {in_words(one.resolution.says.threshold)}, {at}.")
    return tuple(lines)


def _sentences(found: ThresholdFound, settings: FogSettings) -> tuple[str, ...]:
    said = [
        "r is the change of the output over the one that K times the change of the input would give. Threshold "
        "and resolution are the smallest inputs, of the worse sense, with r of one half or more; within the dead "
        "zone r is below a tenth (terms of IEEE Std 528). What lies between two rungs of the ladder is in the "
        "interval.",
    ]
    if any(not one.ladder.says.threshold.seen for one in found.axes):
        said.append(
            "The smallest input passes already: the result is a bound. A ladder that begins lower "
            "(threshold.lowest_dps) makes it smaller, as far as the noise lets it."
        )
    if settings.threshold.table_axis == "vertical":
        said.append("Inputs count the vertical earth rate, which the table turns against where they are small.")
    return tuple(said)


def _to_watch(found: ThresholdFound, settings: FogSettings) -> list[str]:
    said = [f"{one.sentence}." for one in found.left_out]
    for one in found.axes:
        said += _to_watch_of(one, settings)
    return said


def _to_watch_of(one: AxisThreshold, settings: FogSettings) -> list[str]:
    said, ladder = [], one.ladder
    for sense in (1, -1):
        if sense not in ladder.says.senses:
            said.append(f"{one.axis}: there is no {_SENSES[sense]} input: the dead zone has one edge only.")
    if one.by_design:
        said.append(
            f"{one.axis}: the largest inputs give no scale factor near the one by design, "
            f"{settings.nominal_scale_factor:.6g} {COUNTS_PER_DPS}, which the outputs are compared with: is the "
            "coil in [gyro] that of this gyro, and is there an output at all?"
        )
    if abs(ladder.reference_dps) > settings.threshold.lowest_dps / 2:
        said.append(
            f"{one.axis}: at rest the input is {ladder.reference_dps:.4g} deg/s, the earth rate along the axis, "
            "and the gyro is taken to be linear there. Where the table turns against it, or lies to the east, "
            "nothing need be taken."
        )
    for name, edge in (("one half", ladder.says.threshold), ("a tenth", ladder.says.width)):
        if edge.undecided_dps:
            inputs = ", ".join(f"{rate:+.3g}" for rate in edge.undecided_dps)
            said.append(f"{one.axis}: the limit of {name} lies inside U95 of r at {inputs} deg/s.")
    return [*said, *one.remarks]
