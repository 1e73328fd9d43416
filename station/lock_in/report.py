"""One self-contained HTML file that shows a result: value, plots, settings, conditions, provenance."""

from __future__ import annotations

from pathlib import Path

from station.lock_in.evaluation import Evaluation
from station.lock_in.report_facts import fact_tables, record_table
from station.lock_in.sections import report_sections
from station.lock_in.sentences import flag_sentences, interval_words, lock_in_words, no_result_words
from station.provenance import version
from station.report.page import render_page, write_page
from station.results.parts import Headline
from station.runs.store import REPORT_FILE, SavedRun


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
    return write_page(path or run.path.parent / REPORT_FILE, render_report(evaluation, run))


def render_report(evaluation: Evaluation, run: SavedRun) -> str:
    """Return the report as HTML text; arguments as :func:`write_report`."""
    gyro = run.facts["settings"]["gyro"]["name"]
    tables = fact_tables(evaluation, run)
    middle = (len(tables) + 1) // 2
    return render_page(
        "report.html.j2",
        title=f"Lock-in rate of {gyro}, {run.facts['started_at'][:10]}",
        version=version("gyrolock"),
        gyro=gyro,
        simulated=run.facts["simulated"],
        headline=_headline(evaluation),
        sections=report_sections(evaluation, run),
        flags=flag_sentences(evaluation),
        fact_columns=[tables[:middle], tables[middle:]],
        records=record_table(evaluation),
        footer=_footer(run),
    )


def _headline(evaluation: Evaluation) -> Headline:
    counted = len(evaluation.waveforms) - int(evaluation.combined.records_rejected)
    at = f" at {len(evaluation.several.groups)} rates" if evaluation.several is not None else ""
    if not evaluation.usable:
        return Headline(False, "No lock-in rate", "", (no_result_words(evaluation),))
    value, value_dph = lock_in_words(evaluation)
    lines = [
        f"95 % interval {interval_words(evaluation)}, from {counted} record{'s' if counted != 1 else ''}{at}."
    ]
    if evaluation.truth is not None:
        true = evaluation.truth["lock_in_rate_dps"]
        distance = (float(evaluation.combined.lock_in_rate) - true) / float(evaluation.combined.lock_in_rate_u)
        lines.append(f"The simulation's truth is {true:.6g} deg/s: the result lies {distance:+.1f} u from it.")
    return Headline(True, value, value_dph, tuple(lines))


def _footer(run: SavedRun) -> str:
    return (
        f"Made by gyrolock {version('gyrolock')} from the saved records of {run.path.parent.name}. "
        "`gyrolock analyze` computes the numbers again."
    )
