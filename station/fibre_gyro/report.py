"""The report of a fibre gyro's test: one self-contained HTML file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from station.fibre_gyro import sections
from station.fibre_gyro.results import FogResult
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.store import FOG_REPORT_FILE, FogRun
from station.fibre_gyro.witness.sections import condition_rows as scope_rows
from station.provenance import version
from station.report.page import render_page, write_page
from station.results.parts import FactTable, Headline, Rows
from station.runs.store import SavedRun

_TITLES = {
    "table": "Scale factor by rate table",
    "selfcal": "Self-calibration by injected staircase",
    "eps": "2π error by open-loop injection",
    "figures": "Figures of merit of the scale factor",
    "witness": "Modulator staircase by oscilloscope",
}


def write_fog_report(result: FogResult, run: FogRun | SavedRun, path: Path | None = None) -> Path:
    """Write the report of a run; the file appears whole or not at all.

    Parameters
    ----------
    result : FogResult
    run : FogRun or SavedRun
        The latter of the oscilloscope on the modulator.
    path : Path, optional
        By default ``report.html`` beside the run's file.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    return write_page(path or run.path.parent / FOG_REPORT_FILE, render_fog_report(result, run))


def render_fog_report(result: FogResult, run: FogRun | SavedRun) -> str:
    """Return the report as HTML text; arguments as :func:`write_fog_report`."""
    name = result.settings.gyro.name
    tables = _fact_tables(result, run)
    middle = (len(tables) + 1) // 2
    return render_page(
        "fibre_gyro.html.j2",
        title=f"{_TITLES[result.command]}: {name}, {run.facts['started_at'][:10]}",
        heading=f"{_TITLES[result.command]}: {name}",
        version=version("gyrolock"),
        simulated=run.facts["simulated"],
        verdict=result.verdict,
        headline=Headline(True, result.value, "", (*result.lines, *(f"{one.sentence}." for one in result.tested))),
        sections=sections.sections_of(result),
        fact_columns=[tables[:middle], tables[middle:]],
        footer=_footer(result, run),
    )


def _fact_tables(result: FogResult, run: FogRun | SavedRun) -> list[FactTable]:
    settings = result.settings
    conditions = scope_rows(run, settings) if isinstance(run, SavedRun) else _condition_rows(result, run)
    tables = [
        FactTable("Gyro by design", _gyro_rows(settings)),
        FactTable("Limits", [(one.name, one.sentence) for one in result.tested]),
        FactTable("Conditions", conditions),
        FactTable("Truth of the simulation", _truth_rows(run)),
        FactTable("Provenance", _provenance_rows(run)),
    ]
    return [table for table in tables if table.rows]


def _gyro_rows(settings: FogSettings) -> Rows:
    gyro, coil = settings.gyro, settings.coil
    return [
        ("fibre, coil", f"{gyro.coil_length_m:g} m, mean diameter {1e3 * gyro.coil_diameter_m:g} mm"),
        ("wavelength", f"{gyro.wavelength_um:g} µm"),
        ("transit time", f"{1e6 * coil.transit_time:.4f} µs, bias at {1e-3 * coil.proper_frequency:.3f} kHz"),
        ("converter", f"{gyro.dac_bits} bits, {gyro.fraction_bits} fractional bits below"),
        ("nominal scale factor", f"{settings.nominal_scale_factor:.6f} counts per deg/s"),
        ("one code", f"{3600 * gyro.counts_per_code / settings.nominal_scale_factor:.4g} deg/h"),
        ("samples with a reset", "left out of the integrator" if gyro.gated_resets else "used"),
        ("fringe limit", f"{coil.fringe_limit_dps:.1f} deg/s"),
    ]


def _condition_rows(result: FogResult, run: FogRun) -> Rows:
    settings, losses = result.settings, [segment.recording.losses for segment in run.segments]
    clocks = sorted({segment.recording.clock for segment in run.segments})
    models = sorted(
        {str(segment.conditions["model"]) for segment in run.segments if "model" in segment.conditions}
    )
    source = settings.link.port or "simulated gyro"
    rows: Rows = [
        ("output from", ", ".join(run.facts["logs"]) if run.facts.get("logs") else source),
        ("segments", f"{len(run.segments)}, {sum(s.recording.duration_s for s in run.segments):.0f} s of output"),
        ("frames", f"{sum(one.good for one in losses)} used, {sum(one.missing for one in losses)} missing"),
        ("clock", ", ".join(clocks)),
        ("latitude", f"{settings.site.latitude_deg:g}°"),
    ]
    if models:
        words = {"output": "words by the output model", "transit": "every transit time computed"}
        rows.append(("simulation", ", ".join(words[model] for model in models)))
    if any(segment.conditions.get("acknowledged") is False for segment in run.segments):
        rows.append(("commands", "sent once and not acknowledged: nothing proves that they arrived"))
    return rows


def _truth_rows(run: FogRun | SavedRun) -> Rows:
    truth: dict[str, Any] = run.facts.get("truth", {})
    return [(name.replace("_", " "), f"{value:.9g}") for name, value in truth.items()]


def _provenance_rows(run: FogRun | SavedRun) -> Rows:
    facts, made = run.facts, run.facts["provenance"]
    outcome = facts.get("outcome", "cut short: the program was killed")
    rows: Rows = [
        ("taken", f"{facts['started_at']} to {facts.get('ended_at', 'unknown')}"),
        ("outcome", outcome if isinstance(outcome, str) else outcome["message"]),
        ("gyrolock", f"{made['gyrolock']}{', source ' + made['git'] if made['git'] else ''}"),
        ("Python", f"{made['python']} on {made['platform']}"),
    ]
    if facts.get("resumed_at"):
        rows.insert(1, ("resumed", ", ".join(facts["resumed_at"])))
    if facts["simulated"]:
        rows.append(("seed", str(facts["settings"]["simulation"]["seed"])))
    return rows


def _footer(result: FogResult, run: FogRun | SavedRun) -> str:
    return (
        f"Made by gyrolock {version('gyrolock')} from the saved output of {run.path.parent.name}. "
        f"`gyrolock fog {result.command} {run.path.parent.name}` computes the numbers again."
    )
