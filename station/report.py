"""One self-contained HTML file that shows a result: value, plots, settings, conditions, provenance."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from station import plots
from station.evaluate import Evaluation
from station.provenance import version
from station.runs import REPORT_FILE, SavedRun
from station.words import (
    flag_sentences,
    interval_words,
    lock_in_words,
    no_result_words,
    record_flags,
    with_prefix,
    with_uncertainty,
)

_ROWS_SHOWN = 200
Rows = list[tuple[str, str]]


@dataclass(frozen=True)
class Headline:
    """The result in large letters and the lines below it."""

    usable: bool
    value: str
    value_dph: str
    lines: tuple[str, ...]


@dataclass(frozen=True)
class PlacedFigure:
    """An SVG element with its caption."""

    svg: str
    caption: str


@dataclass(frozen=True)
class Section:
    """A heading with one figure, or with two side by side."""

    title: str
    text: str
    figures: tuple[PlacedFigure, ...]


@dataclass(frozen=True)
class FactTable:
    """A small table of names and values."""

    title: str
    rows: Rows


def write_report(evaluation: Evaluation, run: SavedRun, path: Path | None = None) -> Path:
    """Write the report of a run.

    Parameters
    ----------
    evaluation : Evaluation
    run : SavedRun
    path : Path, optional
        By default ``report.html`` beside the run's file.

    Returns
    -------
    Path
        What was written. The file appears whole or not at all.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    path = path or run.path.parent / REPORT_FILE
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        draft.write_text(render_report(evaluation, run), encoding="utf-8")
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
    return path


def render_report(evaluation: Evaluation, run: SavedRun) -> str:
    """Return the report as HTML text; arguments as :func:`write_report`."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("station"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    gyro = run.facts["settings"]["gyro"]["name"]
    tables = _fact_tables(evaluation, run)
    middle = (len(tables) + 1) // 2
    return environment.get_template("report.html.j2").render(
        title=f"Lock-in rate of {gyro}, {run.facts['started_at'][:10]}",
        version=version("gyrolock"),
        gyro=gyro,
        simulated=run.facts["simulated"],
        headline=_headline(evaluation),
        sections=_sections(evaluation),
        flags=flag_sentences(evaluation),
        fact_columns=[tables[:middle], tables[middle:]],
        records=_record_table(evaluation),
        footer=_footer(run),
    )


def _headline(evaluation: Evaluation) -> Headline:
    counted = len(evaluation.waveforms) - int(evaluation.combined.records_rejected)
    if not evaluation.usable:
        return Headline(False, "No lock-in rate", "", (no_result_words(evaluation),))
    value, value_dph = lock_in_words(evaluation)
    lines = [f"95 % interval {interval_words(evaluation)}, from {counted} record{'s' if counted != 1 else ''}."]
    if evaluation.truth is not None:
        true = evaluation.truth["lock_in_rate_dps"]
        distance = (float(evaluation.combined.lock_in_rate) - true) / float(evaluation.combined.lock_in_rate_u)
        lines.append(f"The simulation's truth is {true:.6g} deg/s: the result lies {distance:+.1f} u from it.")
    return Headline(True, value, value_dph, tuple(lines))


def _sections(evaluation: Evaluation) -> list[Section]:
    sections = []
    shown = _shown_record(evaluation)
    if shown is not None:
        wave, name = evaluation.waveforms[shown], evaluation.names[shown]
        sections += [
            Section(
                "The beat",
                "",
                (
                    PlacedFigure(
                        plots.time_record_svg(wave),
                        f"First periods of record {name}, and the fitted waveform.",
                    ),
                ),
            ),
            Section(
                "Its spectrum",
                "",
                (
                    PlacedFigure(
                        plots.spectrum_svg(wave),
                        f"Record {name}, Blackman-Harris window. Each harmonic of an ideal beat is weaker "
                        "than the one before by the same ratio r; r gives the lock-in rate.",
                    ),
                ),
            ),
            Section(
                "Fundamental and second harmonic",
                "The values come from the least-squares fit of the samples, not from the spectrum.",
                (
                    PlacedFigure(plots.line_svg(wave, 1), "Fundamental, enlarged."),
                    PlacedFigure(plots.line_svg(wave, 2), "Second harmonic, enlarged."),
                ),
            ),
        ]
    if evaluation.usable:
        caption = "Lock-in rate of every record with its standard uncertainty, and the combined value."
        sections.insert(
            0,
            Section("Records and combined value", "", (PlacedFigure(plots.values_svg(evaluation), caption),)),
        )
    return sections


def _shown_record(evaluation: Evaluation) -> int | None:
    """Pick the first record that gave a value, or else the first with a frequency."""
    for values in (evaluation.each.lock_in_rate, evaluation.each.beat_frequency):
        for index, value in enumerate(values):
            if math.isfinite(value):
                return index
    return None


def _fact_tables(evaluation: Evaluation, run: SavedRun) -> list[FactTable]:
    tables = [
        FactTable("Result", _result_rows(evaluation)),
        FactTable("Rate", _rate_rows(evaluation, run)),
        FactTable("Oscilloscope", _scope_rows(evaluation, run)),
        FactTable("Provenance", _provenance_rows(run)),
    ]
    return [table for table in tables if table.rows]


def _result_rows(evaluation: Evaluation) -> Rows:
    combined = evaluation.combined
    rows = [
        ("method", evaluation.method.text),
        ("scale factor K", f"{evaluation.method.scale_factor:g} pulses/deg"),
        ("noise model", combined.noise_model),
        ("uncertainty", "standard (k = 1) in brackets; the interval covers 95 %"),
        (
            "records",
            f"{len(evaluation.waveforms) + len(evaluation.damaged)}, left out {evaluation.records_rejected}",
        ),
    ]
    if evaluation.usable:
        rows += [
            ("ratio r = A2/A1", with_uncertainty(float(combined.ratio), float(combined.ratio_u))),
            ("backscatter less readout phase", f"{math.degrees(float(combined.backscatter_phase)):.1f}°"),
            ("amplitude", with_prefix(float(combined.amplitude), "V")),
            ("noise", f"{with_prefix(float(combined.noise_rms), 'V')} rms"),
        ]
    return rows


def _rate_rows(evaluation: Evaluation, run: SavedRun) -> Rows:
    combined, settings = evaluation.combined, run.facts["settings"]
    rows: Rows = []
    if math.isfinite(combined.beat_frequency):
        rows.append(
            (
                "beat frequency",
                with_uncertainty(float(combined.beat_frequency), float(combined.beat_frequency_u), "Hz"),
            )
        )
    if math.isfinite(combined.input_rate):
        rows.append(("rate on the axis, by the beat", f"{float(combined.input_rate):.6f} deg/s"))
    if (check := evaluation.table_check) is not None:
        rows += [
            ("rate on the axis, by the table", f"{check.input_rate:.6f} deg/s"),
            ("beat over table", f"{check.beat_over_table:.5f} (1 if K, tilt and table agree)"),
            (
                "lock-in rate, by the table",
                with_uncertainty(check.lock_in_rate, check.lock_in_rate_u, "deg/s"),
            ),
        ]
    if (table_rate := run.facts.get("table_rate_dps")) is not None:
        rows.append(("table rate", f"{table_rate:.5f} deg/s"))
    if evaluation.tilt is not None:
        rows.append(
            (
                "tilt of the axis",
                with_uncertainty(evaluation.tilt.tilt_deg, evaluation.tilt.tilt_u_deg, "deg"),
            )
        )
    if evaluation.table_check is not None:
        rows.append(("latitude", f"{settings['site']['latitude_deg']:g}°"))
    return rows


def _scope_rows(evaluation: Evaluation, run: SavedRun) -> Rows:
    settings, setting = run.facts["settings"]["scope"], run.facts.get("scope_setting", {})
    wave = evaluation.waveforms[0]
    rows = [
        ("instrument", run.facts["identity"]["text"]),
        ("resource", settings["resource"] or "simulated bench"),
        ("record", wave.preamble.wfid or settings["channel"]),
        ("sampling", f"{wave.codes.size} points, every {with_prefix(wave.sample_interval, 's')}"),
        ("bandwidth limit", "20 MHz" if settings["bandwidth_limit"] else "off"),
    ]
    if setting:
        rows += [
            ("vertical position", f"{setting['position']:+.2f} div"),
            ("trigger", f"{settings['channel']}, rising, {with_prefix(setting['trigger_level'], 'V')}"),
        ]
    return rows


def _provenance_rows(run: SavedRun) -> Rows:
    facts, made = run.facts, run.facts["provenance"]
    outcome = facts.get("outcome", "cut short: the program was killed")
    rows = [
        ("taken", f"{facts['started_at']} to {facts.get('ended_at', 'unknown')}"),
        ("outcome", outcome if isinstance(outcome, str) else outcome["message"]),
        ("gyrolock", f"{made['gyrolock']}{', source ' + made['git'] if made['git'] else ''}"),
        ("Python", f"{made['python']} on {made['platform']}"),
        ("packages", ", ".join(f"{name} {number}" for name, number in made["packages"].items())),
    ]
    if facts["simulated"]:
        rows.append(("seed", str(facts["settings"]["simulation"]["seed"])))
    return rows


def _record_table(evaluation: Evaluation) -> dict[str, Any]:
    header = ("record", "lock-in rate, deg/s", "beat, Hz", "r = A2/A1", "noise rms", "flags")
    each, rows = evaluation.each, []
    for index, (name, flags) in enumerate(zip(evaluation.names, record_flags(evaluation), strict=True)):
        rows.append(
            (
                name,
                with_uncertainty(float(each.lock_in_rate[index]), float(each.lock_in_rate_u[index])),
                with_uncertainty(float(each.beat_frequency[index]), float(each.beat_frequency_u[index])),
                with_uncertainty(float(each.ratio[index]), float(each.ratio_u[index])),
                with_prefix(float(each.noise_rms[index]), "V"),
                ", ".join(flags).replace("_", " "),
            )
        )
    if len(rows) > _ROWS_SHOWN:
        left = len(rows) - _ROWS_SHOWN
        rows = [*rows[:_ROWS_SHOWN], (f"and {left} more", "", "", "", "", "")]
    return {"header": header, "rows": rows}


def _footer(run: SavedRun) -> str:
    return (
        f"Made by gyrolock {version('gyrolock')} from the saved records of {run.path.parent.name}. "
        "`gyrolock analyze` computes the numbers again."
    )
