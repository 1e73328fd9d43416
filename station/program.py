"""A step of a campaign that is a program or a Python function: run once, what it says is kept as a run.

It says its numbers as one JSON object. Each that is declared stands there: alone, or as an object with `value` and
`u`, or `low_95` and `high_95`. The bytes of its answer are the run's record, so the result can be computed again.
"""

import json
import math
import os
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import IO, Annotated, Any

from pydantic import Field

from instrument import InstrumentError
from station.errors import NoUsableSignal, SettingsError
from station.measurements import Measurement
from station.results.quantity import Quantities, Quantity, QuantityGroup
from station.results.result import FactTable, Result, Section, TextTable
from station.runs.acquisition import Acquisition
from station.runs.store import NewRecord, SavedRun
from station.settings import Limits, OutputSettings, Positive, SettingsKind, SettingsSection

_LARGEST = 1_000_000  # bytes of an answer: numbers, not records
_LAST_WORDS_S = 5.0  # for what is in the pipes yet
_PURPOSE = "program"
# what it prints itself is no part of the answer
_CALL = """\
import contextlib, json, runpy, sys
file, name, unit = sys.argv[1:]
sys.path.insert(0, "")
with contextlib.redirect_stdout(sys.stderr):
    found = runpy.run_path(file)[name](unit=unit)
print(json.dumps(found, default=float))
"""


class ProgramSection(SettingsSection):
    """What is run."""

    command: str
    function: str
    timeout_s: Positive
    simulated: bool
    directory: str = ""  # in which it is run: that of the campaign file

    def words(self, unit: str) -> list[str]:
        """The command line, for one unit."""
        if self.function:
            file, _, name = self.function.rpartition(":")
            return [sys.executable, "-c", _CALL, file, name, unit]
        return [word.replace("{unit}", unit) for word in shlex.split(self.command)]

    @property
    def called(self) -> str:
        """What a person calls it."""
        return self.function or self.command


class GyroNameSection(SettingsSection):
    """Of what it is."""

    name: str


class ProgramSettings(SettingsSection):
    """Settings of a step that is a program."""

    gyro: GyroNameSection
    program: ProgramSection
    numbers: dict[Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")], str]
    limits: Limits
    output: OutputSettings


def take(settings: ProgramSettings, session: Acquisition) -> None:
    """Run it, and keep what it says."""
    program, writer = settings.program, session.begin()
    if session.resumed is not None and session.resumed.taken_for(_PURPOSE):
        return  # killed when the answer was on the disk
    session.progress.note(f"running {program.called}")
    try:
        code, answer, said = run_program(program, str(session.facts.get("unit") or ""))
    except subprocess.TimeoutExpired:
        raise InstrumentError(f"{program.called} has not ended after {program.timeout_s:g} s") from None
    except (OSError, ValueError) as error:
        raise InstrumentError(f"{program.called} cannot be run ({error})") from None
    if code:
        raise InstrumentError(f"{program.called} ended with code {code}: {(said or ['it says nothing'])[-1]}")
    for line in said[-20:]:
        session.progress.note(line)
    if len(answer) > _LARGEST:
        raise InstrumentError(f"{program.called} has said more than {_LARGEST} bytes")
    writer.save_records([NewRecord("answer", _PURPOSE, json.dumps({"program": program.called}), answer, {})])


def run_program(program: ProgramSection, unit: str) -> tuple[int, bytes, list[str]]:
    """Its exit code, what it says, and its lines on stderr; no process that it began stays behind."""
    kept = bytearray(), bytearray()

    def keep(stream: IO[bytes], text: bytearray) -> None:
        while piece := stream.read(1 << 16):
            text += piece
            del text[: -_LARGEST - 1]  # one that never stops talking fills no memory

    words, pipe = program.words(unit), subprocess.PIPE
    with subprocess.Popen(
        words, 0, None, subprocess.DEVNULL, pipe, pipe, cwd=program.directory or None, start_new_session=True
    ) as process:
        streams = (stream for stream in (process.stdout, process.stderr) if stream is not None)
        readers = [Thread(target=keep, args=each, daemon=True) for each in zip(streams, kept, strict=True)]
        try:
            for reader in readers:
                reader.start()
            process.wait(program.timeout_s)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL) if os.name == "posix" else process.kill()
            for reader in readers:
                reader.join(_LAST_WORDS_S)
    return process.returncode, bytes(kept[0]), kept[1].decode(errors="replace").strip().splitlines()


def evaluate(run: SavedRun, settings: ProgramSettings, *_: Any) -> dict[str, Any]:
    """Return the declared numbers by the keys that a document has for them."""
    answers, called = run.taken_for(_PURPOSE), settings.program.called
    if not answers:
        raise NoUsableSignal(f"{called} has given no answer")
    try:
        said = json.loads(answers[-1].payload)
        numbers = {name: said[name] for name in settings.numbers}
    except (ValueError, RecursionError):
        raise NoUsableSignal(f"{called} said no JSON object, but {answers[-1].payload[:80]!r}") from None
    except (KeyError, TypeError, IndexError) as error:
        raise NoUsableSignal(f"{called} does not say {error}, which is declared in [numbers]") from None
    found: dict[str, Any] = {"numbers": dict(settings.numbers)}
    for (name, number), quantity in zip(numbers.items(), declared(settings.numbers)[0].quantities, strict=True):
        parts = number if isinstance(number, dict) else {"value": number}
        for what in ("value", "u", "low_95", "high_95"):
            one = parts.get(what)
            known = isinstance(one, int | float) and not isinstance(one, bool) and math.isfinite(one)
            if not known and (what == "value" or one is not None):
                raise NoUsableSignal(f"{called} says {one!r} for the {what} of {name}, which is no number")
            found[quantity.key("" if what == "value" else what)] = one
    return found


def declared(numbers: Mapping[str, str]) -> Quantities:
    """Return the numbers that settings, or a saved result, declare with their units."""
    made = (
        Quantity(name, shown=unit, u=True, limit=True, headline=place == 0, trend=True)
        for place, (name, unit) in enumerate(numbers.items())
    )
    return (QuantityGroup(tuple(made)),)


def result(found: dict[str, Any], run: SavedRun, settings: ProgramSettings) -> Result:
    """Put into words what was said."""
    values = [one.value_in(found) for one in declared(settings.numbers)[0].quantities]
    rows = tuple((one.words, one.text) for one in values)
    name, value = rows[0] if rows else ("answer", "no number is declared")
    return Result(name, value, found, declared(settings.numbers), summary=rows[1:], brief=rows)


def sections(found: dict[str, Any], run: SavedRun, settings: ProgramSettings, result: Result) -> list[Section]:
    """Return the table of its numbers."""
    return [Section("Numbers", table=TextTable(("number", "value, 95 %"), tuple(result.brief)))]


def _check(settings: ProgramSettings, path: Path) -> ProgramSettings:
    program, folder = settings.program, path.absolute().parent
    if bool(program.command.strip()) == bool(program.function):
        raise SettingsError(f"{path}: program: give either command or function")
    file, colon, name = program.function.rpartition(":")
    if program.function and not (colon and name.isidentifier() and (folder / file).is_file()):
        raise SettingsError(f"{path}: program.function: {program.function!r} is no FILE.py:NAME in its folder")
    try:
        first = program.words("")[0]
    except ValueError as error:
        raise SettingsError(f"{path}: program.command: {error}") from None
    if shutil.which(first, path=f"{os.environ.get('PATH', '')}{os.pathsep}{folder}") is None:
        raise SettingsError(f"{path}: program.command: {first!r} is not found on this computer")
    if clash := [name for name in settings.numbers if name.rpartition("_")[2] in ("u", "95") or name == "numbers"]:
        raise SettingsError(f"{path}: numbers.{clash[0]}: is the name of an uncertainty, not of a number")
    return settings.model_copy(update={"program": program.model_copy(update={"directory": str(folder)})})


MEASUREMENT = Measurement(
    name="program",
    command="gyrolock station",
    title="Program",
    kind=SettingsKind(
        sections=ProgramSettings,
        limits=lambda: (),
        shipped=lambda given: "program",
        adapt=lambda values: None,
        check=_check,
        knowledge=(),
    ),
    take=take,
    evaluate=evaluate,
    result=result,
    sections=sections,
    facts=lambda found, run, settings: [FactTable("Program", [("run", settings.program.called)])],
    declared=declared,
    simulated=lambda settings: settings.program.simulated,
)
