"""From a run to the exit code: evaluated, judged, saved, reported, printed; runs begun and gone on with."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from station.datasets.data_set import whole
from station.errors import (
    DAMAGE,
    EXIT_NO_SIGNAL,
    EXIT_OUTPUT,
    CannotWrite,
    Failure,
    NoUsableSignal,
    RunError,
    UsageError,
    describe_failure,
    one_line,
)
from station.live.events import Events, Progress
from station.live.preview import See
from station.measurements import MEASUREMENTS, Measurement, measurement
from station.results.result import FactTable, Result, Section, plain
from station.results.verdict import LimitOutcome, Verdict, exit_code_of, judged, limits_in, worst
from station.runs.acquisition import Acquisition, Taken, facts_of, take
from station.runs.database import SUMS
from station.runs.store import Acknowledge, SavedRun, open_run
from station.settings import Values, saved_settings, settings_to_resume
from station.sources.batches import Source
from station.sources.find import open_source
from station.sources.run import SavedRecords, read_as_needed, source_of
from station.sources.workers import ThisProcess, Workers
from station.terminal import print_failure, print_json, remark, say

SCHEMA_VERSION = 2


@dataclass(frozen=True)
class Evaluated:
    """A run and what it says."""

    kind: Measurement[Any, Any]
    run: SavedRun
    settings: Any  # those of the run, with what is known of the bench now where that was given
    found: Any  # what the measurement computed
    result: Result
    tested: tuple[LimitOutcome, ...]

    @property
    def verdict(self) -> Verdict | None:
        """``"PASS"``, ``"MARGINAL"``, ``"FAIL"``, ``"ERROR"`` or, without limits, ``None``."""
        return worst(one.verdict for one in self.tested)

    @property
    def not_tested(self) -> list[str]:
        """Which limits are set that nothing was tested against, and why; one sentence each kind."""
        measured, gives = {one.quantity.limit_name for one in self.result.measured}, self.kind.gives
        limits = [name for name in self.settings.limits.model_dump(exclude_none=True) if name not in measured]
        others = [f"limits.{name}" for name in limits if name not in gives]
        said = [f"limits.{name} is not tested: this run gives no such number" for name in limits if name in gives]
        if others and gives:
            verb = "is" if len(others) == 1 else "are"
            said.append(
                f"{', '.join(others)} {verb} not tested by `{self.kind.command}`, which gives {', '.join(gives)}"
            )
        return said

    @property
    def heading(self) -> str:
        """What was measured, and of which gyro."""
        return f"{self.kind.title}: {self.settings.gyro.name}"

    def document(self) -> dict[str, Any]:
        """Return everything as one JSON document, without report and error."""
        facts = self.run.facts
        document: dict[str, Any] = {
            "schema": {"name": f"gyrolock {self.kind.name}", "version": SCHEMA_VERSION},
            "command": self.kind.name,
            "gyro": self.settings.gyro.name,
            "simulated": facts.simulated,
            **self.result.document,
            "flags": self.result.flags,
            **standing_document(self.result),
            "limits": [one.as_json() for one in self.tested],
            "verdict": self.verdict,
            **about_run(self.run),
        }
        if self.run.damaged:
            document["damaged"] = self.run.damaged
        if self.run.excluded:
            document["excluded"] = self.run.excluded
        if facts.truth is not None:
            document["truth"] = facts.truth
        return dict(plain(document))

    def sections(self) -> list[Section]:
        """Return figures and tables of the report; nothing that is drawn ends a command."""
        try:
            return self.kind.sections(self.found, self.run, self.settings, self.result)
        except Exception as error:
            why = f"the pictures cannot be drawn ({type(error).__name__}: {one_line(error)}): a defect of gyrolock"
            remark(f"{self.run.path}: {why}")
            return [Section("Pictures", text=f"{why[0].upper()}{why[1:]}.")]

    def fact_tables(self) -> list[FactTable]:
        """Return settings and conditions, for the end of the report."""
        return self.kind.facts(self.found, self.run, self.settings)

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield one plain JSON object for each record; the whole document where there is none."""
        none = True
        for row in self.kind.rows(self.found):
            none = False
            yield {"run": str(self.run.path), **dict(plain(row))}
        if none:
            yield self.document()


def standing_document(result: Result) -> dict[str, Any]:
    """Return for the JSON whether a result holds, and what speaks against it."""
    return {"standing": result.standing.state, "standing_reasons": list(result.standing.reasons)}


def about_run(run: SavedRun) -> dict[str, Any]:
    """Return what the JSON of every run says of it, whatever was measured."""
    facts = run.facts
    identity, made = facts.get("identity") or {}, facts.get("provenance") or {}
    return {
        "unit": facts.labels.get("unit"),
        "operator": facts.labels.get("operator"),
        "note": facts.labels.get("note"),
        "started_at": facts.started_at or None,
        "ended_at": facts.ended_at,
        "resumed_at": list(facts.resumed_at),
        "outcome": facts.outcome_text,
        "instrument": {name: identity.get(name) for name in ("model", "serial", "firmware")} if identity else None,
        "software": {name: made.get(name) for name in ("gyrolock", "git", "python")} if made else None,
        **({} if facts.link_faults is None else {"link": asdict(facts.link_faults)}),
        "run": str(run.path),
    }


def evaluate_run(
    run: SavedRun,
    workers: Workers | None = None,
    progress: Progress | None = None,
    *,
    config: Path | None = None,
    choices: Mapping[str, Any] | None = None,
) -> Evaluated:
    """Evaluate a run by the measurement that it is of."""
    kind, settings, wanted = _how(run, config, choices or {})
    if not kind.streams:
        run = whole(source_of(run))
    reason, workers, progress = "", workers or ThisProcess(), progress or Progress()
    for taken in (run, run.whole) if run.damaged and not kind.streams else (run,):
        try:
            found = kind.evaluate(taken, settings, wanted, workers, progress)
            if isinstance(run.records, SavedRecords):  # only now all of them were seen
                taken = replace(taken, damaged=(*kind.damage(found), *taken.damaged))
            result = kind.result(found, taken, settings)
            limits = limits_in(settings.limits.model_dump(), result)
            tested = judged(result, result.document, limits)
            return Evaluated(kind, taken, settings, found, result, tested)
        except DAMAGE as error:
            if run.protected and not run.damaged:
                raise
            reason = f"{type(error).__name__}: {error}"
    raise RunError(f"{run.path}: is damaged and cannot be evaluated ({reason})")


def evaluate_saved(
    path: Path | Source,
    workers: Workers,
    progress: Progress,
    *,
    config: Path | None,
    choices: Mapping[str, Any],
    exclude: Sequence[range] = (),
) -> Evaluated:
    """Evaluate a run by its path, or in a data set; a long one piece by piece, which saves memory."""
    run = read_as_needed(open_source(path))
    if exclude:
        records = whole(source_of(run)).records
        out = {one.number for one in records if any(one.number in numbers for numbers in exclude)}
        if not out:
            raise UsageError(f"{path}: --exclude names none of its {len(records)} records")
        kept = tuple(one for one in records if one.number not in out)
        run = replace(run, records=kept, excluded=tuple(sorted(out)))
        remark(f"{path}: {len(out)} of {len(records)} records left out as asked")
    return evaluate_run(run, workers, progress, config=config, choices=choices)


def _how(
    run: SavedRun, config: Path | None, choices: Mapping[str, Any]
) -> tuple[Measurement[Any, Any], Any, dict[str, Any]]:
    """Measurement, settings and choices by which a run is evaluated."""
    kind = kind_of(run)
    for name in ("command", "settings"):
        if name in run.unusable:
            raise RunError(f"{run.path}: is damaged: its {name} {run.unusable[name]}")
    settings = saved_settings(kind.kind, run.facts.settings, str(run.path))
    if config is not None:
        settings = kind.kind.with_knowledge(settings, config)
    wanted = {name: value for name, value in choices.items() if value is not None}
    for name in wanted:
        if name not in kind.choices:
            option = name.replace("_", "-")
            raise UsageError(f"{run.path}: is a run of `{kind.command}`, for which --{option} means nothing")
    return kind, settings, wanted


def kind_of(run: SavedRun) -> Measurement[Any, Any]:
    """Return the measurement that a run is of; RunError if this version does not know it."""
    name = run.facts.command
    if name not in MEASUREMENTS:
        raise RunError(
            f"{run.path}: is a run of {name!r}, which this gyrolock does not know "
            f"(it knows {', '.join(MEASUREMENTS)}): update it"
        )
    return measurement(name)


# --------------------
# How every command that has a run ends: evaluated, reported, saved, printed, exit code


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

    run, failure = run_as_it_ends(taken) if not saved else taken.run(), taken.failure
    document: dict[str, Any] = {"command": run.facts.command, **about_run(run)}
    verdict: Verdict | None = None
    lost, unfinished = None, None
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
        if run.records:
            say(f"saved   {run.path}{' and report.html' if 'report' in document else ''}")
        if run.facts.link_faults is not None and not run.facts.link_faults.clean:
            say(f"link    {run.facts.link_faults}")
    if lost is not None and lost is not failure:
        print_failure(lost)
    if failure is None:
        return exit_code_of(verdict)
    print_failure(failure if taken.failure is None else taken.to_tell)
    return failure.exit_code


def run_as_it_ends(taken: Taken) -> SavedRun:
    """Return a run that was just taken with the outcome that it has when its result and its report are there."""
    from station.runs.database import COMPLETE

    return taken.run(COMPLETE if taken.failure is None else taken.failure.as_json())


def keep(evaluated: Evaluated, *, report: bool) -> tuple[dict[str, Any], Failure | None]:
    """Save the result beside its records, and then write the report if it is wanted."""
    from station.report.show import write_report

    document, path = evaluated.document(), evaluated.run.path
    told, lost = dict(document), _saved(path, document)
    if report:
        try:
            told["report"] = str(write_report(evaluated))
        except OSError as error:
            reason = f"the report cannot be written ({error.strerror or one_line(error)})"
            text = f"{path.parent}: {reason}: `gyrolock report {path.parent}` makes it again"
            lost = lost or Failure(CannotWrite.kind, text, EXIT_OUTPUT)
            document["outcome"] = told["outcome"] = text
            _saved(path, document)
    return told, lost


def _saved(path: Path, document: dict[str, Any]) -> Failure | None:
    """Save a result beside its records; what kept it from that."""
    from station.runs.database import save_result

    try:
        save_result(path, document)
    except RunError as error:
        return describe_failure(error)
    return None


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
        measured=[{"name": one.quantity.limit_name, "of": one.of, "value": one.value} for one in result.measured],
    )


def save_outcome(run: SavedRun, failure: Failure | None) -> Failure | None:
    """Save how a run has ended, when everything that belongs to it is there; returns what kept it from that."""
    from station.runs.database import COMPLETE
    from station.runs.store import RunWriter

    try:
        with RunWriter(run.path) as writer:
            writer.save_facts({"outcome": COMPLETE if failure is None else failure.as_json()})
    except RunError as error:
        return describe_failure(error)
    return None


def show(evaluated: Evaluated, *, words: bool) -> None:
    """Print a result in words, and what is left out or damaged on stderr."""
    from station.report.show import print_result

    if words:
        print_result(evaluated)
    for sentence in (*(one.sentence for one in evaluated.result.left_out), *evaluated.not_tested):
        remark(sentence)
    tell_damage(evaluated.run)


def tell_damage(run: SavedRun) -> None:
    """Print what of a run is not what was once saved, on stderr."""
    for sentence in run.damaged:
        remark(f"{run.path}: {sentence}")


# --------------------
# One run of a measurement from beginning to end: new, made of files, or gone on with


def start_run(
    kind: Measurement[Any, Any],
    settings: Any,
    progress: Progress,
    *,
    labels: Mapping[str, str] | None = None,
    paths: Sequence[Path] = (),
    known: Mapping[str, object] | None = None,
    acknowledge: Acknowledge | None = None,
) -> Taken:
    """Take a new run on the bench, or make it of files."""
    simulated = kind.simulated(settings) and not paths
    facts = facts_of(kind.name, settings.model_dump(mode="json"), simulated=simulated, labels=labels)
    facts |= known or {}
    directory, see = Path(settings.output.directory), _see(kind, settings, progress)
    session = Acquisition(facts, directory, progress, acknowledge=acknowledge, see=see)
    if not paths:
        return take(session, lambda of: kind.take(settings, of))
    make = kind.take_files
    if make is None:
        raise UsageError(f"`{kind.command}` makes no run of files: `gyrolock analyze` reads them")
    return take(session, lambda of: make(settings, paths, of))


def resume_run(
    path: Path,
    progress: Progress,
    *,
    kind: Measurement[Any, Any],
    config: Path | None = None,
    overrides: Values | None = None,
    labels: Mapping[str, str] | None = None,
    acknowledge: Acknowledge | None = None,
) -> Taken:
    """Go on with a run that was cut short, with the settings that are saved with it."""
    run = open_run(path)
    check_kind(run, kind)
    if run.facts.sources:
        raise UsageError(f"{path}: was made of saved files, there is nothing to go on with")
    saved = saved_settings(kind.kind, run.facts.settings, str(run.path))
    settings = settings_to_resume(kind.kind, saved, config, overrides, path)
    if lost := [name for name in ("settings", SUMS) if name in run.unusable]:
        raise RunError(f"{path}: cannot be gone on with: its {lost[0]} {run.unusable[lost[0]]}")
    damaged = {record.key: "it is damaged" for record in run.records if not (record.intact or record.aside)}
    again = {**damaged, **kind.unusable(run, settings)}
    if run.facts.complete and not again:
        raise UsageError(
            f"{path}: is finished, there is nothing to go on with; `gyrolock analyze {path}` reads it"
        )

    facts = {**run.facts, **(labels or {}), "settings": settings.model_dump(mode="json")}
    see = _see(kind, settings, progress)
    session = Acquisition(
        facts, run.path.parent, progress, resumed=run, again=again, acknowledge=acknowledge, see=see
    )
    return take(session, lambda of: kind.take(settings, of))


def _see(kind: Measurement[Any, Any], settings: Any, progress: Progress) -> See | None:
    """What fits records as they come; nothing where nobody wants to see them."""
    return None if kind.watch is None or not progress.events.wants_values else kind.watch(settings)


def saved_run(path: Path, kind: Measurement[Any, Any]) -> Taken:
    """Return a saved run of one measurement as if it had just been taken; UsageError if it is another's."""
    run = open_run(path)
    check_kind(run, kind)
    return Taken(run.path, None)


def check_kind(run: SavedRun, kind: Measurement[Any, Any]) -> None:
    """See that a run is of one measurement; UsageError names the other."""
    if (name := run.facts.command) != kind.name:
        typed = measurement(name).command if name in MEASUREMENTS else name
        raise UsageError(f"{run.path}: is a run of `{typed}`, not of `{kind.command}`")
