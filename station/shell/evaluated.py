"""A saved run and what it says: evaluated by the measurement that it is of, judged by its limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from station.datasets.reading import run_of
from station.errors import RunError, UsageError
from station.measurements import MEASUREMENTS, Measurement, measurement
from station.results.as_json import plain
from station.results.limits import Tested, check_limits, verdict
from station.results.parts import FactTable, Section
from station.results.result import Result
from station.runs.progress import Progress
from station.runs.store import SavedRun, open_run
from station.settings.load import saved_settings
from station.sources.find import open_source
from station.sources.run import SavedRecords
from station.sources.source import Source
from station.sources.workers import Workers

SCHEMA_VERSION = 2
DAMAGE = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
"""What values raise that no run ever holds."""


@dataclass(frozen=True)
class Evaluated:
    """A run and what it says."""

    kind: Measurement[Any, Any]
    run: SavedRun
    settings: Any  # those of the run, with what is known of the bench now where that was given
    found: Any  # what the measurement computed
    result: Result
    tested: tuple[Tested, ...]

    @property
    def verdict(self) -> str | None:
        """``"PASS"``, ``"FAIL"`` or, without limits, ``None``."""
        return verdict(self.tested)

    @property
    def not_tested(self) -> list[str]:
        """Which limits are set that nothing was tested against, and why; one sentence each kind."""
        measured, gives = {one.name for one in self.result.measured}, self.kind.gives
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
        if facts.truth is not None:
            document["truth"] = facts.truth
        return dict(plain(document))

    def sections(self) -> list[Section]:
        """Return figures and tables of the report."""
        return self.kind.sections(self.found, self.run, self.settings, self.result)

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
    run: SavedRun, *, config: Path | None = None, choices: Mapping[str, Any] | None = None
) -> Evaluated:
    """Evaluate a run by the measurement that it is of."""
    kind, settings, wanted = _how(run, config, choices or {})
    run, found, result = _evaluated(kind, run, settings, wanted)
    return _judged(kind, run, settings, found, result)


def evaluate_saved(
    path: Path | Source, workers: Workers, progress: Progress, *, config: Path | None, choices: Mapping[str, Any]
) -> Evaluated:
    """Evaluate a run by its path, or in a data set: in batches where its measurement can, which saves memory.

    Parameters and errors as for :func:`evaluate_run`.
    """
    source = open_source(path)
    run = SavedRun(
        source.path, source.facts, SavedRecords(source), None, source.unusable, source.protected, source.damaged
    )
    kind, settings, wanted = _how(run, config, choices)
    if kind.evaluate_source is None:
        return evaluate_run(_whole(source), config=config, choices=choices)
    try:
        evaluated = kind.evaluate_source(source, settings, wanted, workers, progress)
        if evaluated is None:
            return evaluate_run(_whole(source), config=config, choices=choices)
        found, damage = evaluated
        run = replace(run, damaged=(*damage, *source.damaged))
        return _judged(kind, run, settings, found, kind.result(found, run, settings))
    except DAMAGE as error:
        if source.protected and not run.damaged:
            raise
        raise RunError(
            f"{run.path}: is damaged and cannot be evaluated ({type(error).__name__}: {error})"
        ) from error


def _whole(source: Source) -> SavedRun:
    """The run with all its records in memory."""
    return open_run(source.path) if source.kind == "run" else run_of(source)


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


def _judged(kind: Measurement[Any, Any], run: SavedRun, settings: Any, found: Any, result: Result) -> Evaluated:
    limits = settings.limits.model_dump()
    return Evaluated(kind, run, settings, found, result, check_limits(result.measured, limits))


def _evaluated(
    kind: Measurement[Any, Any], run: SavedRun, settings: Any, choices: Mapping[str, Any]
) -> tuple[SavedRun, Any, Result]:
    """Evaluate a run; one that is damaged without what is damaged, where it cannot be evaluated with it."""
    for taken in (run, run.whole) if run.damaged else (run,):
        try:
            found = kind.evaluate(taken, settings, choices)
            return taken, found, kind.result(found, taken, settings)
        except DAMAGE as error:
            if run.protected and not run.damaged:
                raise
            reason = f"{type(error).__name__}: {error}"
    raise RunError(f"{run.path}: is damaged and cannot be evaluated ({reason})")


def kind_of(run: SavedRun) -> Measurement[Any, Any]:
    """Return the measurement that a run is of; RunError if this version does not know it."""
    name = run.facts.command
    if name not in MEASUREMENTS:
        raise RunError(
            f"{run.path}: is a run of {name!r}, which this gyrolock does not know "
            f"(it knows {', '.join(MEASUREMENTS)}): update it"
        )
    return measurement(name)
