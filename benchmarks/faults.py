"""`python -m benchmarks.faults --records N`: records over a link that spoils two answers in a hundred.

Every record must come right or be refused by an exception; a wrong one is a failure of the driver. Virtual time
makes the waiting free. Every acquisition sees another phase of the signal, so that an old record cannot pass
for a new one, and what arrives is compared with what the scope holds.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import time
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
import pyvisa

from analysis.arrays import Floats
from instrument import TDS2014, InstrumentError, LinkError, Waveform
from instrument.simulated import Fault, Faults, SimulatedTDS2014, VirtualClock, resource_manager
from instrument.simulated.faults import FaultKind

FAULT_PROBABILITY = 0.02
DEFAULT_RECORDS = 10_000
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


def main(arguments: list[str] | None = None) -> int:
    """Run, print what became of the records, and return 0 if none was wrong."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.faults", description="Records over a bad link.")
    parser.add_argument("--records", type=int, default=DEFAULT_RECORDS, help=f"default {DEFAULT_RECORDS}")
    parser.add_argument("--seed", type=int, default=11)
    options = parser.parse_args(arguments)
    began = time.perf_counter()
    outcome = run(options.records, seed=options.seed)
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
