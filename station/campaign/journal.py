"""The journal of a unit's test, on the disk before the next step begins; plan and outcome that it tells.

A line that a power failure has cut is passed over: what it told is done again.
"""

from __future__ import annotations

import json
import logging
import logging.handlers
import math
import os
import re
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from datetime import date
from pathlib import Path
from typing import Any, Self

from pydantic import TypeAdapter

from instrument.claims import lock
from station.errors import (
    EXIT_FAIL,
    EXIT_INTERRUPTED,
    EXIT_MARGINAL,
    EXIT_NO_SIGNAL,
    EXIT_OK,
    CannotWrite,
    Failure,
    RunError,
    UsageError,
)
from station.live.events import Event
from station.results.quantity import Value
from station.results.result import plain
from station.results.verdict import ABORTED, ERROR, FAIL, MARGINAL, Limit, LimitOutcome, Verdict, worst
from station.runs.database import new_run_directory, utc_now
from station.runs.store import open_run

# --------------------
# What a campaign is going to do with a unit: instruments, steps in their order, limits


@dataclass(frozen=True)
class InstrumentCard:
    """An instrument of the bench, as its papers say."""

    role: str  # ``"oscilloscope"``, ``"rate table"``, ``"chamber"``, ..
    model: str = ""  # empty where nobody has stated them
    serial: str = ""
    firmware: str = ""
    calibrated_on: date | None = None  # ``None``: it needs no calibration, or nobody has stated it
    calibration_due: date | None = None


@dataclass(frozen=True)
class PlannedStep:
    """One measurement of a campaign."""

    key: str  # unique in the campaign: ``"2 lock-in, 1 of 3"``
    name: str  # as the campaign calls it; the same for its repeats
    number: int  # place in the sequence, from 1
    measurement: str  # name that the run is marked with: ``"measure"``
    repeat: int  # which of how many, from 1
    of_repeats: int
    settings: Mapping[str, Any]  # complete settings of the measurement, plain JSON
    # what the controllers are set to before it: ``temperature_degc``, ``voltage_v``
    conditions: Mapping[str, float]
    warm_up_s: float  # time that passes before it: with the unit on, and at its conditions
    settle_s: float
    limits: tuple[Limit, ...]
    doubtful: str = "marginal"  # {"marginal", "as_it_is"}: Verdict of a limit on a result that does not stand
    # step before, verdicts of which it must have one, and whether the verdict of this one then counts instead
    only_if: Mapping[str, Any] | None = None

    def is_due(self, done: Iterable[StepOutcome]) -> bool:
        """Whether it is to be taken, by how the step before that it asks for has ended."""
        if self.only_if is None:
            return True
        ended = worst(one.verdict for one in done if one.verdict and one.step.name == self.only_if["step"])
        return ended in self.only_if["verdict"]


@dataclass(frozen=True)
class ReferenceUnit:
    """The unit that tells whether the bench is in control: units are tested only after it."""

    unit: str
    every_h: float


@dataclass(frozen=True)
class CampaignPlan:
    """A campaign as it is carried out with one unit."""

    name: str
    file: Path  # where the campaign was read from
    file_sha256: str  # of its bytes and of those of the files that it names
    settings: Mapping[str, Any]  # the whole campaign with every default, plain JSON
    station: str
    unit: str  # serial number
    unit_type: str  # model of the unit: histories are kept for each
    directory: Path  # where the folders of all tested units lie
    simulated: bool  # whether all of its benches are
    steps: tuple[PlannedStep, ...]
    instruments: tuple[InstrumentCard, ...] = ()
    reference: ReferenceUnit | None = None
    attempts: int = 1  # how often a step that the bench ended is begun or gone on with in all
    retry_after_s: float = 0.0  # time between two attempts
    reports: bool = True  # whether every run gets a report of its own
    # whether chamber and power supply are switched off when the test has ended
    switch_off_afterwards: bool = False
    on_record: str = ""  # command line for the record of the test
    stop_after_failure: bool = False  # leave out what comes behind a step that is FAIL or ERROR
    ask_for_unit: bool = False  # whether an operator is asked to bring the unit before it begins

    @property
    def is_reference(self) -> bool:
        """Whether the unit is the reference unit of the bench."""
        return self.reference is not None and self.reference.unit == self.unit


_PLAN = TypeAdapter(CampaignPlan)

# --------------------
# How the test of a unit has ended: each step, and all of them


@dataclass(frozen=True)
class StepOutcome:
    """How one step has ended."""

    step: PlannedStep
    verdict: Verdict | None  # ``None``: it was measured, and has no limits
    limits: tuple[LimitOutcome, ...] = ()
    document: Mapping[str, Any] = field(default_factory=dict)  # JSON of the result; empty where there is none
    run: Path | None = None  # the run's file
    run_sha256: str = ""  # of that file as the step left it
    failure: Failure | None = None  # what kept it from a result
    # what else is to be known: what was left out, what is doubtful, what was tried again
    remarks: tuple[str, ...] = ()
    started_at: str = ""  # UTC, ISO 8601
    ended_at: str = ""
    elapsed_s: float = 0.0  # by a clock that nobody sets; of one that was gone on with since it was first begun
    attempts: int = 1  # how often it was begun anew
    conditions: Mapping[str, float] = field(default_factory=dict)  # what the controllers showed at its beginning

    @property
    def message(self) -> str:
        """In one line why the verdict is what it is; empty for PASS."""
        if self.failure is not None:
            return self.failure.message
        return "; ".join(one.sentence for one in self.limits if one.verdict == self.verdict != "PASS")


@dataclass(frozen=True)
class CampaignOutcome:
    """How the test of a unit has ended."""

    plan: CampaignPlan
    operator: str
    note: str
    directory: Path  # of this test: runs, log, journal
    started_at: str
    ended_at: str
    steps: tuple[StepOutcome, ...]  # those that were begun, in the order of the plan
    failure: Failure | None = None  # what ended all of it before its time
    resumed_at: tuple[str, ...] = ()  # when it was gone on with, UTC

    @property
    def verdict(self) -> Verdict | None:
        """The worst of all steps; ABORTED where it was ended from outside; ``None`` without limits."""
        if self.failure is not None:
            ended_from_outside = self.failure.exit_code >= EXIT_INTERRUPTED - 1  # by a signal, or Ctrl-C
            return ABORTED if ended_from_outside else ERROR
        return worst(one.verdict for one in self._counted if one.verdict is not None)

    @property
    def _counted(self) -> list[StepOutcome]:
        """Steps whose verdicts count: not those that a later one stands for."""
        asked = [one.step.only_if for one in self.steps if one.step.only_if]
        replaced = {one["step"] for one in asked if one["instead"]}
        return [one for one in self.steps if one.step.name not in replaced]

    @property
    def exit_code(self) -> int:
        """0 PASS or no limits, 1 FAIL, 6 MARGINAL; ERROR and ABORTED have the code of what happened."""
        verdict = self.verdict
        if self.failure is not None:
            return self.failure.exit_code
        if verdict in (ERROR, ABORTED):
            failed = next((one.failure for one in self._counted if one.failure is not None), None)
            return EXIT_NO_SIGNAL if failed is None else failed.exit_code
        return EXIT_FAIL if verdict == FAIL else EXIT_MARGINAL if verdict == MARGINAL else EXIT_OK

    @property
    def message(self) -> str:
        """In one line why the verdict is what it is; empty for PASS."""
        if self.failure is not None:
            return self.failure.message
        said = (
            f"{one.step.name}: {one.message}"
            for one in self._counted
            if one.verdict == self.verdict and one.message
        )
        return next(said, "")


JOURNAL, PAGE_FILE = "test.jsonl", "record.html"
SCHEMA = {"name": "gyrolock test journal", "version": 1}
_UNSAFE = re.compile(r"[^A-Za-z0-9._-]")


@dataclass
class Journal:
    """The journal of one test, open to be written."""

    directory: Path  # of the test
    _descriptor: int = field(default=-1, init=False)

    @classmethod
    def begin(cls, plan: CampaignPlan, operator: str, note: str) -> Self:
        """Make the folder of a new test; RunError if nothing can be written there."""
        journal = cls(new_run_directory(folder_of(plan.directory, plan.unit)))
        journal.open()
        facts = {"plan": _PLAN.dump_python(plan, mode="json"), "operator": operator, "note": note}
        journal.write("begun", schema=SCHEMA, **facts)
        with suppress(OSError):  # a copy for the reader; the plan stands in the journal
            (journal.directory / "campaign.toml").write_bytes(plan.file.read_bytes())
        return journal

    def open(self) -> None:
        """Open it for writing, alone."""
        try:
            flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_CLOEXEC", 0)
            self._descriptor = os.open(self.directory / JOURNAL, flags, 0o644)
        except OSError as error:
            self.close()
            raise CannotWrite(f"{self.directory}: the journal cannot be written ({error.strerror})") from None
        if not lock(self._descriptor):
            self.close()
            raise UsageError(f"{self.directory}: another program carries this test out at the moment")
        size = os.lseek(self._descriptor, 0, os.SEEK_END)
        if size:
            os.lseek(self._descriptor, size - 1, os.SEEK_SET)
            if os.read(self._descriptor, 1) != b"\n":
                os.write(self._descriptor, b"\n")

    def write(self, kind: str, **facts: object) -> None:
        """Write what has happened; when this returns, it is on the disk. CannotWrite if that takes no more."""
        line = json.dumps({"kind": kind, "at": utc_now(), **plain(facts)}, allow_nan=False).encode() + b"\n"
        try:
            while line:
                line = line[os.write(self._descriptor, line) :]
            os.fsync(self._descriptor)
        except OSError as error:
            raise CannotWrite(f"{self.directory}: the journal cannot be written ({error.strerror})") from None

    def close(self) -> None:
        """Close it; a second call does nothing."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def folder_of(directory: Path, unit: str) -> Path:
    """Return where the tests of a unit lie; a serial number with other letters than files have gets a sum."""
    safe = _UNSAFE.sub("_", unit).strip(".") or "unit"
    return directory / (safe if safe == unit else f"{safe}_{zlib.crc32(unit.encode()):08x}")


def tests_of(directory: Path, unit: str) -> list[Path]:
    """Return the folders of all tests of a unit, the oldest first by their names."""
    folder = folder_of(directory, unit)
    return sorted(path.parent for path in folder.glob(f"*/{JOURNAL}"))


def test_to_resume(directory: Path, unit: str, named: str) -> Path:
    """Return a test by its folder, by the beginning of its name, or (empty) the one that is unfinished."""
    if named and os.path.exists(named):
        return Path(named)
    found = [path for path in tests_of(directory, unit) if path.name.startswith("" if named == "last" else named)]
    if named:
        if not found or (len(found) > 1 and named != "last"):
            where = folder_of(directory, unit)
            raise UsageError(f"{named}: {len(found) or 'no'} tests of {unit} in {where} are named so")
        return found[-1]
    left = [path for path in found if read_journal(path).is_unfinished]
    if not left:
        raise UsageError(f"{folder_of(directory, unit)}: no test of {unit} is to be gone on with")
    if len(left) > 1:
        named = ", ".join(str(path) for path in left)
        raise UsageError(
            f"several tests of {unit} have not come to their end: name one with --resume DIR: {named}"
        )
    return left[0]


@dataclass(frozen=True)
class Written:
    """What a journal says."""

    directory: Path
    plan: CampaignPlan
    operator: str
    note: str
    started_at: str
    resumed_at: tuple[str, ...]
    ended_at: str  # empty where the program was killed
    failure: Failure | None  # what ended the last session before its time
    steps: Mapping[str, StepOutcome]  # steps that have ended, by key; of one that was done again the last
    begun: Mapping[str, tuple[str, ...]]  # when each step was begun, by key: again in each session

    @property
    def is_unfinished(self) -> bool:
        """Whether a step is left, or the record, whose last file is the page."""
        return bool(self.left) or not (self.directory / PAGE_FILE).exists()

    @property
    def left(self) -> tuple[PlannedStep, ...]:
        """Steps that are to be taken, or to be gone on with because the bench has failed them."""
        failed = any(one.verdict in (FAIL, ERROR) and not to_repeat(one) for one in self.steps.values())
        stopped = self.plan.stop_after_failure and failed
        steps = [step for step in self.plan.steps if not (stopped and step.only_if is None)]
        due = (step for step in steps if step.is_due(self.steps.values()))
        return tuple(step for step in due if (one := self.steps.get(step.key)) is None or to_repeat(one))

    def outcome(self) -> CampaignOutcome:
        """Return how the test has ended, as far as it is written."""
        failure = self.failure
        if not self.ended_at:
            failure = Failure("interrupted", "cut short: the program was killed or the power failed", 130)
        steps = tuple(self.steps[step.key] for step in self.plan.steps if step.key in self.steps)
        known = self.plan, self.operator, self.note, self.directory, self.started_at, self.ended_at
        return CampaignOutcome(*known, steps, failure, self.resumed_at)


def to_repeat(outcome: StepOutcome) -> bool:
    """Whether a step is gone on with when its test is: the bench has failed it, not the unit."""
    return outcome.verdict == ERROR and outcome.failure is not None


def read_journal(directory: Path) -> Written:
    """Read the journal of a test from its folder; also of one whose program was killed."""
    path = directory / JOURNAL
    try:
        lines = list(_lines(path.read_text(encoding="utf-8", errors="replace")))
    except OSError as error:
        raise RunError(f"{directory}: holds no test of a unit ({error.strerror})") from None
    try:
        first = next(line for line in lines if line["kind"] == "begun")
        plan = _PLAN.validate_python(first["plan"])
        by_key = {step.key: step for step in plan.steps}
        ended = [line for line in lines if line["kind"] == "step_ended" and line["key"] in by_key]
        steps = {line["key"]: _step_from_json(line, by_key[line["key"]], directory) for line in ended}
        begun: dict[str, tuple[str, ...]] = {}
        for line in lines:
            if line["kind"] == "step_begun":
                begun[line["key"]] = (*begun.get(line["key"], ()), line["at"])
        last = lines[-1]
        over = last["kind"] == "ended"
        failure = Failure(**last["failure"]) if over and last.get("failure") else None
        return Written(
            directory=directory,
            plan=plan,
            operator=first["operator"],
            note=first["note"],
            started_at=first["at"],
            resumed_at=tuple(line["at"] for line in lines if line["kind"] == "resumed"),
            ended_at=last["at"] if over else "",
            failure=failure,
            steps=steps,
            begun=begun,
        )
    except (StopIteration, KeyError, TypeError, ValueError) as error:
        raise RunError(f"{path}: the journal of this test is damaged ({type(error).__name__}: {error})") from None


def _lines(text: str) -> Iterator[dict[str, Any]]:
    for line in text.splitlines():
        try:
            found = json.loads(line)
        except ValueError:
            continue
        if isinstance(found, dict) and isinstance(found.get("kind"), str) and isinstance(found.get("at"), str):
            yield found


def step_as_json(outcome: StepOutcome, directory: Path) -> dict[str, Any]:
    """Return what the journal keeps of a step: everything but the result, which stands in its run."""
    values = {name: getattr(outcome, name) for name in _KEPT}
    return {
        "key": outcome.step.key,
        **values,
        "run": None if outcome.run is None else str(outcome.run.relative_to(directory)),
        "failure": None if outcome.failure is None else outcome.failure.as_json(),
        "limits": [
            {**vars(one), "limit": asdict(one.limit), "measured": one.measured.as_json()} for one in outcome.limits
        ],
    }


_KEPT = ("verdict", "run_sha256", "remarks", "started_at", "ended_at", "elapsed_s", "attempts", "conditions")


def _step_from_json(line: Mapping[str, Any], step: PlannedStep, directory: Path) -> StepOutcome:
    run = None if line["run"] is None else directory / line["run"]
    document: dict[str, Any] = {}
    with suppress(RunError):
        document = (open_run(run).results or {}) if run else {}
    limits = []
    for one in line["limits"]:
        margin, limit = math.nan if one["margin"] is None else one["margin"], Limit(**one["limit"])
        measured = Value.from_json({"name": limit.number, **one["measured"]})
        limits.append(LimitOutcome(**{**one, "limit": limit, "measured": measured, "margin": margin}))
    kept = {name: line[name] for name in _KEPT}
    return StepOutcome(
        step=step,
        **{**kept, "remarks": tuple(kept["remarks"])},
        limits=tuple(limits),
        document=document,
        run=run,
        failure=None if line["failure"] is None else Failure(**line["failure"]),
    )


# --------------------
# The station's log: what happened, in the words of its events, in files that do not grow for ever


FILE = "station.log"
_LARGEST = 1_000_000  # bytes of one file
_LOGS_KEPT = 9  # files before the one that is written
_NOT_TOLD = frozenset({"counted", "record", "value"})


@contextmanager
def station_log(directory: Path) -> Iterator[Callable[[Event], None]]:
    """Open the log of the station, with what the program itself logs; the oldest file goes for a new one."""
    logging.raiseExceptions = False  # a log that cannot be written is not written to stderr either
    handler: logging.Handler
    try:
        directory.mkdir(parents=True, exist_ok=True)
        path = directory / FILE
        handler = logging.handlers.RotatingFileHandler(
            path, maxBytes=_LARGEST, backupCount=_LOGS_KEPT, encoding="utf-8", errors="replace"
        )
    except OSError:
        handler = logging.NullHandler()
    form = logging.Formatter("%(asctime)s.%(msecs)03dZ %(message)s", "%Y-%m-%dT%H:%M:%S")
    form.converter = time.gmtime  # UTC: no hour that comes twice
    handler.setFormatter(form)
    ours = logging.getLogger("station")
    ours.addHandler(handler)

    def write(event: Event) -> None:
        """Write an event; a disk that takes none harms nothing."""
        if event.kind not in _NOT_TOLD:
            told = event.facts.get("text") if event.kind == "note" else json.dumps(dict(event.facts))
            with suppress(OSError, ValueError):
                handler.emit(
                    logging.LogRecord("gyrolock", logging.INFO, "", 0, f"{event.kind}: {told}", None, None)
                )

    try:
        yield write
    finally:
        ours.removeHandler(handler)
        handler.close()
