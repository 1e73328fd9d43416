"""How every command that has a run ends: evaluated, saved, reported, printed, exit code."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from station.errors import EXIT_FAIL, EXIT_NO_SIGNAL, EXIT_OK, Failure, NoUsableSignal, RunError

if TYPE_CHECKING:
    from pathlib import Path

    from station.runs.taking import Taken
    from station.shell.evaluated import Evaluated


def print_json(document: Mapping[str, Any]) -> None:
    """Print one JSON document; null stands for what is not finite."""
    from station.results.as_json import plain

    click.echo(json.dumps(plain(document), allow_nan=False))


def print_failure(failure: Failure) -> None:
    """Print the one line of an error to stderr."""
    click.echo(f"gyrolock: {failure.message}", err=True)


def finish(taken: Taken, *, report: bool, as_json: bool, saved: bool = False, config: Path | None = None) -> int:
    """Say what a run says, also when it holds less than was planned.

    Parameters
    ----------
    report, as_json : bool
        Write the report; print one JSON document instead of words.
    saved : bool, optional
        It was taken before: a file that cannot be read is then the file's fault.
    config : Path, optional
        Settings file with what is known of the bench now, and with the limits.

    Returns
    -------
    int
        Exit code.
    """
    from station.runs.store import open_run
    from station.shell.evaluated import about_run, evaluate_run

    run, failure = open_run(taken.path), taken.failure
    document: dict[str, Any] = {"command": run.facts.command, **about_run(run)}
    verdict = None
    try:
        evaluated = evaluate_run(run, config=config)
    except (NoUsableSignal, RunError) as error:
        if saved and not isinstance(error, NoUsableSignal):
            raise
        # a run that was just taken and holds nothing of use: the signal is to blame, not the file
        failure = failure or Failure(error.kind, str(error), EXIT_NO_SIGNAL)
    else:
        document, verdict = show(evaluated, report=report, as_json=as_json), evaluated.verdict
        if evaluated.result.problem:
            failure = failure or Failure(NoUsableSignal.kind, evaluated.result.problem, EXIT_NO_SIGNAL)
    if failure is not None:
        document["error"] = failure.as_json()
    if as_json:
        print_json(document)
    else:
        click.echo(f"\nsaved   {run.path}")
        if run.facts.link_faults is not None and not run.facts.link_faults.clean:
            click.echo(f"link    {run.facts.link_faults}")
        if "report" in document:
            click.echo(f"report  {document['report']}")
    if failure is None:
        return EXIT_FAIL if verdict == "FAIL" else EXIT_OK
    print_failure(failure if taken.failure is None else taken.to_tell)
    return failure.exit_code


def show(evaluated: Evaluated, *, report: bool, as_json: bool) -> dict[str, Any]:
    """Save, report and print a result; return its document.

    Parameters
    ----------
    report, as_json : bool
        As for :func:`finish`; with `as_json` nothing is printed here but what is left out, on stderr.
    """
    from station.report.console import print_result

    document = keep(evaluated, report=report)
    if not as_json:
        print_result(evaluated)
    for sentence in (*(one.sentence for one in evaluated.result.left_out), *evaluated.not_tested):
        click.echo(f"gyrolock: {sentence}", err=True)
    return document


def keep(evaluated: Evaluated, *, report: bool) -> dict[str, Any]:
    """Save a result beside its records, with the report if wanted; return its document."""
    from station.report.report import write_report
    from station.runs.database import save_result

    document = evaluated.document()
    save_result(evaluated.run.path, document)
    if report:
        document["report"] = str(write_report(evaluated))
    return document
