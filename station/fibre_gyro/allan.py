"""The noise at rest: plan, noise model, Allan deviation, result and report; the model for other tests."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import (
    AllanCurve,
    NoiseFit,
    allan_curve,
    allan_variance,
    averaged_periodogram,
    deviation_of_means,
    fit_noise,
    noise_spectrum,
    sinusoid_variance,
    window_covariance,
)
from instrument.text_files import read_small_file
from station.errors import NoUsableSignal, UsageError
from station.fibre_gyro.common import COLOURS, COUNTS_PER_DPS, reasons_of
from station.fibre_gyro.logs import LogRow, NamedSegment, gyro_measurement, listed_logs, planned_segments
from station.fibre_gyro.segments import PlannedSegment, Segment, checked, segments_of, stuck_words, words_of
from station.fibre_gyro.settings import FogSettings, Name, TestSettings
from station.report.figure import INK, SOFT, WIDE, legend_above, svg_element
from station.results.quantity import UNITS, Quantity, QuantityGroup, document, repeated
from station.results.result import Excluded, PlacedFigure, Result, Section, TextTable, with_uncertainty
from station.runs.database import is_database
from station.runs.store import SavedRun, open_run
from station.settings import NotNegative, Positive

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# --------------------
# What the output at rest says: the noise model, and the Allan deviation beside it


PURPOSE = "allan"


class AllanSettings(TestSettings):
    """The noise at rest."""

    axis: Name
    record_s: Positive
    settle_s: NotNegative
    temperature: bool
    output_filter_hz: NotNegative


_own = AllanSettings.of


@dataclass(frozen=True)
class NoiseOf:
    """Noise of one record at rest; `curve` in deg/s, of the words with the missing ones put in."""

    key: str
    duration_s: float
    fit: NoiseFit
    curve: AllanCurve
    spectrum: tuple[Floats, Floats, Floats]  # Hz; (deg/s)^2/Hz and its u
    modelled: Floats  # the same spectrum by the model
    stability_10s: float  # deg/s, of means over so long
    stability_10s_u: float
    stability_100s: float
    stability_100s_u: float
    mean_dph: float
    remarks: tuple[str, ...]  # of what the words did
    rows_averaged: int  # of the log, in one word
    by_design: bool  # whether the output came in counts, which only the scale factor by design turns into deg/s


@dataclass(frozen=True)
class AllanEvaluation:
    """Noise of each record that could be used."""

    records: tuple[NoiseOf, ...]
    left_out: tuple[Excluded, ...]


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> AllanEvaluation:
    """Fit the noise model to each record."""
    found, left_out = [], list[Excluded]()
    for segment in segments_of(run, PURPOSE):
        with Excluded.by_error(segment.key, left_out):
            found.append(_noise_of(segment, settings))
    if not found:
        raise NoUsableSignal(f"there is no output at rest to make a noise model of{reasons_of(left_out)}")
    return AllanEvaluation(tuple(found), tuple(left_out))


def _noise_of(segment: Segment, settings: FogSettings) -> NoiseOf:
    recording = checked(segment)
    words = words_of(recording) / settings.nominal_scale_factor
    temperature = None
    if _own(settings).temperature:
        if recording.temperature is None or not np.ptp(recording.temperature) > 0:
            raise ValueError("its temperature is not there or does not change: take allan.temperature away")
        temperature = np.interp(
            np.arange(words.size) * recording.interval_s,
            recording.times - recording.times[0],
            recording.temperature,
        )
    try:
        corner = _own(settings).output_filter_hz or math.inf
        fit = fit_noise(words, recording.interval_s, temperature=temperature, filter_hz=corner)
    except np.linalg.LinAlgError:
        raise ValueError(
            "the spectrum of its output is not that of noise: the output is filtered, or is no output at rest; "
            "record it unfiltered, or state allan.output_filter_hz"
        ) from None
    shown = words if temperature is None else words - fit.temperature_slope * (temperature - temperature.mean())
    curve = allan_curve(shown, recording.interval_s, fit.coefficients)
    by_design = segment.conditions.get("output_unit", "counts") == "counts"
    mean, remarks = 3600 * float(np.nanmean(words)), stuck_words(words, recording.interval_s)
    levels = np.unique(words[np.isfinite(words)])
    if float(np.nanstd(words)) < _STEPS_OF_NOISE * float(np.diff(levels).min()):
        remarks.append(
            "the output has hardly more noise than one of its steps: N is that of the rounding, not of the gyro. "
            "Record it with more digits."
        )
    stability = [deviation_of_means(shown, recording.interval_s, tau) for tau in (10.0, 100.0)]
    spectrum = averaged_periodogram(shown, recording.interval_s)
    modelled = noise_spectrum(fit.coefficients, spectrum[0], recording.interval_s, corner)
    return NoiseOf(
        segment.key, words.size * recording.interval_s, fit, curve, spectrum, modelled, *stability[0],
        *stability[1], mean, tuple(remarks),
        int(segment.conditions.get("rows_averaged", 1)), by_design,
    )  # fmt: skip


# --------------------
# The noise model as numbers and sentences


# of each term of the model: its number, and how many of its unit one in deg and s is
TERMS = {
    "quantization": Quantity("quantization", "deg", u_last=True),
    "angle_random_walk": Quantity(
        "angle_random_walk", "deg_per_sqrt_h", u_last=True, scale=60.0, limit=True, headline=True
    ),
    "bias_instability": Quantity("bias_instability", "dph", u_last=True, scale=3600.0, limit=True),
    "rate_random_walk": Quantity("rate_random_walk", "dph_per_sqrt_h", u_last=True, scale=216_000.0, limit=True),
    "rate_ramp": Quantity("rate_ramp", "dph_per_h", u_last=True, scale=3600.0**2),
    # where the data ask for it
    "correlated_noise": Quantity(
        "correlated_noise", "dph", u_last=True, scale=3600.0, limit=True, optional=True,
        doc="standard deviation of Markov noise of first order",
    ),
    "correlation_time": Quantity("correlation_time", "s", u_last=True, optional=True, doc="of that noise"),
}  # fmt: skip
RECORD = (
    Quantity("duration", "s", "duration_s"),
    Quantity("temperature_slope", "dph_per_k", "fit.temperature_slope", u=True, scale=3600.0),
    Quantity("words", of="fit.words"),
    Quantity("missing", of="fit.missing"),
    Quantity("outliers", of="fit.outliers"),
    Quantity("sinusoid", "hz", lambda one: [line.frequency_hz for line in one.fit.sinusoids], doc="taken out"),
    Quantity(
        "sinusoid", "dph", lambda one: [3600 * line.amplitude for line in one.fit.sinusoids],
        lambda one: [3600 * line.amplitude_u for line in one.fit.sinusoids], doc="their amplitudes",
    ),
    Quantity("tau", "s", "curve.tau_s", doc="averaging times of the Allan deviation"),
    Quantity("allan_deviation", "dph", "curve.deviation", u=True, scale=3600.0),
)  # fmt: skip
# what data sheets ask for first
STABILITY = (
    *(
        Quantity(
            f"bias_stability_{tau}", "dph", f"stability_{tau}", u=True, scale=3600.0, limit=True, optional=True,
            doc=f"1 sigma of means over {tau[:-1]} s",
        )
        for tau in ("10s", "100s")
    ),
    Quantity(
        "allan_minimum", "dph", lambda one: one.curve.deviation[one.curve.lowest],
        lambda one: one.curve.deviation_u[one.curve.lowest], scale=3600.0, limit=True,
        doc="smallest Allan deviation that is known to a third",
    ),
    Quantity("allan_minimum_tau", "s", lambda one: one.curve.tau_s[one.curve.lowest], doc="where it is"),
)  # fmt: skip
QUANTITIES = (
    QuantityGroup((*TERMS.values(), *STABILITY, *RECORD), "records", "name", alone=False),
    QuantityGroup(repeated((*TERMS.values(), *STABILITY))),
)
_DESCRIBE = (
    "That is the shipped gyro: with another scale factor all numbers here are wrong by its ratio. Describe the "
    "coil in [gyro], or change gyro.counts_per_code in the ratio of a measured K to this one."
)


def result(found: AllanEvaluation, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    records = [_record(one) for one in found.records]
    several = len(records) > 1
    first = found.records[0]
    walk = first.fit.coefficients.get("angle_random_walk")
    value = "no angle random walk"
    if walk is not None:
        u = first.fit.coefficients_u["angle_random_walk"]
        value = f"N = {with_uncertainty(60 * walk, 60 * u)} deg/√h"
    corner = _own(settings).output_filter_hz
    behind = f" behind a filter of {corner:g} Hz, which is taken out" if corner else ""
    means = "" if first.rows_averaged == 1 else f" in means of {first.rows_averaged} rows, without what is faster"
    lines = [
        f"{first.key}: {first.duration_s / 3600:.3g} h of output{means}{behind}; by maximum likelihood, "
        f"in the model: {', '.join(TERMS[name].words for name in first.fit.chosen)}.",
        _stability_line(first),
    ]
    for one in found.records:
        if one.fit.sinusoids:
            sizes = (with_uncertainty(3600 * of.amplitude, 3600 * of.amplitude_u) for of in one.fit.sinusoids)
            waves = (
                f"{of.frequency_hz:.6g} Hz ({size} deg/h)"
                for of, size in zip(one.fit.sinusoids, sizes, strict=True)
            )
            lines.append(f"{one.key}: sinusoids of a vibration or pickup were taken out: {', '.join(waves)}.")
    counts = not run.facts.simulated and any(one.by_design for one in found.records)
    design = (
        (
            f"The output is in counts; it was turned into deg/h by the scale factor by design, "
            f"{settings.nominal_scale_factor:.6g} {COUNTS_PER_DPS}."
        )
        if counts
        else ""
    )
    watched = tuple(_to_watch(found))
    if design and not settings.gyro_is_described:
        watched = (*watched, f"{design} {_DESCRIBE}")
    return Result(
        name="result",
        value=value,
        document={**({} if several else records[0]), "records": records, "left_out": found.left_out},
        quantities=QUANTITIES,
        lines=tuple(lines),
        summary=[("", line) for line in lines],
        sentences=(*_sentences(found), *([design] if design and settings.gyro_is_described else [])),
        to_watch=watched,
        flags=watched,
        left_out=found.left_out,
        tables=tuple(term_table(one) for one in found.records),
    )


def _stability_line(one: NoiseOf) -> str:
    """Bias stability as data sheets give it."""
    said = [
        f"{with_uncertainty(3600 * value, 3600 * u)} deg/h (1 sigma of {tau} s)"
        for tau, value, u in (
            (10, one.stability_10s, one.stability_10s_u),
            (100, one.stability_100s, one.stability_100s_u),
        )
        if math.isfinite(value)
    ]
    place = one.curve.lowest
    lowest = with_uncertainty(3600 * one.curve.deviation[place], 3600 * one.curve.deviation_u[place])
    said.append(f"lowest Allan deviation {lowest} deg/h at {one.curve.tau_s[place]:.3g} s")
    return f"Bias stability: {', '.join(said)}."


def _record(one: NoiseOf) -> dict[str, Any]:
    fit, made = one.fit, {"name": one.key, "terms": one.fit.chosen, **document(one, (*STABILITY, *RECORD))}
    for term, declared in TERMS.items():
        scale = declared.scale
        known = term in fit.low_95
        made[declared.key()] = scale * fit.coefficients.get(term, 0.0) if known else None
        made[declared.key("u")] = scale * fit.coefficients_u[term] if term in fit.coefficients_u else None
        made[declared.key("low_95")], made[declared.key("high_95")] = (
            scale * end[term] if known else None for end in (fit.low_95, fit.high_95)
        )
    return made


def term_table(one: NoiseOf) -> TextTable:
    """Return all terms of one record: value or bound, and interval."""
    rows = []
    for term, declared in TERMS.items():
        fit, scale = one.fit, declared.scale
        if term not in fit.low_95:
            continue
        low, high = scale * fit.low_95[term], scale * fit.high_95[term]
        if term in fit.coefficients:
            said = with_uncertainty(scale * fit.coefficients[term], scale * fit.coefficients_u[term])
        else:
            said = "not seen"
        rows.append((declared.words, said, f"{low:.3g} to {high:.3g}", UNITS[declared.unit]))
    return TextTable((one.key, "coefficient", "95 %", "unit"), tuple(rows))


def _sentences(found: AllanEvaluation) -> list[str]:
    return [
        "Fitted is the likelihood of the output itself, not the slopes of the curve: the curve is for the eye. A "
        "term stands in the model if the data ask for it (Bayesian information criterion); of the others it is "
        "told how large they may be.",
        *(
            f"{one.key}: a drift with the temperature of {3600 * one.fit.temperature_slope:.3g}"
            f"({3600 * one.fit.temperature_slope_u:.1g}) deg/h per kelvin was taken out."
            for one in found.records
            if one.fit.temperature_slope == one.fit.temperature_slope
        ),
    ]


def _to_watch(found: AllanEvaluation) -> list[str]:
    said = [f"{one.sentence}." for one in found.left_out]
    for one in found.records:
        if one.fit.missing:
            said.append(f"{one.key}: {one.fit.missing} of {one.fit.words} output words are missing.")
        if one.fit.outliers:
            words = "1 output word lies" if one.fit.outliers == 1 else f"{one.fit.outliers} output words lie"
            said.append(f"{one.key}: {words} far from all others: left out.")
        said += [f"{one.key}: {sentence}" for sentence in _not_by_the_model(one)]
    return said


_STEPS_OF_NOISE = 0.6
"""Smallest step of an output over its scatter, inverted: with less than that rounding is no noise of its own."""

_LIKE_A_FILTER = 3.0  # correlated noise over the scatter of a word by white noise
_AT_REST_DPH = 150.0  # ten earth rates: a gyro whose mean output is more than that was turning


def _not_by_the_model(one: NoiseOf) -> list[str]:
    """What the output does that none of the five terms describes."""
    fit, said = one.fit, list(one.remarks)
    if abs(one.mean_dph) > _AT_REST_DPH:
        said.append(
            f"the mean output is {one.mean_dph:.4g} deg/h, more than ten earth rates: the gyro was turning, or "
            "the scale factor is wrong."
        )
    if fit.lines_hz:
        lines = ", ".join(f"{line:.4g}" for line in fit.lines_hz[:5])
        more = f" and {len(fit.lines_hz) - 5} more" if len(fit.lines_hz) > 5 else ""
        said.append(
            f"a line stands in the spectrum at {lines} Hz{more}: a vibration or a pickup whose amplitude or "
            "frequency is not constant, which the model takes for noise. Find it, and record again."
        )
    fast = fit.coefficients.get("angle_random_walk", 0.0) / math.sqrt(one.duration_s / fit.words)
    if (noise := fit.coefficients.get("correlated_noise", 0.0)) > _LIKE_A_FILTER * fast:
        corner = 1 / (2 * math.pi * fit.coefficients["correlation_time"])
        said.append(
            f"correlated noise of {3600 * noise:.3g} deg/h is far more than all that is faster: so looks white "
            f"noise behind a filter of {corner:.2g} Hz. If there is one, state allan.output_filter_hz."
        )
    if fit.bands:
        # one that is wide says more than one of a few slow lines
        widest = max(high - low for low, high, _ in fit.bands)
        wide = [band for band in fit.bands if band[1] - band[0] > 0.3 * widest]
        low, high, power = max(wide, key=lambda band: abs(math.log(max(band[2], 1e-9))))
        said.append(
            f"between {low:.3g} and {high:.3g} Hz the output has {power:.2g} times the power of the model: its "
            f"noise is not the sum of the five terms, and the coefficients are wrong. If it is "
            "filtered, state allan.output_filter_hz, or record it unfiltered."
        )
    if math.isfinite(fit.loudness) or math.isfinite(fit.slow_loudness):
        kind, times = ("noise", fit.loudness) if math.isfinite(fit.loudness) else ("slow noise", fit.slow_loudness)
        said.append(
            f"the {kind} is not the same all the time: in its loudest eighth {times:.2g} times that of all. A "
            "touch, a jump, a switch, or an output that stood still; use the part of the log that is steady."
        )
    return said


# --------------------
# The noise model in the report: Allan deviation with the fitted terms, and their table


def sections(found: AllanEvaluation, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    caption = "Overlapping Allan deviation; bars: standard uncertainty. Line: fitted model; dashed: its terms."
    of_spectrum = "Averaged periodogram of the same output; bars: standard uncertainty. Line: fitted model."
    return [
        Section("What was fitted", sentences=result.sentences),
        *(
            section
            for place, one in enumerate(found.records)
            for section in (
                Section(
                    f"Noise of {one.key}",
                    figures=(PlacedFigure(_svg(one, place), caption),),
                    table=term_table(one),
                ),
                Section(f"Spectrum of {one.key}", figures=(PlacedFigure(_spectrum(one, place), of_spectrum),)),
            )
        ),
    ]


def _svg(one: NoiseOf, place: int) -> str:
    """Draw the Allan deviation, the model and its terms."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        tau = one.curve.tau_s
        deviation, u = 3600 * one.curve.deviation, 3600 * one.curve.deviation_u
        axes.errorbar(tau, deviation, u, fmt="o", ms=3, color=INK, linewidth=0.7, label="measured")
        terms = dict(one.fit.coefficients)
        time = {"correlation_time": terms.pop("correlation_time", math.nan)}
        variances = {
            TERMS[term].words: allan_variance({term: value} | time, tau) for term, value in terms.items()
        } | {
            f"{line.frequency_hz:.4g} Hz": sinusoid_variance(line.frequency_hz, line.amplitude, tau)
            for line in one.fit.sinusoids
        }
        total = np.asarray(sum(variances.values()))
        axes.plot(tau, 3600 * np.sqrt(total), color=COLOURS[0], linewidth=1.6, label="model")
        for index, (term, variance) in enumerate(variances.items(), start=1):
            colour = COLOURS[index % 7]
            axes.plot(tau, 3600 * np.sqrt(variance), "--", color=colour, linewidth=0.9, label=term)
        axes.set(xscale="log", yscale="log", xlabel="averaging time, s", ylabel="Allan deviation, deg/h")
        axes.set_ylim(0.5 * float(deviation.min()), 2.0 * float(deviation.max()))
        axes.grid(color=SOFT, linewidth=0.3)
        legend_above(axes, columns=4)

    return svg_element(f"allan-{place}", WIDE, draw)


def _spectrum(one: NoiseOf, place: int) -> str:
    """Draw the spectrum of the output and that of the model."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        frequency, level, u = one.spectrum
        root = 3600 * np.sqrt(level)
        axes.errorbar(
            frequency, root, root * u / level / 2, fmt="o", ms=3, color=INK, linewidth=0.7, label="measured"
        )
        axes.plot(frequency, 3600 * np.sqrt(one.modelled), color=COLOURS[0], linewidth=1.6, label="model")
        for line in one.fit.sinusoids:
            axes.axvline(line.frequency_hz, color=COLOURS[2], linewidth=0.7, linestyle=":")
        axes.set(xscale="log", yscale="log", xlabel="frequency, Hz", ylabel="output, deg/h per √Hz")
        axes.grid(color=SOFT, linewidth=0.3)
        legend_above(axes, columns=2)

    return svg_element(f"spectrum-{place}", WIDE, draw)


def plan(settings: FogSettings) -> list[PlannedSegment]:
    """List the one segment: rest."""
    chosen = _own(settings)
    conditions = {"purpose": PURPOSE, "rate_dps": 0.0, "axis": chosen.axis, "end_up": 1}
    return [PlannedSegment(f"{chosen.axis} at rest", chosen.record_s, chosen.settle_s, conditions)]


def named(rows: Sequence[LogRow], settings: FogSettings) -> list[NamedSegment]:
    """Name the segment of each log by its axis."""
    return [(f"{row.get('axis', '')} at rest".strip(), {"rate_dps": 0.0}) for row in rows]


MEASUREMENT = gyro_measurement(
    PURPOSE,
    "Noise at rest",
    take=planned_segments(plan),
    take_files=listed_logs(PURPOSE, (), named, whole=True),
    evaluate=evaluate,
    result=result,
    sections=sections,
    quantities=QUANTITIES,
    plan=plan,
    section=AllanSettings,
)


# --------------------
# The noise model that another run found, for what the slow noise of the gyro makes of a run.
#
# `--noise` names a run of `gyrolock fog allan`, its JSON document, or a JSON file with the numbers of a data
# sheet:
#
#     {"angle_random_walk_deg_per_sqrt_h": 0.005, "bias_instability_dph": 0.05}


Floats = NDArray[np.float64]

NOISE = "noise"  # fact of a run, and choice of its evaluation
_LARGEST = 64_000_000  # bytes
_FAST = ("angle_random_walk", "quantization")
_AXES = ("X", "Y", "Z")


@dataclass(frozen=True)
class NoiseModel:
    """Noise of one gyro."""

    coefficients: dict[str, float]  # deg and s
    source: str  # where it comes from, in words

    def fast_variance(self, duration_s: Floats) -> Floats:
        """Variance of means by white noise and quantization, (deg/s)^2."""
        white, angle = (self.coefficients.get(name, 0.0) for name in _FAST)
        return np.asarray(white**2 / duration_s + 2 * (angle / duration_s) ** 2)

    def slow_covariance(self, begin_s: Floats, end_s: Floats) -> Floats:
        """Generalised covariance of means by bias instability and rate random walk, (deg/s)^2."""
        slow = {name: value for name, value in self.coefficients.items() if name not in _FAST}
        return window_covariance(slow, begin_s, end_s)


def noise_facts(path: Path | None) -> dict[str, Any]:
    """Return a noise model as fact of the run that uses it; nothing without a path."""
    if path is None:
        return {}
    records = _of_run(path) if path.exists() and (path.is_dir() or is_database(path)) else _of_json(path)
    gyros: dict[str, dict[str, float]] = {}
    for name, coefficients in records:
        first = name.split(" ")[0].upper()
        gyros.setdefault(first if first in _AXES and len(records) > 1 else "", coefficients)
    return {NOISE: {"source": str(path), "gyros": gyros}}


def noise_of(run: SavedRun, choices: Mapping[str, Any], axis: str) -> NoiseModel | None:
    """Return the noise model of the gyro of one axis: one that is chosen now, or the one that the run knows."""
    known = choices.get(NOISE) or run.facts.get(NOISE)
    if not known:
        return None
    gyros = known["gyros"]
    coefficients = gyros.get(axis.upper(), gyros.get(""))
    return None if coefficients is None else NoiseModel(dict(coefficients), known["source"])


def _of_run(path: Path) -> list[tuple[str, dict[str, float]]]:
    from station.fibre_gyro.settings import FIBRE_GYRO
    from station.settings import saved_settings

    run = open_run(path)
    if run.facts.command != PURPOSE:
        raise UsageError(
            f"{path}: is a run of {run.facts.command!r}; a noise model comes from `gyrolock fog allan`"
        )
    found = evaluate(run, saved_settings(FIBRE_GYRO, run.facts.settings, str(run.path)), {})
    return [(one.key, dict(one.fit.coefficients)) for one in found.records]


def _of_json(path: Path) -> list[tuple[str, dict[str, float]]]:
    try:
        document = json.loads(read_small_file(path, _LARGEST))
    except (UnicodeDecodeError, json.JSONDecodeError):
        document = None
    if not isinstance(document, dict):
        raise UsageError(
            f"{path}: is neither a run of `gyrolock fog allan` nor its JSON: name one of them for the noise model"
        )
    records = document.get("records") or [document]
    return [(str(one.get("name", "")), _coefficients(one, path)) for one in records if isinstance(one, dict)]


def _coefficients(record: Mapping[str, Any], path: Path) -> dict[str, float]:
    found = {}
    for term, declared in TERMS.items():
        value = record.get(declared.key()) or 0.0
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
            unit = UNITS[declared.unit]
            raise UsageError(f"{path}: {declared.key()}: {value!r} is no number of {unit}, 0 or more")
        if value:
            found[term] = value / declared.scale
    if ("correlated_noise" in found) != ("correlation_time" in found):
        raise UsageError(f"{path}: correlated_noise_dph and correlation_time_s belong together: state both")
    if not any(name != "rate_ramp" for name in found):
        names = ", ".join(declared.key() for declared in TERMS.values())
        raise UsageError(f"{path}: holds no noise model; it has numbers under the names {names}")
    return found
