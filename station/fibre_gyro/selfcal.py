"""The self-calibration by injected staircase: its numbers, plan, evaluation, result and report."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import (
    InjectionPlan,
    NetOutputs,
    RateDifferences,
    RunScatter,
    ScaleComparison,
    SlopeFit,
    StaticLevel,
    WindowMean,
    compare_scale,
    correlation_with_numbers,
    drift_in_slope,
    find_run_scatter,
    fit_slope,
    noise_of_means,
    predicted_difference_ppm,
    predicted_self_scale,
    predicted_table_scale,
    scaled_numbers,
    static_level,
    steps_beyond_dac,
    superposed_numbers,
)
from station.errors import NoUsableSignal, UsageError
from station.fibre_gyro.allan import NOISE, NoiseModel, noise_of
from station.fibre_gyro.bench import open_fog_bench
from station.fibre_gyro.common import (
    COUNTS_PER_DPS,
    PPM,
    beyond_converter,
    far_from_design,
    not_taken,
    reasons_of,
    small_ppm,
    staircase_section,
    truth_of,
)
from station.fibre_gyro.logs import LogRow, NamedSegment, gyro_measurement, listed_logs
from station.fibre_gyro.segments import (
    PlannedSegment,
    begins_of,
    remarks_on,
    segments_of,
    take_segments,
    window_at_rest,
)
from station.fibre_gyro.settings import FIBRE_GYRO, FogSettings
from station.fibre_gyro.table import axis_table, plan as plan_table
from station.fibre_gyro.table_result import (
    PURPOSE as TABLE,
    AxisResult,
    TableEvaluation,
    find_axes,
    to_watch as to_watch_of_table,
)
from station.report.figure import ACCENT, HALF, SECOND, SOFT, legend_above, svg_element
from station.results.quantity import Quantity, QuantityGroup, document, rows
from station.results.result import (
    Contribution,
    Excluded,
    PlacedFigure,
    Result,
    Section,
    TextTable,
    budget_document,
    budget_table,
    ppm,
    with_uncertainty,
)
from station.runs.acquisition import Acquisition
from station.runs.store import SavedRun, open_run
from station.settings import saved_settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# --------------------
# The numbers that a self-calibration injects, and the rate-table result that they and the comparison rest on


Floats = NDArray[np.float64]

# facts of a run whose numbers come from another
REFERENCE, NUMBERS, DIFFERENCES = "table_reference", "numbers", "table_differences"
CORRELATION = "table_correlation"

_ARRAYS = ("delta_dps", "number", "noise_u", "irreproducibility_u")
_BASE = ("base_dps", "base_u")


@dataclass(frozen=True)
class TableReference:
    """The rate-table result that a self-calibration is compared with."""

    scale_factor: float  # counts per deg/s
    scale_factor_u: float
    source: str  # where it comes from, in words


def numbers_for(settings: FogSettings, table: AxisResult | None) -> InjectionPlan:
    """Numbers to inject, in counts, for every rate of the settings in both senses."""
    chosen = settings.selfcal
    rates = [sense * rate for rate in chosen.rates_dps for sense in (1.0, -1.0)]
    if chosen.numbers == "nominal":
        return scaled_numbers(rates, settings.nominal_scale_factor)
    if table is not None and chosen.numbers == "fit":
        return scaled_numbers(rates, table.fit.scale_factor, table.fit.scale_factor_u)
    if table is None or table.differences is None:
        raise UsageError(
            f'selfcal.numbers = "{chosen.numbers}" takes the numbers from a rate-table run of axis {chosen.axis}: '
            'name one with --table RUN, or set selfcal.numbers = "nominal"'
        )
    return superposed_numbers(rates, table.differences)


def facts_of_table(settings: FogSettings, table_run: Path) -> dict[str, Any]:
    """Return numbers and reference of another run, as facts of the one that uses them."""
    run = open_run(table_run)
    saved = saved_settings(FIBRE_GYRO, run.facts.settings, str(run.path))
    found = find_axes(run, saved).of(settings.selfcal.axis)
    if found is None:
        raise UsageError(f"{table_run}: gives no scale factor of axis {settings.selfcal.axis} (selfcal.axis)")
    source = f"rate-table run {run.path.parent.name}, axis {found.axis}"
    reference = TableReference(found.fit.scale_factor, found.fit.scale_factor_u, source)
    numbers = {name: values.tolist() for name, values in asdict(numbers_for(settings, found)).items()}
    known = {REFERENCE: asdict(reference), NUMBERS: numbers}
    if found.differences is None:
        return known
    plain = {name: np.asarray(getattr(found.differences, name)).tolist() for name in (*_ARRAYS, *_BASE)}
    together = _together(found)
    return {**known, DIFFERENCES: plain, **({CORRELATION: asdict(together)} if together else {})}


@dataclass(frozen=True)
class TableTogether:
    """How scale factor and numbers of one table run hang together."""

    # standard uncertainty of the scale factor, without the table's common error, and of each number; counts
    u: list[float]
    correlation: list[list[float]]


def _together(table: AxisResult) -> TableTogether | None:
    made, fit = table.differences, table.fit
    if made is None or made.factors is None:
        return None
    common = sum(fit.contributions.get(name, 0.0) ** 2 for name in ("table rate", "clock"))
    own = math.sqrt(max(fit.scale_factor_u**2 - common, 0.0))
    return TableTogether([own, *made.number_u.tolist()], correlation_with_numbers(fit, made.factors).tolist())


def numbers_against_table_u(
    run: SavedRun, table: TableEvaluation | None, settings: FogSettings, rates_dps: Floats, weights: Floats
) -> float | None:
    """Relative standard uncertainty of the slope of the numbers over the K of the run that both come from."""
    # Their errors have one source and cancel in part; ``None`` where nobody knows how.
    reference = reference_of(run, settings, table)
    own = table.of(settings.selfcal.axis) if table is not None else None
    if reference is None or settings.selfcal.numbers != "differences":
        return None
    together: TableTogether | None
    if CORRELATION in run.facts:
        together, made = TableTogether(**run.facts[CORRELATION]), _saved_differences(run.facts)
    elif own is not None and own.differences is not None and REFERENCE not in run.facts:
        together, made = _together(own), own.differences
    else:
        return None
    if together is None or made is None:
        return None
    plan = superposed_numbers(rates_dps, made)
    centred = weights * (rates_dps - float(weights @ rates_dps) / float(weights.sum()))
    of_numbers = centred @ plan.multiples / float(centred @ rates_dps)
    slope = float(of_numbers @ made.number)
    factors = np.concatenate([[-1 / reference.scale_factor], of_numbers / slope]) * np.array(together.u)
    return float(np.sqrt(factors @ np.array(together.correlation) @ factors))


def _saved_differences(facts: Mapping[str, Any]) -> RateDifferences | None:
    made = facts.get(DIFFERENCES)
    if made is None:
        return None
    delta, number, noise, spread = (np.array(made[name], dtype=np.float64) for name in _ARRAYS)
    base, base_u = (float(made[name]) for name in _BASE)
    return RateDifferences(delta, number, noise, spread, base, base_u)


def numbers_u_of(facts: Mapping[str, Any], settings: FogSettings) -> Callable[[float], float]:
    """Return how well a number stands for a rate, counts, by the table run that the numbers of logs come from."""
    # By the scale factor of the table where the numbers are made of it, else by its differences; without a table
    # run, and for numbers by design, nothing is known that would be uncertain.
    reference, made = facts.get(REFERENCE), _saved_differences(facts)
    if reference is None or settings.selfcal.numbers == "nominal":
        return lambda rate: 0.0
    if settings.selfcal.numbers == "fit" or made is None:
        return lambda rate: abs(rate) * float(reference["scale_factor_u"])
    return lambda rate: float(superposed_numbers([rate], made).number_u[0])


def numbers_of(run: SavedRun, settings: FogSettings) -> InjectionPlan:
    """Return the numbers of a run: those that were saved with it, or those that its own table run gives."""
    if (saved := run.facts.get(NUMBERS)) is not None:
        return InjectionPlan(**{name: np.array(values, dtype=np.float64) for name, values in saved.items()})
    return numbers_for(settings, find_axes(run, settings).of(settings.selfcal.axis))


def reference_of(run: SavedRun, settings: FogSettings, table: TableEvaluation | None) -> TableReference | None:
    """Return the scale factor of the rate table that belongs to a run: saved with it, or of its own table run."""
    if (saved := run.facts.get(REFERENCE)) is not None:
        return TableReference(**saved)
    result = table.of(settings.selfcal.axis) if table is not None else None
    if result is None or not math.isfinite(result.fit.scale_factor):
        return None
    source = f"rate-table run of axis {result.axis} in the same run"
    return TableReference(result.fit.scale_factor, result.fit.scale_factor_u, source)


# --------------------
# What the segments of a self-calibration say: slope, intercept and static output of the injected steps


PURPOSE = "selfcal"
_STATIC = ("before", "after")


@dataclass(frozen=True)
class _Row:
    """Mean of one segment, and when it began."""

    key: str
    conditions: dict[str, Any]
    mean: WindowMean
    begin_s: float
    remarks: tuple[str, ...]

    @property
    def at_s(self) -> float:
        """Middle of it."""
        return self.begin_s + self.mean.duration_s / 2


@dataclass(frozen=True)
class SelfcalEvaluation:
    """Result of a self-calibration."""

    keys: tuple[str, ...]  # segments in the fit, one for each element of the arrays
    rate_dps: NDArray[np.float64]  # (n,): What the steps stand for, and the steps in counts
    number: NDArray[np.float64]
    net: NetOutputs
    fit: SlopeFit  # net output against rate: K_self
    numbers: SlopeFit  # injected numbers against rate, with the same weights: the mapping that was given
    reference: TableReference | None
    comparison: ScaleComparison  # against the table, or where there is none against the design
    static_missing: str  # {"", "before", "after"}: Which static output is missing, if one is
    drift_removed: bool  # whether the static output was interpolated in time
    # what each cause contributes to the uncertainty of K_self/K_table - 1 (or against the design), ppm
    contributions: Mapping[str, float]
    noise: NoiseModel | None  # the noise model that was counted
    # whether the noise within the segments is that of the model; else that of their words, which is larger
    noise_by_model: bool
    remarks: tuple[str, ...]  # what was missing or left out within the windows
    left_out: tuple[Excluded, ...]
    table: TableEvaluation | None  # of the rate-table segments in the same run


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> SelfcalEvaluation:
    """Evaluate a self-calibration, and the rate-table segments of the same run."""
    means, left_out = _usable(run, settings)
    left_out += not_taken(run)
    static = [row for row in means if row.conditions["static"]]
    steps = [row for row in means if not row.conditions["static"]]
    names = {row.conditions["static"] for row in static}
    missing = [name for name in _STATIC if name not in names]
    if not static or len(steps) < 3:
        raise NoUsableSignal(
            f"a self-calibration needs a static output and at least three steps, there are {len(static)} and "
            f"{len(steps)}{reasons_of(left_out)}"
        )
    rates = np.array([row.conditions["stands_for_dps"] for row in steps], dtype=np.float64)
    given = np.array([row.conditions["number"] for row in steps], dtype=np.float64)
    model = noise_of(run, choices, settings.selfcal.axis)
    both = [*steps, *static]
    expected = None
    if model is not None:
        lengths = np.array([row.mean.duration_s for row in both])
        expected = settings.nominal_scale_factor * np.sqrt(model.fast_variance(lengths))
    noise_u, by_model = noise_of_means([row.mean for row in both], expected)
    u = np.maximum(noise_u[: len(steps)], 1e-12 * np.abs(given).max())
    level = static_level(
        [row.at_s for row in steps],
        [row.at_s for row in static],
        [row.mean.mean for row in static],
        noise_u[len(steps) :],
    )
    output = np.array([row.mean.mean for row in steps]) - level.level
    net = NetOutputs(output, u, level.mean, level.mean_u, level.drift, level.drift_u)
    drift_u = level.unseen_slope_u * abs(drift_in_slope(rates, u**-2.0, [row.at_s for row in steps]))
    common = _common_covariance(steps, static, level, noise_u[len(steps) :], model, settings.nominal_scale_factor)
    fit, scatter = _fit(rates, output, u, drift_u, common)
    excess, _ = _fit(rates, output - given, u, drift_u, common)
    table = find_axes(run, settings, choices) if run.taken_for(TABLE) else None
    reference = reference_of(run, settings, table)
    against = (
        (reference.scale_factor, reference.scale_factor_u) if reference else (settings.nominal_scale_factor, 0.0)
    )
    number_u = np.array([row.conditions.get("number_u", 0.0) for row in steps], dtype=np.float64)
    weight = u**-2.0
    numbers_u = float(np.sum(weight * np.abs(rates) * number_u) / np.sum(weight * rates**2))
    if reference is not None and settings.selfcal.numbers == "fit":
        # the numbers were made of the scale factor that they are compared with: its error is in both
        against, numbers_u = (reference.scale_factor, abs(numbers_u - reference.scale_factor_u)), 0.0
    together_u = numbers_against_table_u(run, table, settings, rates, u**-2.0)
    if together_u is not None:
        against, numbers_u = (against[0], 0.0), together_u * abs(fit_slope(rates, given, u).slope)
    return SelfcalEvaluation(
        keys=tuple(row.key for row in steps),
        rate_dps=rates,
        number=given,
        net=net,
        fit=fit,
        numbers=fit_slope(rates, given, u),
        reference=reference,
        comparison=compare_scale(fit, excess, against, numbers_u=numbers_u),
        static_missing=missing[0] if missing else "",
        drift_removed=level.modelled,
        contributions=_contributions(scatter, fit, rates, u, drift_u, against, numbers_u),
        noise=model,
        noise_by_model=by_model,
        remarks=tuple(said for row in means for said in row.remarks),
        left_out=tuple(left_out),
        table=table,
    )


def _common_covariance(
    steps: Sequence[_Row],
    static: Sequence[_Row],
    level: StaticLevel,
    static_u: Floats,
    model: NoiseModel | None,
    scale_factor: float,
) -> Floats:
    """Covariance of the net outputs beyond the noise of each step: static output, and slow noise by the model."""
    common = (level.weights * static_u**2) @ level.weights.T
    if model is not None:
        both = [*steps, *static]
        begins = np.array([row.begin_s for row in both])
        slow = model.slow_covariance(begins, begins + [row.mean.duration_s for row in both])
        net = np.hstack([np.eye(len(steps)), -level.weights])
        common = common + scale_factor**2 * net @ slow @ net.T
    return np.asarray(common, dtype=np.float64)


def _fit(rates: Floats, values: Floats, u: Floats, drift_u: float, common: Floats) -> tuple[SlopeFit, RunScatter]:
    """Fit a line; its uncertainties count the scatter of the points and the drift that may be left."""
    fit = fit_slope(rates, values, u)
    design = np.column_stack([rates, np.ones_like(rates)])
    scatter = find_run_scatter(design, values, u, 0.0, slow=common)
    slope, intercept = np.linalg.pinv(design / u[:, np.newaxis]) / u
    slope_u = math.hypot(scatter.standard_u(slope), drift_u)
    return replace(fit, slope_u=slope_u, intercept_u=scatter.standard_u(intercept)), scatter


def _contributions(
    scatter: RunScatter,
    fit: SlopeFit,
    rates: Floats,
    u: Floats,
    drift_u: float,
    against: tuple[float, float],
    numbers_u: float,
) -> dict[str, float]:
    """What each cause contributes to the uncertainty of the comparison, ppm."""
    slope = (np.linalg.pinv(np.column_stack([rates, np.ones_like(rates)]) / u[:, np.newaxis]) / u)[0]
    parts = scatter.parts(slope)
    causes = {
        "noise": parts["noise"],
        "slow noise": parts["slow noise"],
        "scatter": parts["scatter"],
        "drift": drift_u,
        "numbers": numbers_u,
    }
    relative = {name: PPM * value / abs(fit.slope) for name, value in causes.items()}
    return {**relative, "table": PPM * against[1] / abs(against[0])}


def _usable(run: SavedRun, settings: FogSettings) -> tuple[list[_Row], list[Excluded]]:
    """Mean of every segment that can be used."""
    rows: list[_Row] = []
    left_out, segments = [], segments_of(run, PURPOSE)
    for segment, begin_s in zip(segments, begins_of(segments), strict=True):
        step = segment.conditions["number"] / settings.gyro.counts_per_code
        if steps_beyond_dac(step, settings.gyro.dac_bits):
            left_out.append(Excluded(segment.key, beyond_converter(step, settings.gyro.dac_bits)))
            continue
        with Excluded.by_error(segment.key, left_out):
            mean = window_at_rest(segment, resolution=settings.gyro.output_resolution)
            rows.append(_Row(segment.key, segment.conditions, mean, begin_s, tuple(remarks_on(segment, mean))))
    return rows, left_out


# --------------------
# The self-calibration as numbers and sentences: what it shows, and what it cannot


_EXAMPLE_CHANGE = 100e-6
_EXAMPLE_EPS = 1e-3
RESULT = (
    Quantity("scale_factor_self", "counts_per_dps", "fit.slope", u=True, headline=True, trend=True),
    Quantity("intercept", "counts", "fit.intercept", u=True),
    Quantity("static", "counts", "net.static", u=True, doc="output at rest"),
    Quantity("static_drift", "counts", "net.drift", u=True, doc="after less before the steps"),
    Quantity("numbers_slope", "counts_per_dps", "numbers.slope", doc="of the injected numbers over the rates"),
    Quantity(
        "self_minus_numbers", "ppm", "comparison.against_numbers_ppm", "comparison.against_numbers_u_ppm",
        limit=True, doc="K_self over the slope of the injected numbers, less one",
    ),
    Quantity("table_scale_factor", "counts_per_dps", "reference.scale_factor", u=True),
    Quantity(
        "self_minus_table", "ppm", lambda found: found.comparison.difference_ppm if found.reference else None,
        lambda found: found.comparison.difference_u_ppm if found.reference else None, limit=True, optional=True,
    ),
)  # fmt: skip
DESIGN = Quantity("self_minus_design", "ppm")
POINTS = (
    Quantity("name", of="keys"),
    Quantity("rate", "dps", "rate_dps", doc="that the step stands for"),
    Quantity("number", "counts", doc="that was injected"),
    Quantity("net", "counts", "net.output", u=True, doc="output less the static output"),
    Quantity("residual", "counts", "fit.residual"),
)
QUANTITIES = (QuantityGroup((*RESULT, DESIGN)), QuantityGroup(POINTS, "points", "name"))


def result(found: SelfcalEvaluation, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    fit, net, compared = found.fit, found.net, found.comparison
    against = "K of the table" if found.reference else "K by design"
    numbers = ppm(compared.against_numbers_ppm, compared.against_numbers_u_ppm)
    lines = (
        f"Against {against}: {ppm(compared.difference_ppm, compared.difference_u_ppm)}.",
        f"Against the slope of the injected numbers: {numbers}.",
    )
    watched = tuple(_to_watch(found, settings))
    sentences = _shared_path_sentences if settings.selfcal.path == "shared" else _second_path_sentences
    return Result(
        name="result",
        value=f"K_self = {with_uncertainty(fit.slope, fit.slope_u)} {COUNTS_PER_DPS}",
        document=_document(found, settings),
        quantities=QUANTITIES,
        lines=lines,
        summary=[
            *(("", line) for line in lines),
            ("intercept F_0", f"{with_uncertainty(fit.intercept, _intercept_u(found))} counts"),
            ("static output N_0", f"{with_uncertainty(net.static, net.static_u)} counts"),
        ],
        sentences=tuple(sentences(found, gated=settings.gyro.gated_resets)),
        to_watch=watched,
        flags=watched,
        left_out=found.left_out,
    )


def _intercept_u(found: SelfcalEvaluation) -> float:
    """Standard uncertainty of the intercept, counts, with that of the static output which was taken off."""
    return math.hypot(found.fit.intercept_u, found.net.static_u)


def _document(found: SelfcalEvaluation, settings: FogSettings) -> dict[str, Any]:
    reference = found.reference
    against = f"K_self against K {'of the table' if reference else 'by design'}"
    return {
        "path": settings.selfcal.path,
        "numbers": settings.selfcal.numbers,
        **document(found, RESULT),
        DESIGN.key(): PPM * (found.fit.slope / settings.nominal_scale_factor - 1),
        "static_missing": found.static_missing or None,
        "compared_with": "table" if reference else "design",
        "table_source": reference.source if reference else None,
        "noise_model": None if found.noise is None else found.noise.source,
        "budget": budget_document(against, _budget(found), found.comparison.difference_u_ppm),
        "points": rows(found, POINTS),
        "left_out": found.left_out,
    }


def _budget(found: SelfcalEvaluation) -> list[Contribution]:
    """Say what each input contributes to the uncertainty of K_self against the scale factor of the table."""
    parts, model = found.contributions, found.noise
    by_words = "by the scatter of the words"
    at_rest = "static output, and slow noise between it and the steps"
    if model is None:
        note = "static output; no noise model (--noise): slow noise counts as far as the steps scatter by it"
    else:
        note = f"noise model of {model.source}"
    drift = "interpolated in time" if found.drift_removed else "as large as the static outputs allow"
    cancels = parts["numbers"] and not parts["table"]
    numbers = f"of the table run{', with its scale factor: their errors cancel in part' if cancels else ''}"
    table = found.reference.source if found.reference else "compared with K by design, exact by definition"
    return [
        Contribution(
            "noise", "noise within the steps", parts["noise"], True,
            "by the noise model" if found.noise_by_model else by_words,
        ),
        Contribution("slow noise", at_rest, parts["slow noise"], model is not None, note),
        Contribution("scatter", "scatter of the steps beyond these", parts["scatter"], True, "residuals"),
        Contribution("drift", "drift of the bias", parts["drift"], True, drift),
        Contribution("numbers", "numbers for the rates", parts["numbers"], True, numbers),
        Contribution("table", "scale factor compared with", parts["table"], True, table),
    ]  # fmt: skip


def _shared_path_sentences(found: SelfcalEvaluation, *, gated: bool) -> list[str]:
    compared = found.comparison
    numbers = ppm(compared.against_numbers_ppm, compared.against_numbers_u_ppm)
    scale = predicted_table_scale(_EXAMPLE_CHANGE, gated=gated)
    return [
        "The injection goes through the feedback's own adder, converter and electrode. The loop makes the sum of "
        "both staircases zero, so the output is the injected number itself: K_self returns the mapping of numbers "
        "to rates that it was given. It is no measurement of the gyro's scale factor.",
        f"K_self differs from the slope of the injected numbers by {numbers}. This is what was tested: the "
        "digital arithmetic, the lock of the loop, its dead zone and the decimation of the output.",
        "It is blind to L·D/λ, that is to the fibre, the coil's temperature and the wavelength: a change of "
        f"{PPM * _EXAMPLE_CHANGE:+.0f} ppm after the numbers were made changes K of the table by "
        f"{PPM * (scale - 1):+.4g} ppm and K_self by nothing, K_self/K_table - 1 = "
        f"{predicted_difference_ppm(1.0, 1.0, scale):+.4g} ppm.",
        _two_pi_sentence(gated=gated),
        "It is blind to the converter's nonlinearity: at rest the sum of both staircases stands still and the "
        "converter does not even move. A cubic error of 0.4 % of full scale shifts K of the table by some +250 "
        "ppm at a Sagnac phase of 0.47 rad (20 deg/s on a coil of 1000 m by 0.1 m), and by more at higher rates, "
        "where reset samples are left out; by less than 1 ppm where all are used; and K_self by nothing.",
    ]


def _two_pi_sentence(*, gated: bool) -> str:
    scale = predicted_table_scale(0.0, _EXAMPLE_EPS, gated=gated)
    begin = (
        f"It is blind to V_2π: a 2π error of {PPM * _EXAMPLE_EPS:+.0f} ppm that comes up after the numbers were "
        "made changes K of the table by"
    )
    if gated:
        return (
            f"{begin} {PPM * (scale - 1):+.5g} ppm, since this gyro leaves reset samples out, and K_self by "
            f"nothing, K_self/K_table - 1 = {predicted_difference_ppm(1.0, 1.0, scale):+.5g} ppm."
        )
    return (
        f"{begin} {small_ppm(PPM * (scale - 1))} only, since this gyro uses the reset samples too, and K_self by "
        "nothing; it shows as a ripple at the reset frequency."
    )


def _second_path_sentences(found: SelfcalEvaluation, *, gated: bool) -> list[str]:
    difference, u = found.comparison.against_numbers_ppm, found.comparison.against_numbers_u_ppm
    own = PPM * (predicted_self_scale("separate", 0.0, _EXAMPLE_EPS, gated=gated) - 1)
    feedback = PPM * (predicted_self_scale("separate", _EXAMPLE_EPS, gated=gated) - 1)
    differs = f"K_self differs from the slope of the injected numbers by {ppm(difference, u)}."
    if gated:
        implied = ppm(-difference / (1 + difference / PPM), u)
        differs += f" With an exact injection path that is a 2π error of the feedback of {implied}."
        sees = (
            f"It does see V_2π of the feedback path: +{PPM * _EXAMPLE_EPS:.0f} ppm there changes K_self by "
            f"{feedback:+.5g} ppm, as K of the table, so with a stable injection path K_self follows the table."
        )
    else:
        sees = (
            "V_2π of the feedback path changes neither K of the table nor K_self by more than "
            f"{abs(feedback):.1g} ppm for 1000 ppm, since this gyro uses the reset samples too."
        )
    return [
        "The injection goes through a second electrode with a converter of its own; the feedback answers with its "
        "own converter. K_self is the mapping of numbers to rates times the ratio of both paths' gains.",
        differs,
        sees,
        f"It sees the gain of its own injection path as an error: +{PPM * _EXAMPLE_EPS:.0f} ppm there changes "
        f"K_self by {own:+.5g} ppm and K of the table by nothing.",
        "It is blind to L·D/λ, that is to the fibre, the coil's temperature and the wavelength: both staircases "
        "are phases of the modulator, no rotation is compared with them. For that it takes the table.",
    ]


_FINDING = 4.0
"""Standard uncertainties that K_self of the shared path may differ from the numbers before the test has failed."""

_OFF_STEP = 6.0  # the same for one step among the others: there are many
_IMPLAUSIBLE = 5e4  # ppm by which no second path differs


def _finding(found: SelfcalEvaluation, *, shared: bool) -> str:
    """That the test has failed, and by which steps; empty where it has not."""
    share, compared = found.net.output / found.number, found.comparison
    u = np.hypot(found.net.output_u, found.net.static_u) / np.abs(found.number)
    usual = float(np.median(share))
    scatter = np.hypot(u, 1.48 * float(np.median(np.abs(share - usual))))
    off = np.flatnonzero(np.abs(share - usual) > _OFF_STEP * scatter)
    allowed = _FINDING * compared.against_numbers_u_ppm if shared else _IMPLAUSIBLE
    if not off.size and abs(compared.against_numbers_ppm) <= allowed:
        return ""
    where = f"The steps give {usual:.7g} times their numbers in the median"
    if off.size:
        where += ", but these not: " + ", ".join(f"{found.keys[at]} ({share[at]:.6g})" for at in off)
    difference = ppm(compared.against_numbers_ppm, compared.against_numbers_u_ppm)
    return (
        f"The self-calibration FAILED: K_self differs from the slope of the numbers by {difference}. {where}. "
        "Steps of another size, late, missing, exchanged; a converter, adder or output that wraps or saturates."
    )


def _to_watch(found: SelfcalEvaluation, settings: FogSettings) -> list[str]:
    net, fit = found.net, found.fit
    said = [f"{one.sentence}." for one in found.left_out]
    if finding := _finding(found, shared=settings.selfcal.path == "shared"):
        said.append(finding)
    elif implausible := far_from_design(fit.slope, settings):
        said.append(implausible)
    if found.static_missing:
        said.append(
            f"There is no static output {found.static_missing} the steps: a drift of the bias is not seen."
        )
    if abs(net.drift) > 3 * net.drift_u:
        drift = with_uncertainty(net.drift, net.drift_u)
        said.append(
            f"The static output moved by {drift} counts between before and after: the bias drifts. It was "
            "interpolated in time."
        )
    if abs(fit.intercept) > 4 * _intercept_u(found):
        said.append(
            f"The intercept F_0 is {with_uncertainty(fit.intercept, fit.intercept_u)} counts and not zero within "
            "its uncertainty: a dead zone, a drift of the bias, or steps that are not equal in both senses."
        )
    if fit.chi_square > 4 * fit.degrees_of_freedom:
        said.append(
            "The points lie off the line by more than their noise; the uncertainties were widened to match."
        )
    said += found.remarks
    return said + (to_watch_of_table(found.table, settings) if found.table is not None else [])


# --------------------
# The self-calibration in the report: steps and output, slope and intercept, its own rate-table run


def sections(found: SelfcalEvaluation, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    rows = tuple(
        (f"{rate:+.10g} deg/s", f"{given:.6f}", with_uncertainty(float(out), float(u)), f"{out - given:+.3g}")
        for rate, given, out, u in zip(
            found.rate_dps, found.number, found.net.output, found.net.output_u, strict=True
        )
    )
    made = [
        Section("What this result shows, and what it cannot", sentences=result.sentences),
        Section(
            "Injected steps and output",
            figures=(
                PlacedFigure(_steps_svg(found), "Net output against the rate that each step stands for."),
                PlacedFigure(
                    _residuals_svg(found), "Net output less the injected number, and less the fitted line."
                ),
            ),
            table=TextTable(("stands for", "injected, counts", "net output, counts", "difference, counts"), rows),
        ),
        Section("Slope, intercept and static output", table=_slope_table(found)),
        Section("Budget", table=budget_table("K_self", result.document["budget"])),
        staircase_section(settings),
    ]
    if found.table is not None and found.table.axes:
        made.append(Section("Rate-table run of the same run", table=axis_table(found.table, settings)))
    return made


def _slope_table(found: SelfcalEvaluation) -> TextTable:
    fit, net, reference = found.fit, found.net, found.reference
    rows = [
        (f"slope K_self, {COUNTS_PER_DPS}", with_uncertainty(fit.slope, fit.slope_u)),
        ("slope of the injected numbers", f"{found.numbers.slope:.9g}"),
        ("intercept F_0, counts", with_uncertainty(fit.intercept, math.hypot(fit.intercept_u, net.static_u))),
        ("static output N_0, counts", with_uncertainty(net.static, net.static_u)),
        ("static output after less before", with_uncertainty(net.drift, net.drift_u)),
    ]
    if reference is not None:
        rows.append((f"K, {reference.source}", with_uncertainty(reference.scale_factor, reference.scale_factor_u)))
    return TextTable(("", "value"), tuple(rows))


def _steps_svg(found: SelfcalEvaluation) -> str:
    """Draw the net output against the injected steps, and the fitted line."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        span = np.array([found.rate_dps.min(), found.rate_dps.max()]) * 1.04
        axes.plot(span, found.fit.intercept + found.fit.slope * span, color=ACCENT, linewidth=1.0, label="fit")
        axes.plot(found.rate_dps, found.net.output, "o", ms=5, color=SECOND, label="net output")
        axes.set(xlabel="rate that the injected step stands for, deg/s", ylabel="counts")
        legend_above(axes)

    return svg_element("injected", HALF, draw)


def _residuals_svg(found: SelfcalEvaluation) -> str:
    """Draw net output less injected number, which is what the shared path tests, and the residuals of the fit."""
    rate, u = found.rate_dps, found.net.output_u
    scale = PPM / np.abs(found.number).max()

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        place = np.arange(rate.size)
        order = np.argsort(rate)
        for values, colour, offset, label in (
            (found.net.output - found.number, SECOND, -0.12, "output less injected number"),
            (found.fit.residual, ACCENT, 0.12, "output less fitted line"),
        ):
            axes.errorbar(
                place + offset, scale * values[order], yerr=scale * u[order], fmt="o", ms=4, capsize=2,
                color=colour, linewidth=0.9, label=label,
            )  # fmt: skip
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set_xticks(place, [f"{value:+g}" for value in rate[order]])
        axes.set(xlabel="rate that the step stands for, deg/s", ylabel="ppm of full scale")
        legend_above(axes, columns=2)

    return svg_element("selfcal-residuals", HALF, draw)


def plan(settings: FogSettings, numbers: InjectionPlan) -> tuple[list[PlannedSegment], dict[str, str]]:
    """List the segments: rest, every step, rest; steps beyond the converter are left out by name."""
    chosen, gyro = settings.selfcal, settings.gyro
    rest = PlannedSegment("static before", chosen.static_s, chosen.settle_s, _conditions("before", 0.0, 0.0, 0.0))
    planned, left_out = [rest], {}
    for rate, number, u in zip(numbers.rate_dps, numbers.number, numbers.number_u, strict=True):
        step = float(number) / gyro.counts_per_code
        if steps_beyond_dac(step, gyro.dac_bits):
            left_out[_key(rate)] = beyond_converter(step, gyro.dac_bits)
            continue
        conditions = {**_conditions(None, float(rate), float(number), step), "number_u": float(u)}
        planned.append(PlannedSegment(_key(rate), chosen.step_s, chosen.settle_s, conditions))
    rest = PlannedSegment("static after", chosen.static_s, chosen.settle_s, _conditions("after", 0.0, 0.0, 0.0))
    return [*planned, rest], left_out


def take(settings: FogSettings, session: Acquisition) -> None:
    """Take the segments on the bench; a simulated one without the numbers of a table run takes that run first."""
    if not settings.simulated and NUMBERS not in session.facts:
        numbers_for(settings, None)  # says what is missing before anything moves

    def own_table(run: SavedRun) -> list[PlannedSegment]:
        needed = settings.simulated and REFERENCE not in run.facts
        return plan_table(settings, [settings.selfcal.axis]) if needed else []

    def injections(run: SavedRun) -> list[PlannedSegment]:
        planned, left_out = plan(settings, numbers_of(run, settings))
        session.note_left_out(left_out)
        return planned

    take_segments(settings, session, open_fog_bench(settings), [own_table, injections], truth_of(settings))


def take_files(settings: FogSettings, paths: Sequence[Path], session: Acquisition) -> None:
    """Make a run of logs; each names the step and the rate that it stands for, 0 at rest."""
    mapping_u = numbers_u_of(session.facts, settings)

    def named(rows: Sequence[LogRow], settings: FogSettings) -> list[NamedSegment]:
        at_rest, found = [place for place, row in enumerate(rows) if row["number"] == 0], []
        for place, row in enumerate(rows):
            rate, number, static = row["stands_for_dps"], row["number"], None
            if place in at_rest:
                static = "between" if at_rest[0] < place < at_rest[-1] else "after"
                static = "before" if place == at_rest[0] and place < len(rows) - 1 else static
            conditions = _conditions(static, rate, number, number / settings.gyro.counts_per_code)
            if not static:
                conditions["number_u"] = row["number_u"] if "number_u" in row else mapping_u(rate)
            found.append((f"static {static}" if static else _key(rate), conditions))
        return found

    listed_logs(PURPOSE, ("stands_for_dps", "number"), named)(settings, paths, session)


def _key(rate_dps: float) -> str:
    return f"inject {rate_dps:+.10g}"


def _conditions(static: str | None, stands_for_dps: float, number: float, step_codes: float) -> dict[str, object]:
    """What a segment is; `static` names an output at rest: ``"before"``, ``"between"``, ``"after"`` the steps."""
    return {
        "purpose": PURPOSE,
        "static": static,
        "rate_dps": 0.0,
        "stands_for_dps": stands_for_dps,
        "number": number,
        "step_codes": step_codes,
    }


MEASUREMENT = gyro_measurement(
    PURPOSE,
    "Self-calibration by injected staircase",
    take=take,
    take_files=take_files,
    evaluate=evaluate,
    result=result,
    sections=sections,
    quantities=QUANTITIES,
    purposes=(TABLE, PURPOSE),
    choices=(NOISE,),
)
