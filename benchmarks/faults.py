"""`python -m benchmarks.faults --records N`: records over a link that spoils two answers in a hundred.

Every record must come right or be refused by an exception; a wrong one is a failure of the driver. Virtual time
makes the waiting free. Every acquisition sees another phase of the signal, so that an old record cannot pass
for a new one, and what arrives is compared with what the scope holds.

`python -m benchmarks.faults --runs N --share 0.05`: whole runs of `gyrolock measure` through a proxy that spoils
so many messages each way, in real time.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
import pyvisa

from analysis.arrays import Floats
from benchmarks.links.fault_proxy import FaultProxy
from benchmarks.links.recording_scope import RecordingScope
from instrument import TDS2014, InstrumentError, LinkError, Preamble, Tally, Waveform
from instrument.simulated import Fault, Faults, SimulatedTDS2014, TcpServer, VirtualClock, resource_manager
from instrument.simulated.faults import FaultKind
from station.live.events import Progress
from station.lock_in.served import at_slow_rate
from station.lock_in.settings import default_settings
from station.measurements import measurement
from station.ring_laser.instruments import build_instruments
from station.runs.database import TAKEN
from station.runs.store import open_run
from station.shell.finish import start_run

FAULT_PROBABILITY = 0.02
DEFAULT_RECORDS = 10_000
RECORDS_OF_A_RUN = 200
RESOURCE = "GPIB0::1::INSTR"
KINDS: tuple[FaultKind, ...] = (
    "late answer",
    "lost byte",
    "inserted byte",
    "cut answer",
    "wrong block length",
    "garbage",
    "lost answer",
    "link closed",
    "power cycle",
    "knob turned",
)


@dataclass
class Outcome:
    """What became of the records."""

    right: int = 0
    wrong: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    reconnected: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    longest_refusal: float = 0.0
    """Longest time in s of the scope's clock from asking to the exception."""

    @property
    def records(self) -> int:
        """How many were asked for."""
        return self.right + self.wrong + self.refused.total()


def drifting_sine(times: Floats) -> Floats:
    """A sine whose frequency is no multiple of anything: every record has its own phase."""
    return np.asarray(0.8 * np.sin(2 * np.pi * 997.13 * times))


def random_faults() -> list[Fault]:
    """Faults that together spoil `FAULT_PROBABILITY` of all answers."""
    share = FAULT_PROBABILITY / (len(KINDS) + 1)
    # A late answer comes later than the driver waits for it.
    faults = [Fault(kind, probability=share, seconds=30.0, command="CH1:POSITION 0.4") for kind in KINDS]
    # RUN/STOP ends the single sequence: a record that is there already must not pass for a new one.
    return [*faults, Fault("knob turned", probability=share, command="ACQUIRE:STOPAFTER RUNSTOP;STATE STOP")]


def run(records: int, *, seed: int = 11) -> Outcome:
    """Ask for `records` fresh records; connect again when the link is lost."""
    faults = Faults(*random_faults(), seed=seed)
    clock = VirtualClock()
    scope = SimulatedTDS2014({1: drifting_sine}, clock=clock, seed=seed, faults=faults)
    manager = resource_manager(scopes={RESOURCE: scope})
    outcome = Outcome()
    driver: TDS2014 | None = None
    while outcome.records < records:
        asked, number_before = clock.now(), newest_number(scope)
        try:
            driver = driver or connect(manager)
            waveform = driver.acquire("CH1")
        except InstrumentError as error:
            outcome.refused[type(error).__name__] += 1
            outcome.longest_refusal = max(outcome.longest_refusal, clock.now() - asked)
            if isinstance(error, LinkError):
                abandon(driver)
                driver = None
                outcome.reconnected += 1
        else:
            is_fresh = newest_number(scope) > number_before
            is_right = is_fresh and is_what_the_scope_holds(waveform, scope)
            outcome.right += is_right
            outcome.wrong += not is_right
    faults.clear()
    abandon(driver)
    manager.close()
    outcome.faults.update(fault.kind for fault in faults.happened)
    return outcome


def connect(manager: pyvisa.ResourceManager) -> TDS2014:
    """Open the scope and set it up; the link is closed again if that fails."""
    driver = TDS2014(RESOURCE, resource_manager=manager)
    try:
        driver.set_channel("CH1", probe=1, scale=0.5)
        driver.set_timebase(2.5e-4)
    except InstrumentError:
        abandon(driver)
        raise
    return driver


def abandon(driver: TDS2014 | None) -> None:
    """Close without minding what the link does."""
    if driver is not None:
        with contextlib.suppress(InstrumentError):
            driver.close()


def newest_number(scope: SimulatedTDS2014) -> int:
    """Number of the acquisition that the scope shows, 0 without one."""
    record = scope.acquisition.record
    return 0 if record is None else record.number


def is_what_the_scope_holds(waveform: Waveform, scope: SimulatedTDS2014) -> bool:
    """Compare codes and scales with the record inside the simulated scope."""
    trace = scope.trace("CH1")
    if trace is None:
        return False
    preamble = waveform.preamble
    got = (preamble.ymult, preamble.yzero, preamble.yoff, preamble.xincr, preamble.xzero)
    held = (trace.ymult, trace.yzero, trace.yoff, trace.xincr, trace.xzero)
    # The preamble travels with about ten digits.
    return np.array_equal(waveform.codes, trace.codes) and bool(np.allclose(got, held, rtol=1e-9, atol=1e-15))


@dataclass(frozen=True)
class EndedRun:
    """How a run through the proxy ended."""

    outcome: str
    right: int
    wrong: int
    spoiled: int
    messages: int
    link: Tally
    panel_is_back: bool
    seconds: float


def measure(share: float, *, records: int, seed: int) -> EndedRun:
    """Take one run as `gyrolock measure --resource` does, and compare what it saved with what the scope showed."""
    bench = at_slow_rate(default_settings("simulated"))
    scope = RecordingScope.watch(build_instruments(bench, VirtualClock()).scope)
    before, began = front_panel(scope), time.perf_counter()
    with (
        tempfile.TemporaryDirectory() as folder,
        TcpServer(scope) as server,
        FaultProxy(server.port, share, seed=seed) as proxy,
    ):
        settings = default_settings("bench")
        settings = settings.model_copy(
            update={
                "gyro": bench.gyro,
                "scope": settings.scope.model_copy(update={"resource": proxy.resource_name}),
                "measurement": settings.measurement.model_copy(update={"records": records}),
                "output": settings.output.model_copy(update={"directory": folder}),
            }
        )
        taken = start_run(measurement("measure"), settings, Progress())
        run = open_run(taken.path)
        numbers = []
        for record in run.taken_for("measure"):
            preamble = Preamble.parse(record.preamble)
            numbers.append(scope.acquisition_of(record.payload, preamble.ymult, preamble.xincr))
        right = len({number for number in numbers if number is not None})
        return EndedRun(
            outcome=run.facts.outcome_text,
            right=right,
            wrong=len(numbers) - right,
            spoiled=proxy.happened.total(),
            messages=proxy.messages,
            link=run.facts.link_faults or Tally(),
            panel_is_back=front_panel(scope) == before,
            seconds=time.perf_counter() - began,
        )


def front_panel(scope: SimulatedTDS2014) -> bytes:
    """All settings, asked for at the scope itself."""
    with scope.lock:
        return b"".join(answer or b"" for answer in scope.execute(b":HEADER ON;:SET?"))


def measure_often(runs: int, share: float, records: int) -> int:
    """Take runs one after the other and print how each ended; 0 if nothing was wrong."""
    good = complete = 0
    for seed in range(1, runs + 1):
        ended = measure(share, records=records, seed=seed)
        complete += ended.outcome == TAKEN
        good += ended.wrong == 0
        how = "complete" if ended.outcome == TAKEN else ended.outcome
        panel = "as before" if ended.panel_is_back else "altered"
        sys.stdout.write(
            f"run {seed}: {how}; {ended.right} right, {ended.wrong} wrong; {ended.spoiled} of {ended.messages} "
            f"messages spoiled; {ended.link}; front panel {panel}; {ended.seconds:.0f} s\n"
        )
        sys.stdout.flush()
    sys.stdout.write(f"{complete} of {runs} runs complete, {runs - good} with a wrong record\n")
    return 0 if good == runs else 1


def main(arguments: list[str] | None = None) -> int:
    """Run, print what became of the records, and return 0 if none was wrong."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.faults", description="Records over a bad link.")
    many = f"default {DEFAULT_RECORDS}, of a run {RECORDS_OF_A_RUN}"
    parser.add_argument("--records", type=int, help=many)
    parser.add_argument("--runs", type=int, help="take whole runs through a proxy, in real time")
    parser.add_argument("--share", type=float, default=0.05, help="of messages that the proxy spoils each way")
    parser.add_argument("--seed", type=int, default=11)
    options = parser.parse_args(arguments)
    if options.runs:
        return measure_often(options.runs, options.share, options.records or RECORDS_OF_A_RUN)
    began = time.perf_counter()
    outcome = run(options.records or DEFAULT_RECORDS, seed=options.seed)
    lines = [
        f"{outcome.records} records asked for, {FAULT_PROBABILITY:.0%} of all answers spoiled",
        f"{outcome.right:6} right",
        f"{outcome.wrong:6} wrong",
        f"{outcome.refused.total():6} refused: {counts(outcome.refused)}",
        f"{outcome.reconnected:6} times connected again",
        f"{outcome.faults.total():6} faults: {counts(outcome.faults)}",
        f"longest time from asking to a refusal: {outcome.longest_refusal:.1f} s of the scope's clock",
        f"{time.perf_counter() - began:.1f} s in all",
    ]
    sys.stdout.write("\n".join(lines) + "\n")
    return 1 if outcome.wrong else 0


def counts(counter: Counter[str]) -> str:
    """`name 3, other 2`, most frequent first."""
    return ", ".join(f"{name} {number}" for name, number in counter.most_common()) or "none"


if __name__ == "__main__":
    sys.exit(main())
