"""`python -m benchmarks.soak`: a month of records over a bad link, on a clock that jumps instead of waiting.

A station takes one run a day on a serial line. One message in a hundred is spoiled, in every way that the
simulated scope knows; every twentieth hour it is switched off and on, its cable is pulled, or the program is
killed, and the run is gone on with. Every saved record is compared with what the scope showed, and every
acquisition may be saved once.

With `--station` a campaign instead: two units a day, one good and one bad, in this process, whose memory is
weighed.
"""

from __future__ import annotations

import argparse
import gc
import io
import os
import resource
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path

from benchmarks.faults import counts
from benchmarks.links.recording_scope import RecordingScope
from instrument import ATTEMPTS, RECONNECT_FOR, TDS2014, InstrumentError, Persistence, Preamble
from instrument.simulated import Fault, Faults, VirtualClock, resource_manager
from instrument.simulated.faults import FaultKind
from station.cli import main as gyrolock
from station.errors import EXIT_FAIL, EXIT_OK
from station.files import given_back
from station.live.events import Progress
from station.lock_in.served import at_slow_rate
from station.lock_in.settings import Settings, default_settings
from station.lock_in.take import take_on
from station.ring_laser.instruments import build_instruments
from station.ring_laser.records import Bench
from station.runs.acquisition import Acquisition, Taken, facts_of, take
from station.runs.database import TAKEN
from station.runs.store import SavedRun, open_run

RECORDS, DAYS = 100_000, 30
SHARE = 0.01
DAY, HOUR = 86_400.0, 3600.0
INCIDENT_EVERY = 20 * HOUR
OFF_FOR, PULLED_FOR = 20.0, 60.0
RESOURCE = "ASRL1::INSTR"
BAUD_RATE = 19_200
KINDS: tuple[FaultKind, ...] = (
    "late answer",
    "lost byte",
    "inserted byte",
    "changed byte",
    "repeated answer",
    "lost message",
    "cut answer",
    "wrong block length",
    "garbage",
    "lost answer",
    "link closed",
    "power cycle",
    "knob turned",
    "parity error",
    "framing error",
    "input overrun",
)
INCIDENTS = ("power cycle", "cable pulled", "killed")


class Killed(BaseException):
    """The program ends here as by kill -9: nothing is put back, nothing is closed."""


class Agenda(VirtualClock):
    """A virtual clock at which things happen."""

    def __init__(self) -> None:
        super().__init__()
        self._due: list[tuple[float, Callable[[], None]]] = []

    def at(self, moment: float, event: Callable[[], None]) -> None:
        """Let something happen at a time in s."""
        self._due.append((moment, event))
        self._due.sort(key=lambda one: one[0])

    def sleep(self, seconds: float) -> None:
        """Move on, and let happen what is due on the way."""
        until = self.now() + max(0.0, seconds)
        while self._due and self._due[0][0] <= until:
            moment, event = self._due.pop(0)
            super().sleep(moment - self.now())
            event()
        super().sleep(until - self.now())


@dataclass
class Outcome:
    """What became of the month."""

    records: int = 0
    wrong: int = 0
    saved_twice: int = 0
    lost: int = 0
    resumed: int = 0
    panels_altered: int = 0
    panels_by_hand: int = 0
    link: Counter[str] = field(default_factory=Counter)
    faults: Counter[str] = field(default_factory=Counter)
    incidents: Counter[str] = field(default_factory=Counter)
    memory_mb: list[float] = field(default_factory=list)
    descriptors: list[int] = field(default_factory=list)
    threads: list[int] = field(default_factory=list)

    @property
    def good(self) -> bool:
        """Nothing wrong, nothing lost, nothing that grows."""
        return not (self.wrong or self.saved_twice or self.lost or self.panels_altered) and self.flat

    @property
    def flat(self) -> bool:
        """Whether descriptors, threads and memory stay the same after a tenth of the days, one at least."""
        first = max(len(self.memory_mb) // 10, 1)
        grown = self.memory_mb[-1] - self.memory_mb[first]
        counts = (self.descriptors, self.threads)
        return grown < 2.0 and all(max(found[first:]) <= found[first] + 2 for found in counts)


class Pacing(Progress):
    """Lets the time between two records pass, and the incidents come."""

    def __init__(self, clock: Agenda, pause: float, incident: Callable[[], None]) -> None:
        super().__init__()
        self._clock, self._pause, self._incident = clock, pause, incident
        self.saved = 0

    def advance(self) -> None:
        """One record is on the disk."""
        super().advance()
        self.saved += 1
        self._clock.sleep(self._pause)
        self._incident()


class Station:
    """The bench and the program that measures on it, day after day.

    Parameters
    ----------
    directory : Path
        For the runs.
    a_day : int
        Records of one run.
    days : int
        How many runs.
    """

    def __init__(self, directory: Path, a_day: int, days: int, *, seed: int) -> None:
        self.outcome = Outcome()
        self._directory, self._days = directory, days
        self._settings = _settings(directory, a_day)
        self._clock = Agenda()
        scope = build_instruments(self._settings, self._clock).scope
        self._scope = RecordingScope.watch(scope)
        share = SHARE / len(KINDS)
        faults = (Fault(kind, probability=share, seconds=30.0, command="CH1:POSITION 0.4") for kind in KINDS)
        self._scope.faults = self._scope.acquisition.faults = Faults(*faults, seed=seed)
        for _ in scope.execute(f":RS232:BAUD {BAUD_RATE}".encode()):
            pass
        self._manager = resource_manager(scopes={RESOURCE: self._scope})
        self._incidents = cycle(INCIDENTS)
        self._next_incident = INCIDENT_EVERY
        self._pause = DAY / a_day

    def month(self, tell: Callable[[str], None]) -> Outcome:
        """Take a run a day; returns what became of them."""
        for day in range(1, self._days + 1):
            before, hands = self._panel(), self._scope.hands
            run = self._day()
            self._judge(run)
            # A hand at a panel that is not locked: before the panel was read, or after it was put back.
            by_hand = self._scope.hands > hands
            self.outcome.panels_by_hand += by_hand and self._panel() != before
            self.outcome.panels_altered += not by_hand and self._panel() != before
            self._weigh()
            tell(
                f"day {day}: {self.outcome.records} records, {self.outcome.wrong} wrong, "
                f"{self.outcome.lost} lost, {self.outcome.memory_mb[-1]:.0f} MB"
            )
        self.outcome.faults.update(fault.kind for fault in self._scope.faults.happened)
        self._manager.close()
        return self.outcome

    def _day(self) -> SavedRun:
        """One run to its end, however often it has to be gone on with."""
        run: SavedRun | None = None
        while run is None or run.facts.get("outcome") != TAKEN:
            with suppress(Killed):
                self._take(run)
            found = sorted(self._directory.glob("*/run.sqlite"))
            if not found:
                continue
            run = None
            gc.collect()  # what a killed program held is gone with it
            run = open_run(found[-1])
            self.outcome.resumed += run.facts.get("outcome") != TAKEN
        return run

    def _take(self, resumed: SavedRun | None) -> Taken:
        facts = (
            resumed.facts
            if resumed
            else facts_of("measure", self._settings.model_dump(mode="json"), simulated=True)
        )
        progress = Pacing(self._clock, self._pause, self._incident)
        session = Acquisition(facts, self._directory, progress, resumed=resumed)
        return take(session, lambda session: take_on(self._bench(session), self._settings, session))

    def _bench(self, session: Acquisition) -> Bench:
        scope = session.open(self._open(session))
        session.watch(scope)
        return Bench(scope, None, self._clock.sleep)

    @contextmanager
    def _open(self, session: Acquisition) -> Iterator[TDS2014]:
        persistence = Persistence(ATTEMPTS, RECONNECT_FOR, clock=self._clock)
        scope = TDS2014(RESOURCE, resource_manager=self._manager, baud_rate=BAUD_RATE, persistence=persistence)
        if session.panel_to_put_back is not None:
            scope.put_back_in_the_end(session.panel_to_put_back)
        try:
            yield scope
        except Killed:
            scope.abandon()
            raise
        except BaseException as error:
            with suppress(InstrumentError):
                scope.__exit__(type(error), error, None)
            raise
        scope.close()

    def _incident(self) -> None:
        """Every twentieth hour, one after the other."""
        if self._clock.now() < self._next_incident:
            return
        self._next_incident += INCIDENT_EVERY
        kind, now, faults = next(self._incidents), self._clock.now(), self._scope.faults
        self.outcome.incidents[kind] += 1
        if kind == "power cycle":
            self._scope.power_off()
            self._clock.at(now + OFF_FOR, self._scope.power_on)
        elif kind == "cable pulled":
            faults.unplugged = True
            self._clock.at(now + PULLED_FOR, lambda: setattr(faults, "unplugged", False))
        else:
            raise Killed

    def _judge(self, run: SavedRun) -> None:
        """Compare what is saved with what was shown."""
        records = run.taken_for("measure")
        numbers = []
        for record in records:
            preamble = Preamble.parse(record.preamble)
            number = self._scope.acquisition_of(record.payload, preamble.ymult, preamble.xincr)
            self.outcome.wrong += number is None or not record.intact
            numbers.append(number)
        self.outcome.records += len(records)
        self.outcome.saved_twice += len(numbers) - len(set(numbers))
        self.outcome.lost += self._settings.measurement.records - len(records)
        self.outcome.link.update(run.facts["link"])
        self._scope.forget()
        for path in run.path.parent.iterdir():
            path.unlink()
        run.path.parent.rmdir()

    def _panel(self) -> bytes:
        """All settings, asked for at the scope itself."""
        with self._scope.lock:
            return b"".join(answer or b"" for answer in self._scope.execute(b":HEADER ON;:SET?"))

    def _weigh(self) -> None:
        memory, descriptors = _weighed()
        self.outcome.memory_mb.append(memory)
        self.outcome.descriptors.append(descriptors)
        self.outcome.threads.append(threading.active_count())


def _settings(directory: Path, records: int) -> Settings:
    default = at_slow_rate(default_settings("simulated"))
    measurement = default.measurement.model_copy(update={"records": records})
    output = default.output.model_copy(update={"directory": str(directory)})
    return default.model_copy(update={"measurement": measurement, "output": output})


def _weighed() -> tuple[float, int]:
    """Memory of this process in MB without what is free, and how many files it has open."""
    gc.collect()
    folder = Path("/proc/self/fd")
    with given_back():
        return _resident_mb(), len(os.listdir(folder)) if folder.exists() else 0


def _resident_mb() -> float:
    """Memory of this process in MB; its greatest so far where the system does not tell the present one."""
    with suppress(OSError, ValueError):
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * resource.getpagesize() / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def soak(records: int, days: int, *, seed: int = 5, tell: Callable[[str], None] = lambda _: None) -> Outcome:
    """Take `records` in `days` simulated days."""
    # In memory where the system has such a folder: what the disk does is not the question here.
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as folder:
        return Station(Path(folder), max(1, records // days), days, seed=seed).month(tell)


def station(days: int, tell: Callable[[str], None]) -> int:
    """Test two units a day by the example of a campaign; 0 if memory is flat after the first day."""
    weighed: list[tuple[float, int]] = []
    with tempfile.TemporaryDirectory() as folder, chdir(folder), redirect_stdout(io.StringIO()) as out:
        if gyrolock(["settings", "campaign"]):
            raise RuntimeError("no example of a campaign")
        Path("campaign.toml").write_text(out.getvalue(), encoding="utf-8")
        for day in range(1, days + 1):
            for unit, expected in (("RLG-001", EXIT_OK), ("RLG-003", EXIT_FAIL)):
                with redirect_stderr(io.StringIO()):
                    code = gyrolock(["station", "campaign.toml", "--unit", unit, "--quiet"])
                if code != expected:
                    raise RuntimeError(f"day {day}: {unit} ended with {code}")
            weighed.append(_weighed())
            tell(f"day {day}: {weighed[-1][0]:.1f} MB")
    (first, opened), (last, left) = weighed[0], weighed[-1]
    most = max(memory for memory, _ in weighed[1:]) if days > 1 else first
    sys.stdout.write(
        f"{2 * days} tests of a station in one process, {days} days\nmemory {first:.1f} MB after the first day, "
        f"{last:.1f} MB after the last, {most:.1f} MB at most between; descriptors {opened} and {left}\n"
    )
    return 0 if most < first + 2.0 and left <= opened + 2 else 1


def main(arguments: list[str] | None = None) -> int:
    """Run, print what became of the records, and return 0 if none was wrong or lost and nothing grew."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description=__doc__)
    parser.add_argument("--records", type=int, default=RECORDS, help=f"default {RECORDS}")
    parser.add_argument("--days", type=int, default=DAYS, help=f"simulated days, one run each; default {DAYS}")
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--station", action="store_true", help="two tests a day in this process")
    options = parser.parse_args(arguments)
    began = time.perf_counter()

    def tell(text: str) -> None:
        sys.stderr.write(f"{text}, {time.perf_counter() - began:.0f} s\n")

    if options.station:
        return station(options.days, tell)
    outcome = soak(options.records, options.days, seed=options.seed, tell=tell)
    memory = outcome.memory_mb
    lines = [
        f"{outcome.records} records in {options.days} simulated days, {SHARE:.0%} of all messages spoiled",
        f"{outcome.wrong} wrong, {outcome.lost} lost, {outcome.saved_twice} saved twice, "
        f"{outcome.panels_altered} front panels left altered, {outcome.panels_by_hand} by a hand on a knob",
        f"{outcome.faults.total()} faults: {counts(outcome.faults)}",
        f"{outcome.incidents.total()} incidents: {counts(outcome.incidents)}; {outcome.resumed} times resumed",
        f"link: {counts(outcome.link)}",
        f"memory {memory[0]:.0f} MB after the first day, {memory[-1]:.0f} MB after the last; "
        f"descriptors {outcome.descriptors[0]} and {outcome.descriptors[-1]}, "
        f"threads {outcome.threads[0]} and {outcome.threads[-1]}",
        f"{time.perf_counter() - began:.1f} s in all",
    ]
    sys.stdout.write("\n".join(lines) + "\n")
    return 0 if outcome.good else 1


if __name__ == "__main__":
    sys.exit(main())
