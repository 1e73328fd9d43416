"""The tables of a report: result, rate, oscilloscope, provenance, records."""

from __future__ import annotations

import math

from station.lock_in.evaluation import Evaluation
from station.lock_in.sentences import record_flags, with_prefix, with_uncertainty
from station.results.parts import FactTable, Rows, Table
from station.runs.store import SavedRun

_ROWS_SHOWN = 200


def fact_tables(evaluation: Evaluation, run: SavedRun) -> list[FactTable]:
    """Return settings, conditions and secondary results as small tables.

    Parameters
    ----------
    evaluation : Evaluation
    run : SavedRun

    Returns
    -------
    list of FactTable
    """
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
        ("method", evaluation.method_text),
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
    several = evaluation.several
    # the rate of the other rows, which is not the last one that the table was set to
    table_rate = run.facts.get("table_rate_dps") if several is None else several.reference_group.table_rate
    if table_rate is not None:
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


def record_table(evaluation: Evaluation) -> Table:
    """Return one row for each record; argument as above."""
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
    return Table(header, tuple(rows))
