"""How the commands of ``gyrolock fog`` end: result saved, reported and printed, errors in one line."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from station.shell.options import print_failure, print_json

if TYPE_CHECKING:
    from pathlib import Path

    from station.errors import Failure
    from station.fibre_gyro.results import FogResult
    from station.fibre_gyro.store import FogRun
    from station.runs.store import SavedRun


def finish(
    run: FogRun | SavedRun,
    evaluate: Callable[[], FogResult],
    failure: Failure | None,
    *,
    report: bool,
    as_json: bool,
    resumable: Path | None = None,
) -> int:
    """Say what the saved run says, also when it holds less than was planned.

    Parameters
    ----------
    run : FogRun or SavedRun
    evaluate : callable
        Gives the result of the run.
    failure : Failure or None
        What stopped it before its time.
    report, as_json : bool
    resumable : Path, optional
        Directory of a run that was cut short and can be resumed.

    Returns
    -------
    int
        Exit code.
    """
    from station.errors import EXIT_FAIL, EXIT_OK, Failure, NoUsableSignal

    document: dict[str, Any] = {"command": run.facts.get("command")}
    verdict = None
    try:
        result = evaluate()
    except NoUsableSignal as error:
        failure = failure or Failure(error.kind, str(error), error.exit_code)
    else:
        document, verdict = _show(result, run, report=report, as_json=as_json)
    document["run"] = str(run.path)
    if failure is not None:
        document["error"] = failure.as_json()
    if as_json:
        print_json(document)
    else:
        click.echo(f"\nsaved   {run.path}")
        if "report" in document:
            click.echo(f"report  {document['report']}")
    if failure is not None:
        way_on = "" if resumable is None else f" (go on with --resume {resumable})"
        print_failure(Failure(failure.kind, f"{failure.message}{way_on}", failure.exit_code))
        return failure.exit_code
    return EXIT_FAIL if verdict == "FAIL" else EXIT_OK


def _show(
    result: FogResult, run: FogRun | SavedRun, *, report: bool, as_json: bool
) -> tuple[dict[str, Any], str | None]:
    """Save, report and print a result; return its document and its verdict."""
    from station.fibre_gyro.console import print_fog_result
    from station.fibre_gyro.report import write_fog_report
    from station.runs.database import save_result

    document = dict(result.document)
    save_result(run.path, document)
    if report:
        document["report"] = str(write_fog_report(result, run))
    if not as_json:
        print_fog_result(result, simulated=run.facts["simulated"], truth=run.facts.get("truth"))
    for one in result.evaluation.left_out:
        click.echo(f"gyrolock: {one.sentence}", err=True)
    return document, result.verdict
