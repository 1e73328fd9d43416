"""How every command that has a run ends: evaluated, reported, saved, printed, exit code."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from station.errors import (
    EXIT_FAIL,
    EXIT_NO_SIGNAL,
    EXIT_OK,
    EXIT_OUTPUT,
    CannotWrite,
    Failure,
    NoUsableSignal,
    RunError,
    describe_failure,
    one_line,
)
from station.terminal.lines import print_failure, print_json, remark, say

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from station.events.event import Events
    from station.runs.store import SavedRun
    from station.runs.taking import Taken
    from station.shell.evaluated import Evaluated


def finish(
    taken: Taken,
    *,
    report: bool,
    as_json: bool,
    quiet: bool = False,
    saved: bool = False,
    config: Path | None = None,
    choices: Mapping[str, Any] | None = None,
    events: Events | None = None,
) -> int:
    """Say what a run says, also when it holds less than was planned."""
    from station.shell.evaluated import about_run, evaluate_run

    run, failure = run_as_it_ends(taken) if not saved else taken.run(), taken.failure
    document: dict[str, Any] = {"command": run.facts.command, **about_run(run)}
    verdict, lost, unfinished = None, None, None
    try:
        evaluated = evaluate_run(run, config=config, choices=choices)
        document, lost = keep(evaluated, report=report)
        verdict = evaluated.verdict
        if events is not None:
            tell_result(evaluated, events)
        show(evaluated, words=not (as_json or quiet))
        if evaluated.result.problem:
            failure = failure or Failure(NoUsableSignal.kind, evaluated.result.problem, EXIT_NO_SIGNAL)
    except (NoUsableSignal, RunError) as error:
        if saved and not isinstance(error, NoUsableSignal):
            raise
        # a run that was just taken and holds nothing of use: the signal is to blame, not the file
        failure = unfinished = failure or Failure(error.kind, str(error), EXIT_NO_SIGNAL)
        tell_damage(run)
    except KeyboardInterrupt as error:
        failure = unfinished = failure or describe_failure(error)
    if not saved:
        lost = save_outcome(run, taken.failure or lost or unfinished) or lost
    failure = failure or lost
    if failure is not None:
        document["error"] = failure.as_json()
    if failure is not None and failure in (lost, unfinished):
        document["outcome"] = failure.message
    if as_json or (quiet and failure is not None):
        print_json(document if as_json else {"error": failure.as_json() if failure else None})
    elif not quiet:
        say(f"\nsaved   {run.path}")
        if run.facts.link_faults is not None and not run.facts.link_faults.clean:
            say(f"link    {run.facts.link_faults}")
        if "report" in document:
            say(f"report  {document['report']}")
    if lost is not None and lost is not failure:
        print_failure(lost)
    if failure is None:
        return EXIT_FAIL if verdict == "FAIL" else EXIT_OK
    print_failure(failure if taken.failure is None else taken.to_tell)
    return failure.exit_code


def run_as_it_ends(taken: Taken) -> SavedRun:
    """Return a run that was just taken with the outcome that it has when its result and its report are there."""
    from station.runs.facts import COMPLETE

    return taken.run(COMPLETE if taken.failure is None else taken.failure.as_json())


def keep(evaluated: Evaluated, *, report: bool) -> tuple[dict[str, Any], Failure | None]:
    """Write the report if it is wanted, and save the result beside its records."""
    from station.report.report import write_report
    from station.runs.database import save_result

    document, lost, path = evaluated.document(), None, evaluated.run.path
    told = dict(document)
    if report:
        try:
            told["report"] = str(write_report(evaluated))
        except OSError as error:
            reason = f"the report cannot be written ({one_line(error)})"
            text = f"{path.parent}: {reason}: `gyrolock report {path.parent}` makes it again"
            lost = Failure(CannotWrite.kind, text, EXIT_OUTPUT)
            document["outcome"] = told["outcome"] = text
    try:
        save_result(path, document)
    except RunError as error:
        lost = lost or describe_failure(error)
    return told, lost


def tell_result(evaluated: Evaluated, events: Events) -> None:
    """Tell those who watch what a run says."""
    result = evaluated.result
    events.emit(
        "result",
        run=str(evaluated.run.path),
        name=result.name,
        value=result.value,
        verdict=evaluated.verdict,
        standing=result.standing.state,
        measured=[{"name": one.name, "of": one.of, "value": one.value} for one in result.measured],
    )


def save_outcome(run: SavedRun, failure: Failure | None) -> Failure | None:
    """Save how a run has ended, when everything that belongs to it is there; returns what kept it from that."""
    from station.runs.facts import COMPLETE
    from station.runs.store import RunWriter

    try:
        with RunWriter(run.path) as writer:
            writer.save_facts({"outcome": COMPLETE if failure is None else failure.as_json()})
    except RunError as error:
        return describe_failure(error)
    return None


def show(evaluated: Evaluated, *, words: bool) -> None:
    """Print a result in words, and what is left out or damaged on stderr."""
    from station.report.console import print_result

    if words:
        print_result(evaluated)
    for sentence in (*(one.sentence for one in evaluated.result.left_out), *evaluated.not_tested):
        remark(sentence)
    tell_damage(evaluated.run)


def tell_damage(run: SavedRun) -> None:
    """Print what of a run is not what was once saved, on stderr."""
    for sentence in run.damaged:
        remark(f"{run.path}: {sentence}")
