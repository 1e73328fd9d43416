"""`python -m benchmarks.fuzz --count 1000000`: random byte strings at the simulated scope's parser.

Two in five strings are random bytes, the others are pieces of real commands put together at random. They go in
turn to a link with message ends and to a stream. After each one the next good query must be answered rightly: at
once, or where the string has made the scope wait (`*WAI`), after the clear that a user would send. Virtual time
makes waiting free.
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from dataclasses import dataclass, field

from instrument.simulated import SimulatedTDS2014, VirtualClock
from instrument.simulated.links.exchange import MessageExchange
from instrument.simulated.panel.parsing import LONGEST_BLOCK

DEFAULT_COUNT = 1_000_000
LONGEST = 1.0  # s of work that one string may take; a busy machine does not count
PIECES = (
    *(
        b"*IDN?",
        b"CH1",
        b":",
        b"SCALE",
        b"?",
        b" ",
        b";",
        b",",
        b"#",
        b"#42500",
        b"#0",
        b"#9999999999",
        b'"',
        b"'",
    ),
    *(b"1E", b"e", b"-", b"CURVE", b"WFMPRE", b"DATA", b"SOU", b"REFA", b"MATH:DEFINE", b"FFT(CH1", b")", b"*"),
    *(b"ACQ:STATE RUN", b"STOPA SEQ", b"\t", b"\x00", b"\xff", b"*DDT", b"*TRG", b"\xc3\xa9", b"1E400", b"nan"),
    *(b"HOR:SCALE 50", b"inf", b"0x10", b"1_0", b"SET?", b"*RST", b"VERB OFF", b"BUSY?", b"EVENT?", b"*WAI"),
    *(b"TRIG:MAIN:MODE NORM", b"LEVEL", b"MEASU:IMM:VAL?", b"POSITION 1e30", b"\r", b"\n", b"::", b"*OPC"),
    *(b"SELECT:MATH ON", b"DATA:SOURCE MATH", b"CURVE?", b"HARDCOPY START", b"AUTOSET EXEC", b"TYPE PULSE"),
    *(b"DISPLAY:FORMAT XY", b"SAVE:WAVEFORM CH1,REFB", b"*SAV 3", b"*RCL 3", b"FACTORY", b"WAVF?", b"TYPE VIDEO"),
    *(b"ACQ:MODE AVE", b"ACQ:MODE PEAK", b"DATA:STOP 1", b"RS232:BAUD", b"#15", b"ABCDE", b"DESE 0", b"*SRE 255"),
)


@dataclass
class Outcome:
    """What became of the strings."""

    strings: int = 0
    cleared: int = 0
    """After so many of them the scope waited and was cleared."""
    longest: float = 0.0
    """Longest real time in s that one took."""
    failures: list[tuple[bytes, str]] = field(default_factory=list)


class Victim:
    """A simulated scope with the two kinds of links."""

    def __init__(self, model: str) -> None:
        self.scope = SimulatedTDS2014({}, model=model, clock=VirtualClock(), message_time=1e-4)
        self.identity = self.scope.identity.encode() + b"\n"
        self.message_link = MessageExchange(self.scope, message_ends=True)
        self.stream_link = MessageExchange(self.scope, message_ends=False)

    def take(self, message: bytes, *, stream: bool) -> bool:
        """Send a string; True if a clear was needed before the next query."""
        link = self.stream_link if stream else self.message_link
        link.receive(message)
        link.pump()
        if not stream:
            waits = link.working
            if waits:
                link.clear()
            return waits
        link.receive(b"\n")
        return self._come_to_rest()

    def _come_to_rest(self) -> bool:
        """Let the stream's messages end and drop their answers; True if that took a clear."""
        link = self.stream_link
        self._drain()
        if link.working:
            self.scope.clock.sleep(1.0)  # the record that a question waits for
            self._drain()
        waits = link.working
        if waits:
            link.clear()
        return waits

    def _drain(self) -> None:
        self.stream_link.pump()
        while self.stream_link.take() is not None:
            pass

    def answers(self, *, stream: bool) -> bytes | None:
        """The answer to a good query."""
        link = self.stream_link if stream else self.message_link
        link.receive(b"*IDN?\n" if stream else b"*IDN?")
        answer = link.wait_for_answer(0.1)
        if stream and answer != self.identity:
            # A block was begun, and took the question for data: line ends get through it.
            link.receive(b"\n" * (LONGEST_BLOCK + 20))
            self._come_to_rest()
            link.receive(b"*IDN?\n")
            answer = link.wait_for_answer(0.1)
        return answer


def random_string(source: random.Random) -> bytes:
    """Random bytes, or pieces of commands in random order."""
    if source.random() < 0.4:
        return source.randbytes(source.randint(1, 24))
    # With separators between them the pieces are commands more often, and do something.
    between = source.choice((b"", b"", b";", b";:", b" ", b"\n", b";:CH1:SCALE "))
    return between.join(source.choices(PIECES, k=source.randint(1, 8)))


def run(count: int, *, seed: int = 0, model: str = "TDS2014") -> Outcome:
    """Send `count` strings and look after each whether the scope still answers."""
    source = random.Random(seed)
    victim = Victim(model)
    outcome = Outcome()
    sent: list[tuple[bytes, bool]] = []
    for number in range(count):
        message, stream = random_string(source), bool(number % 2)
        sent.append((message, stream))
        began = time.thread_time()
        try:
            outcome.cleared += victim.take(message, stream=stream)
            answer = victim.answers(stream=stream)
        except Exception as error:  # whatever it is, it is a finding
            outcome.failures.append((message, repr(error)))
            victim = Victim(model)
        else:
            if answer != victim.identity:
                outcome.failures.append((message, f"*IDN? was answered by {answer!r:.60}"))
                victim = Victim(model)
        spent = time.thread_time() - began
        if spent > LONGEST:  # what this process did beside it does not count: all once more, to the same state
            again = Victim(model)
            for before, as_stream in sent[:-1]:
                again.take(before, stream=as_stream)
                again.answers(stream=as_stream)
            began = time.thread_time()
            again.take(message, stream=stream)
            again.answers(stream=stream)
            spent = time.thread_time() - began
        outcome.longest = max(outcome.longest, spent)
        if spent > LONGEST:
            outcome.failures.append((message, f"took {spent:.1f} s"))
        outcome.strings += 1
    return outcome


def main(arguments: list[str] | None = None) -> int:
    """Send the strings, print what they did, and return 0 if every next query was answered."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fuzz", description="Random strings at the parser.")
    parser.add_argument("--count", type=int, default=DEFAULT_COUNT, help=f"default {DEFAULT_COUNT}")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--model", default="TDS2014")
    options = parser.parse_args(arguments)
    began = time.perf_counter()
    outcome = run(options.count, seed=options.seed, model=options.model)
    sys.stdout.write(
        f"{outcome.strings} strings, {outcome.cleared} of them left the scope waiting until a clear\n"
        f"{len(outcome.failures)} after which it failed\n"
        f"longest: {1000 * outcome.longest:.1f} ms; {time.perf_counter() - began:.1f} s in all\n"
    )
    for message, problem in outcome.failures[:20]:
        sys.stdout.write(f"  {message!r}: {problem}\n")
    return 1 if outcome.failures else 0


if __name__ == "__main__":
    sys.exit(main())
