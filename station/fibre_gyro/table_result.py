"""What a rate-table run says: scale factor, earth rate and bias of each axis, with their budget."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.arrays import NORMAL_95
from analysis.fibre_gyro import (
    LADDER_TERMS,
    AxisFit,
    InputAxisTilt,
    Linearity,
    OddEven,
    RateDifferences,
    TableRuns,
    ThreeAxes,
    WindowMean,
    bias_at_latitude,
    fit_axis,
    fit_three_axes,
    horizontal_earth_rate_dps,
    input_axis_tilt,
    missing_senses,
    noise_of_means,
    odd_even_parts,
    rate_differences,
    scale_linearity,
    table_runs,
    vertical_earth_rate_dph,
)
from station.errors import NoUsableSignal
from station.fibre_gyro.allan import NoiseModel, noise_of
from station.fibre_gyro.common import COUNTS_PER_DPS, PPM, angle_clock_u, far_from_design, reasons_of
from station.fibre_gyro.segments import (
    BY_ENCODER,
    Segment,
    begins_of,
    check_table_rate,
    remarks_on,
    segments_of,
    window_over_turns,
)
from station.fibre_gyro.settings import FogSettings
from station.results.quantity import Quantity, QuantityGroup, document, rows
from station.results.result import (
    Contribution,
    Excluded,
    Result,
    TextTable,
    budget_document,
    ppm,
    with_uncertainty,
)
from station.runs.store import SavedRun

Floats = NDArray[np.float64]

PURPOSE = "table"
_OUTPUTS = {"counts_x": "X", "counts_y": "Y", "counts_z": "Z"}  # columns with the output of each of several gyros


@dataclass(frozen=True)
class AxisResult:
    """What the table run says of one axis."""

    axis: str
    keys: tuple[str, ...]  # segments in the result, one for each element of ``runs``
    windows: tuple[WindowMean, ...]  # one for each key
    runs: TableRuns
    parts: OddEven  # of the runs with the upper end up (or, if there are none, the lower)
    differences: RateDifferences | None  # ``None`` with fewer than two rates
    fit: AxisFit
    # and its standard uncertainty: from the even part and the latitude, or from both ends up
    bias_dph: tuple[float, float]
    # of the input axis against the table's axis, by the horizontal earth rate; ``None`` if it cannot show
    tilt: InputAxisTilt | None
    linearity: Linearity | None  # scale-factor error over the rates; ``None`` where they are no ladder
    noise: NoiseModel | None  # the noise model that was counted
    # whether the noise within the runs is that of the model; else that of their words, which is larger
    noise_by_model: bool
    remarks: tuple[str, ...]  # what was missing or left out within the windows


@dataclass(frozen=True)
class TableEvaluation:
    """Results of all axes, and what was left out."""

    axes: tuple[AxisResult, ...]  # those that give a result
    left_out: tuple[Excluded, ...]
    # of all gyros, where the segments hold the output of more than the one along the table's axis
    matrix: ThreeAxes | None = None
    # of each log whose rate the table's encoder gave: what lay beside its whole turns
    beside_s: tuple[float, ...] = ()

    def of(self, axis: str) -> AxisResult | None:
        """Result of one axis, ``None`` if there is none."""
        return next((result for result in self.axes if result.axis == axis), None)


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> TableEvaluation:
    """Evaluate a rate-table run."""
    found = find_axes(run, settings, choices)
    if not found.axes:
        raise NoUsableSignal(f"no axis has runs in both senses{reasons_of(found.left_out)}")
    return found


def find_axes(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any] | None = None) -> TableEvaluation:
    """Evaluate the rate-table segments of a run, whatever else it holds; perhaps no axis gives a result."""
    segments = segments_of(run, PURPOSE)
    windows: dict[str, tuple[Segment, WindowMean]] = {}
    left_out: list[Excluded] = []
    for segment in segments:
        with Excluded.by_error(segment.key, left_out):
            windows[segment.key] = segment, _window(segment, settings)
    axes = dict.fromkeys(segment.conditions["axis"] for segment in segments)
    results = []
    for axis in axes:
        of_axis = {key: pair for key, pair in windows.items() if pair[0].conditions["axis"] == axis}
        _leave_out_single_senses(of_axis, left_out)
        noise = noise_of(run, choices or {}, axis)
        if (result := _axis_result(axis, of_axis, settings, noise)) is not None:
            results.append(result)
    used = {key: windows[key][0] for result in results for key in result.keys}
    models = {axis: noise_of(run, choices or {}, axis) for axis in _OUTPUTS.values()}
    matrix = _matrix(used, settings, models, left_out)
    beside = [one.conditions[BY_ENCODER] for one in segments if BY_ENCODER in one.conditions]
    return TableEvaluation(tuple(results), tuple(left_out), matrix, tuple(beside))


def _matrix(
    used: Mapping[str, Segment],
    settings: FogSettings,
    models: Mapping[str, NoiseModel | None],
    left_out: list[Excluded],
) -> ThreeAxes | None:
    """Fit the outputs of all gyros in the segments that are used, if they hold more than one."""
    columns = sorted({name for one in used.values() for name in one.recording.extra if name in _OUTPUTS})
    if len(columns) < 2:
        return None
    names = [_OUTPUTS[column] for column in columns]
    segments = list(used.values())
    conditions = [segment.conditions for segment in segments]
    begins = np.array(begins_of(segments))
    try:
        windows = [[_window(segment, settings, column) for segment in segments] for column in columns]
        means = [[one.mean for one in of_gyro] for of_gyro in windows]
        ends = begins + [one.duration_s for one in windows[0]]
        noise = [
            _noise(of_gyro, models[name], _sensitivity(means, segments, name), begins)
            for name, of_gyro in zip(names, windows, strict=True)
        ]
        return fit_three_axes(
            names,
            [str(one["axis"]).upper() for one in conditions],
            [one.get("table_rate_dps", one["rate_dps"]) for one in conditions],
            np.transpose(means),
            np.transpose([one.u for one in noise]),
            end_up=[one.get("end_up", 1) for one in conditions],
            at_s=(begins + ends) / 2 + _no_time(conditions),
            vertical_earth_rate_dps=vertical_earth_rate_dph(settings.site.latitude_deg) / 3600,
            irreproducibility_ppm=settings.table.irreproducibility_ppm,
            table_rate_u_ppm=settings.table.rate_u_ppm or 0.0,
            slow=[one.slow for one in noise],
        )
    except (ValueError, KeyError) as error:
        left_out.append(Excluded("matrix of the axes", str(error)))
        return None


def _sensitivity(means: Sequence[Sequence[float]], segments: Sequence[Segment], name: str) -> float:
    """Roughly the scale factor of one of several gyros, for its noise model: largest output over its rate."""
    largest = max(abs(mean) for of_gyro in means for mean in of_gyro)
    return largest / max(abs(float(one.conditions["rate_dps"])) for one in segments)


@dataclass(frozen=True)
class _AxisNoise:
    """Noise of the means of one gyro: within the runs, counts, and slow, counts^2."""

    u: Floats
    slow: Floats | None
    by_model: bool


def _noise(
    windows: Sequence[WindowMean], model: NoiseModel | None, scale_factor: float, begins: Floats
) -> _AxisNoise:
    """Noise by the model where there is one and the words do not scatter more than it says, else by the words."""
    if model is None:
        return _AxisNoise(noise_of_means(windows)[0], None, by_model=False)
    duration = np.array([one.duration_s for one in windows])
    u, by_model = noise_of_means(windows, scale_factor * np.sqrt(model.fast_variance(duration)))
    return _AxisNoise(u, scale_factor**2 * model.slow_covariance(begins, begins + duration), by_model)


def _window(segment: Segment, settings: FogSettings, column: str = "") -> WindowMean:
    table = settings.table
    check_table_rate(segment.conditions, table.rate_tolerance_ppm)
    resolution = settings.gyro.output_resolution
    return window_over_turns(
        segment, turns=table.turns, window_s=table.window_s, resolution=resolution, column=column
    )


def _runs_of(windows: Mapping[str, tuple[Segment, WindowMean]], noise: _AxisNoise, begins: Floats) -> TableRuns:
    conditions = [segment.conditions for segment, _ in windows.values()]
    means = [mean for _, mean in windows.values()]
    duration = np.array([mean.duration_s for mean in means])
    return table_runs(
        [c["rate_dps"] for c in conditions],
        [mean.mean for mean in means],
        noise.u,
        rate_dps=[c.get("table_rate_dps", c["rate_dps"]) for c in conditions],
        duration_s=duration,
        end_up=[c.get("end_up", 1) for c in conditions],
        at_s=begins + duration / 2 + _no_time(conditions),
        slow=noise.slow,
    )


def _no_time(conditions: Sequence[Mapping[str, Any]]) -> float:
    """nan for the simulated bench, whose segments follow no clock: there is no drift to be seen; else 0."""
    return math.nan if any("model" in one for one in conditions) else 0.0


def _leave_out_single_senses(windows: dict[str, tuple[Segment, WindowMean]], left_out: list[Excluded]) -> None:
    """Take out, by name, every rate whose opposite is missing or was left out."""
    for end_up in (1, -1):
        of_end = {key: pair for key, pair in windows.items() if pair[0].conditions.get("end_up", 1) == end_up}
        rates = [float(segment.conditions["rate_dps"]) for segment, _ in of_end.values()]
        alone = missing_senses(table_runs(rates, 0.0, 1.0)) if rates else []
        for key, rate in zip(of_end, rates, strict=True):
            if rate in alone:
                opposite = -rate
                left_out.append(
                    Excluded(key, f"the opposite sense ({opposite:+.10g} deg/s) is missing: take it too")
                )
                del windows[key]


def _axis_result(
    axis: str, windows: dict[str, tuple[Segment, WindowMean]], settings: FogSettings, model: NoiseModel | None
) -> AxisResult | None:
    if len(windows) < 2:
        return None
    means = tuple(mean for _, mean in windows.values())
    segments = [segment for segment, _ in windows.values()]
    begins = np.array(begins_of(segments))
    noise = _noise(means, model, _sensitivity([[one.mean for one in means]], segments, axis), begins)
    runs = _runs_of(windows, noise, begins)
    end_up = 1 if np.any(runs.end_up > 0) else -1
    parts = odd_even_parts(runs, end_up=end_up)
    irreproducibility = settings.table.irreproducibility_ppm
    differences = None
    if parts.rate_dps.size >= 2:
        differences = rate_differences(parts, irreproducibility_ppm=irreproducibility, runs=runs, end_up=end_up)
    fit = fit_axis(
        runs, irreproducibility_ppm=irreproducibility, table_rate_u_ppm=settings.table.rate_u_ppm or 0.0
    )
    if clock_u := angle_clock_u(segments):
        part = clock_u * abs(fit.scale_factor)
        fit = replace(
            fit,
            scale_factor_u=math.hypot(fit.scale_factor_u, part),
            contributions={**fit.contributions, "clock": part},
        )
        if differences is not None:
            common = np.hypot(differences.irreproducibility_u, clock_u * differences.number)
            differences = replace(differences, irreproducibility_u=common)
    return AxisResult(
        axis=axis,
        keys=tuple(windows),
        windows=means,
        runs=runs,
        parts=parts,
        differences=differences,
        fit=fit,
        bias_dph=bias_at_latitude(fit, settings.site.latitude_deg),
        tilt=_tilt(means, fit, settings),
        linearity=scale_linearity(runs, irreproducibility_ppm=irreproducibility),
        noise=model,
        noise_by_model=noise.by_model,
        remarks=tuple(said for segment, mean in windows.values() for said in remarks_on(segment, mean)),
    )


def _tilt(means: Sequence[WindowMean], fit: AxisFit, settings: FogSettings) -> InputAxisTilt | None:
    seen = abs(fit.scale_factor) * horizontal_earth_rate_dps(settings.site.latitude_deg)
    # the noise of all windows is known better than that of each
    density = np.mean([one.sine_u**2 * one.duration_s for one in means])
    spread = [float(np.sqrt(density / one.duration_s)) for one in means]
    freedom = sum(one.sine_freedom for one in means)
    try:
        return input_axis_tilt([one.sine for one in means], spread, seen, freedom=freedom)
    except ValueError:
        return None


# --------------------
# The rate-table run as numbers and sentences


_FIT_PPM = "scale_factor_u"
NUMBERS = (
    Quantity("scale_factor", "counts_per_dps", "fit.scale_factor", u=True, headline=True, trend=True),
    Quantity("even_part", "counts", "fit.even", u=True, doc="mean over both senses: earth rate and bias"),
    Quantity("chi_square", of="fit.chi_square"),
    Quantity("degrees_of_freedom", of="fit.degrees_of_freedom"),
    Quantity(
        "angle_random_walk",
        "deg_per_sqrt_h",
        "fit.angle_random_walk",
        doc="by the scatter of the words over the turns",
    ),
    Quantity("scale_factor_at_base_rate", "counts_per_dps", lambda one: one.parts.odd[0] / one.parts.rate_dps[0]),
    Quantity("even_part", "dph", lambda one: one.fit.even_dph[0], lambda one: one.fit.even_dph[1]),
    Quantity(
        "bias",
        "dph",
        lambda one: one.bias_dph[0],
        lambda one: one.bias_dph[1],
        trend=True,
        doc="less the earth rate",
    ),
    Quantity(
        "vertical_earth_rate", "dph", lambda one: one.fit.earth_rate_dph[0], lambda one: one.fit.earth_rate_dph[1]
    ),
    Quantity(
        "bias_drift", "dph_per_h", lambda one: one.fit.drift_dph_per_h[0], lambda one: one.fit.drift_dph_per_h[1]
    ),
    Quantity("input_axis_tilt", "mrad", "tilt.tilt_mrad", interval=("tilt.low_95_mrad", "tilt.high_95_mrad")),
)
NOMINAL_DIFFERENCE = Quantity(
    "nominal_difference", "ppm", limit=True, u_at=f"{_FIT_PPM}_ppm", doc="K over the one by design, less one"
)
SCALE_FACTOR_U = Quantity(
    _FIT_PPM, "ppm", lambda one: PPM * one.fit.scale_factor_u / abs(one.fit.scale_factor), limit=True
)
SCATTER = Quantity("scatter", "ppm", "fit.scatter_ppm", limit=True, doc="from run to run")
WINDOW = (
    Quantity("turns"),
    Quantity("window", "s", "duration_s"),
    Quantity("samples"),
    Quantity("sum", "counts", "total"),
    Quantity("mean", "counts", u=True),
    Quantity("missing"),
    Quantity("outliers"),
)
POINT = (Quantity("table_rate", "dps"), Quantity("residual", "ppm"))
LADDER = (
    Quantity(
        "nonlinearity_rms", "ppm", "rms_ppm", interval=("rms_low_95_ppm", "rms_high_95_ppm"), doc="freed of noise"
    ),
    Quantity("nonlinearity", "ppm", "largest_ppm", interval=("largest_low_95_ppm", "largest_high_95_ppm")),
)


def _term(name: str) -> Quantity:
    """One term of the scale-factor error, at the largest rate."""

    def interval(ladder: Linearity) -> tuple[float, float]:
        half = NORMAL_95 * ladder.value_u[name]
        return ladder.value[name] - half, ladder.value[name] + half

    return Quantity(name, "ppm", lambda ladder: ladder.value[name], lambda ladder: ladder.value_u[name], interval)


LADDER_POINTS = (Quantity("rate", "dps", "rate_dps"), Quantity("error", "ppm", "error_ppm", "error_u_ppm"))
DIFFERENCES = (
    Quantity("delta", "dps", lambda made: made.delta_dps.round(9)),
    Quantity("noise_u", "counts"),
    Quantity("irreproducibility_u", "counts"),
    Quantity("relative_u", "ppm", "relative_u_ppm"),
    Quantity(
        "number", "counts", u=True, doc="for the difference of two rates",
        interval=(lambda made: made.number - NORMAL_95 * made.number_u,
                  lambda made: made.number + NORMAL_95 * made.number_u),
    ),
)  # fmt: skip
FROM_FIT = Quantity("from_fit", "ppm", doc="number over K times the difference, less one")
MATRIX = (
    Quantity(
        "scale_factors", "counts_per_dps", "matrix", u=True, doc="of each gyro about each axis that was turned"
    ),
    Quantity("along_input_axis", "counts_per_dps", "scale_factor", u=True),
    Quantity("misalignment", "mrad", "misalignment_mrad", "misalignment_u_mrad"),
    Quantity("bias", "counts", u=True),
)
DESIGN = (Quantity("nominal_scale_factor", "counts_per_dps"), Quantity("irreproducibility", "ppm"))
QUANTITIES = (
    QuantityGroup((NOMINAL_DIFFERENCE, SCALE_FACTOR_U, SCATTER, *NUMBERS), "axes", "axis"),
    QuantityGroup((*WINDOW, *POINT), "axes.points", "name"),
    QuantityGroup((*LADDER, *map(_term, LADDER_TERMS)), "axes.linearity"),
    QuantityGroup(LADDER_POINTS, "axes.linearity.points"),
    QuantityGroup((*DIFFERENCES, FROM_FIT), "axes.differences"),
    QuantityGroup(DESIGN),
    QuantityGroup(MATRIX, "matrix"),
)


def result(found: TableEvaluation, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    axes = [_axis(one, settings) for one in found.axes]
    fits = [(one.axis, one.fit) for one in found.axes]
    lines = (
        f"{COUNTS_PER_DPS}; by design {settings.nominal_scale_factor:.6f}.",
        f"From {sum(len(one.keys) for one in found.axes)} runs over whole turns, by least squares.",
        *_of_rates(found, settings),
    )
    watched, matrix = tuple(to_watch(found, settings)), found.matrix
    turned = {} if matrix is None else {"gyros": matrix.gyros, "turned": matrix.turned, **document(matrix, MATRIX)}
    return Result(
        name="result",
        value="; ".join(f"K({axis}) = {with_uncertainty(f.scale_factor, f.scale_factor_u)}" for axis, f in fits),
        document={
            "axes": axes,
            DESIGN[0].key(): settings.nominal_scale_factor,
            DESIGN[1].key(): settings.table.irreproducibility_ppm,
            "matrix": turned or None,
            "left_out": found.left_out,
        },
        quantities=QUANTITIES,
        lines=lines,
        summary=[("", line) for line in lines],
        sentences=(
            _even_part_sentence(settings),
            *(said for one in found.axes if (said := noise_sentence(one))),
            *(said for one in found.axes if (said := _ladder_sentence(one))),
        ),
        to_watch=watched,
        flags=watched,
        left_out=found.left_out,
        tables=tuple(_tables(found)),
    )


def _tables(found: TableEvaluation) -> Iterator[TextTable]:
    lines = tuple(
        (
            one.axis,
            with_uncertainty(one.fit.scale_factor, one.fit.scale_factor_u),
            with_uncertainty(*one.fit.even_dph),
            with_uncertainty(*one.bias_dph),
            ppm(one.fit.scatter_ppm).lstrip("+"),
        )
        for one in found.axes
    )
    yield TextTable(("axis", f"K, {COUNTS_PER_DPS}", "even part, deg/h", "bias, deg/h", "scatter"), lines)
    if any(one.linearity is not None for one in found.axes):
        yield ladder_table(found.axes)
    if found.matrix is not None:
        yield matrix_table(found.matrix)


def matrix_table(matrix: ThreeAxes) -> TextTable:
    """Return scale factors and misalignments of all gyros."""
    lines = []
    for place, gyro in enumerate(matrix.gyros):
        cells = [gyro]
        for other, axis in enumerate(matrix.turned):
            angle, u = (
                float(matrix.misalignment_mrad[place, other]),
                float(matrix.misalignment_u_mrad[place, other]),
            )
            own = with_uncertainty(float(matrix.matrix[place, other]), float(matrix.matrix_u[place, other]))
            cells.append(own if axis == gyro or not math.isfinite(angle) else f"{with_uncertainty(angle, u)} mrad")
        lines.append((*cells, with_uncertainty(float(matrix.bias[place]), float(matrix.bias_u[place]))))
    header = ("gyro", *(f"about {axis}" for axis in matrix.turned), "bias, counts")
    return TextTable(header, tuple(lines))


def _axis(one: AxisResult, settings: FogSettings) -> dict[str, Any]:
    points = zip(one.runs.rate_dps, one.windows, one.fit.residual_ppm, one.keys, strict=True)
    differences, ladder = list[dict[str, Any]](), one.linearity
    if (made := one.differences) is not None:
        off = PPM * (made.number / (one.fit.scale_factor * made.delta_dps) - 1)
        differences = [{**row, FROM_FIT.key(): by} for row, by in zip(rows(made, DIFFERENCES), off, strict=True)]
    linearity = ladder and {
        "terms": ladder.chosen,
        **document(ladder, [*map(_term, ladder.value), *LADDER]),
        "points": rows(ladder, LADDER_POINTS),
    }
    return {
        "axis": one.axis,
        **document(one, NUMBERS),
        NOMINAL_DIFFERENCE.key(): PPM * (one.fit.scale_factor / settings.nominal_scale_factor - 1),
        **document(one, (SCALE_FACTOR_U, SCATTER)),
        "differences": differences,
        "linearity": linearity,
        "noise_model": None if one.noise is None else one.noise.source,
        "budget": axis_budget(one, settings),
        "points": [
            {"name": key, POINT[0].key(): rate, **document(window, WINDOW), POINT[1].key(): residual}
            for rate, window, residual, key in points
        ],
    }


def ladder_table(axes: Sequence[AxisResult]) -> TextTable:
    """Return the terms of the scale-factor error and the nonlinearity of every axis that was run over a ladder."""
    lines = []
    for one in axes:
        ladder = one.linearity
        if ladder is None:
            continue
        for name, value in ladder.value.items():
            u = ladder.value_u[name]
            low, high = value - NORMAL_95 * u, value + NORMAL_95 * u
            seen = "in the polynomial" if name in ladder.chosen else "not seen"
            lines.append((f"{one.axis}, {name}", with_uncertainty(value, u), f"{low:+.3g} to {high:+.3g}", seen))
        rms = f"{ladder.rms_low_95_ppm:.3g} to {ladder.rms_high_95_ppm:.3g}"
        largest = f"{ladder.largest_low_95_ppm:.3g} to {ladder.largest_high_95_ppm:.3g}"
        lines.append((f"{one.axis}, nonlinearity, rms", f"{ladder.rms_ppm:.3g}", rms, "freed of noise"))
        lines.append(
            (f"{one.axis}, nonlinearity, largest", f"{ladder.largest_ppm:.3g}", largest, "freed of noise")
        )
    return TextTable(("scale-factor error at the largest rate", "ppm", "95 %", ""), tuple(lines))


def _ladder_sentence(one: AxisResult) -> str:
    ladder = one.linearity
    if ladder is None:
        return ""
    interval = f"{ladder.rms_low_95_ppm:.2g} to {ladder.rms_high_95_ppm:.2g} ppm of full scale"
    if not ladder.chosen:
        return (
            f"{one.axis}: over the rates the output is a straight line within its noise; freed of it the "
            f"nonlinearity is {interval} (rms, 95 %)."
        )
    terms = ", ".join(f"{name} {ppm(ladder.value[name], ladder.value_u[name])}" for name in ladder.chosen)
    return (
        f"{one.axis}: over the rates the scale factor changes; in the polynomial: {terms}. Freed of noise the "
        f"nonlinearity is {ladder.rms_ppm:.2g} ppm of full scale, {interval} (rms, 95 %). K is that of the "
        "straight line, and what the output lies off it counts in its uncertainty."
    )


def _even_part_sentence(settings: FogSettings) -> str:
    """Say what the even part is made of."""
    vertical = vertical_earth_rate_dph(settings.site.latitude_deg)
    if settings.table.both_ends_up:
        return (
            "Each axis was turned with both ends up, so the vertical earth rate and the bias are told apart by "
            f"the data; at latitude {settings.site.latitude_deg:g}° the earth rate is {vertical:.3f} deg/h."
        )
    return (
        "The even part holds the vertical earth rate and the bias together; the bias given here rests on the "
        f"earth rate of {vertical:.3f} deg/h at latitude {settings.site.latitude_deg:g}°. Runs with both ends of "
        "the axis up (table.both_ends_up) tell them apart."
    )


def to_watch(found: TableEvaluation, settings: FogSettings) -> list[str]:
    """Say what spoils a rate-table run or may spoil it, also one within a self-calibration."""
    said = [f"{one.sentence}." for one in found.left_out]
    for one in found.axes:
        said += _to_watch_of(one, settings)
    return said


def _of_rates(found: TableEvaluation, settings: FogSettings) -> Iterator[str]:
    """Say where the rates of the table are from, and what K then holds that u does not; sentences."""
    if found.beside_s:
        longest = max(found.beside_s)
        yield (
            f"Rates of {len(found.beside_s)} logs by the table's encoder, over whole turns at a steady rate; "
            f"up to {longest:.4g} s beside them are left out."
        )
    if settings.table.rate_u_ppm is not None:
        return
    frame = "" if found.beside_s else "In the table's own deg/s: "
    cause = "what the clock of the logs" if found.beside_s else "what its rate"
    said = f"{frame}{cause} is off by is in K and not in u (table.rate_u_ppm, not stated)."
    yield said[0].upper() + said[1:]


NO_LINE_PPM = 5e3  # scatter of the runs that no gyro has
OFF_THE_LINE = 5.0  # times by which a run must lie further off the line than others do to be named


def _to_watch_of(one: AxisResult, settings: FogSettings) -> list[str]:
    said, fit, made = [], one.fit, one.differences
    if implausible := far_from_design(fit.scale_factor, settings):
        said.append(f"{one.axis}: {implausible}")
    if fit.scatter_ppm > NO_LINE_PPM:
        said.append(
            f"{one.axis}: the runs scatter by {fit.scatter_ppm / 1e4:.2g} % about the line: rates exchanged, of "
            "another sense, or an output that wraps or saturates. K means nothing."
        )
    outputs = np.array([window.mean for window in one.windows])
    own = PPM * np.array([window.mean_u for window in one.windows]) / np.maximum(np.abs(outputs), 1e-300)
    usual = np.hypot(own, 1.48 * np.median(np.abs(fit.residual_ppm)))
    for place in np.flatnonzero(np.abs(fit.residual_ppm) > OFF_THE_LINE * usual):
        said.append(
            f"{one.axis}: {one.keys[place]} is {fit.residual_ppm[place]:+.3g} ppm off the line through all runs, "
            f"others {np.median(np.abs(fit.residual_ppm)):.2g} ppm: look at it, or take it again."
        )
    if made is not None:
        smallest = int(abs(made.delta_dps).argmin())
        delta, relative = float(made.delta_dps[smallest]), float(made.relative_u_ppm[smallest])
        if relative > 1e4:
            said.append(
                f"{one.axis}: the number for {delta:.4g} deg/s is good to {relative / 1e4:.2g} % only; it is the "
                f"difference of two numbers that are {made.base_dps / abs(delta):.0f} times larger. Use K by "
                "least squares."
            )
    stated = settings.table.irreproducibility_ppm
    if fit.scatter_assumed:
        said.append(
            f"{one.axis}: no run repeats another, so their scatter does not show; 10 ppm of table rate and scale "
            "factor from run to run are counted. Repeated runs or table.irreproducibility_ppm say it."
        )
    elif stated is not None and fit.chi_square > 3 * fit.degrees_of_freedom:
        said.append(
            f"{one.axis}: the runs scatter by {fit.scatter_ppm:.2g} ppm, more than their noise and the "
            f"{stated:g} ppm of table.irreproducibility_ppm; the uncertainties were widened to match."
        )
    drift, drift_u = fit.drift_dph_per_h
    if abs(drift) > 3 * drift_u:
        said.append(
            f"{one.axis}: the bias drifted by {with_uncertainty(drift, drift_u)} deg/h per h; it is taken out."
        )
    said += one.remarks
    return said


# --------------------
# What each input contributes to the uncertainty of the scale factor of one axis


_NO_DRIFT = "too few runs, or no clock that tells when they were taken: counted as scatter"


def axis_budget(one: AxisResult, settings: FogSettings) -> dict[str, Any]:
    """Return the budget of the scale factor of one axis, as JSON."""
    fit = one.fit
    parts = {name: PPM * value / abs(fit.scale_factor) for name, value in fit.contributions.items()}
    by_model = one.noise is not None and one.noise_by_model
    source = "noise model" if by_model else "scatter of the words over the turns"
    walk = f"{fit.angle_random_walk:.2g} deg/√h, by the {source}"
    missing, far = (sum(getattr(window, name) for window in one.windows) for name in ("missing", "outliers"))
    words = sum(window.samples for window in one.windows)
    left_out = f"{missing} missing, {far} outliers, of {words}: left out"
    stated = settings.table.rate_u_ppm is not None
    of_table = f"table.rate_u_ppm{'' if stated else ': what the rate is off by is in K'}"
    lines = [
        Contribution("noise", "noise within the runs", parts["noise"], True, walk),
        _slow_noise(one, parts["slow noise"]),
        _stated(settings, parts["stated"]),
        Contribution(
            "scatter",
            "scatter from run to run beyond these",
            parts["scatter"],
            not fit.scatter_assumed,
            "10 ppm: no run repeats another"
            if fit.scatter_assumed
            else f"the residuals of {len(one.keys)} runs, {fit.degrees_of_freedom} degrees of freedom",
        ),
        Contribution("table rate", "rate of the table, common to all runs", parts["table rate"], stated, of_table),
        _drift(one),
        Contribution("words", "missing and outlying words", 0.0, True, left_out),
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


def _drift(one: AxisResult) -> Contribution:
    drift, u = one.fit.drift_dph_per_h
    quantity = "drift of the bias"
    if not math.isfinite(drift):
        return Contribution("drift", quantity, 0.0, False, _NO_DRIFT)
    change = ppm(PPM * one.fit.drift_in_scale_factor / one.fit.scale_factor)
    note = f"{with_uncertainty(drift, u)} deg/h per h taken out, which changed K by {change}; the rest is in noise"
    return Contribution("drift", quantity, 0.0, True, note)
