"""`python -m benchmarks.simulated_scope`: what one message costs the simulated scope, by time base and mode.

The scope looks at the gyro of `config/simulated.toml` with its detector noise, at the slow rate, on a virtual
clock. Each line is one time base in one mode. A client lets some time pass, as its own work would, then sends one
message; the table gives the CPU time of the answer, the median and the largest of some, and what they are in
transforms of 2500 points (`rfft`) made in the same run. Averages are full. In the columns "after a silence" nobody
has asked for anything for two hundred records. It fails if a median is above its limit: on a busy machine the
largest one tells of the machine.

With `--clients 4` so many of them ask one scope on a TCP socket in real time, without a pause, in scan mode and in
others: how many answers each has, how long it waits, and the CPU time of the messages.
"""

from __future__ import annotations

import argparse
import functools
import socket
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from instrument.scpi import POINTS
from instrument.simulated import SimulatedTDS2014, TcpServer, VirtualClock
from instrument.simulated.links.exchange import MessageExchange
from station.lock_in.served import at_slow_rate, simulated_scopes
from station.lock_in.settings import load_settings
from station.ring_laser.instruments import build_instruments
from station.settings import Values

TIME_BASES = (1e-8, 1e-6, 1e-4, 1e-3, 1e-2, 5e-2, 0.5)  # s/div
MODES = {
    "sample": "ACQUIRE:MODE SAMPLE",
    "full bandwidth": "CH1:BANDWIDTH OFF",
    "AC": "CH1:COUPLING AC",
    "peak detect": "ACQUIRE:MODE PEAKDETECT",
    "average 16": "ACQUIRE:MODE AVERAGE;NUMAVG 16",
    "average 128": "ACQUIRE:MODE AVERAGE;NUMAVG 128",
    "trigger HF reject": "TRIGGER:MAIN:EDGE:COUPLING HFREJ",
    "trigger LF reject": "TRIGGER:MAIN:EDGE:COUPLING LFREJ",
    "trigger AC": "TRIGGER:MAIN:EDGE:COUPLING AC",
    "pulse trigger": "TRIGGER:MAIN:TYPE PULSE;PULSE:WIDTH:WIDTH 1E-3",
    "video trigger": "TRIGGER:MAIN:TYPE VIDEO",
    "normal, no trigger": "TRIGGER:MAIN:MODE NORMAL;LEVEL 3",
}
GAINS: Values = {"simulation": {"contaminants": {"gain_corner_hz": 2e4, "bandwidth_hz": 2e4, "ac_corner_hz": 1.0}}}
LIMITS_MS = {"CURVE?": 5.0, "TRIGGER:STATE?": 1.0}
_SILENCE = 200  # records
_SHORTEST_CYCLE = 0.02  # s, of the scope with its dead time and the wait for a trigger


@dataclass(frozen=True)
class Cost:
    """CPU time of one kind of message, ms."""

    median: float
    largest: float

    @classmethod
    def of(cls, seconds: Sequence[float]) -> Cost:
        """Summary of several."""
        return cls(1e3 * float(np.median(seconds)), 1e3 * max(seconds))


class Client:
    """One scope on the gyro's signal, and the link to it."""

    def __init__(self, overrides: Values, mode: str, base: float, seed: int) -> None:
        given = load_settings(overrides=overrides)
        self.clock = VirtualClock()
        self.scope = build_instruments(at_slow_rate(given), self.clock).scope
        self.link = MessageExchange(self.scope, message_ends=True)
        self.pauses = np.random.default_rng(seed)
        self.base = base
        self.write("HEADER OFF;:DATA:ENCDG RIBINARY;WIDTH 1;:CH1:PROBE 1;SCALE 0.1;POSITION -1.2;BANDWIDTH ON")
        self.write(f"TRIGGER:MAIN:LEVEL 0.12;:HORIZONTAL:MAIN:SCALE {base:g};:{mode}")
        self.ask("CURVE?" if "NORMAL" not in mode else "*OPC?")
        self.clock.sleep(_SILENCE * max(10 * base, _SHORTEST_CYCLE))
        self.ask("CURVE?")

    def write(self, message: str) -> None:
        """Send a message and have it carried out."""
        self.link.receive(message.encode())
        self.link.pump()

    def ask(self, message: str) -> bytes:
        """Answer to a question, however long the scope takes for it."""
        self.write(message)
        return self.link.wait_for_answer(3600.0) or b""

    def cost(self, act: Callable[[], object], repeats: int, silence: float = 0.0) -> Cost:
        """CPU time of an act, each time after a pause of up to two records, or after a silence of so many."""
        seconds = []
        for _ in range(repeats):
            self.clock.sleep(float(self.pauses.uniform(0.0, 2.0)) * max(10 * self.base, 0.05))
            self.clock.sleep(silence * max(10 * self.base, _SHORTEST_CYCLE))
            began = time.thread_time()
            act()
            seconds.append(time.thread_time() - began)
        return Cost.of(seconds)

    def costs(self, repeats: int) -> dict[str, Cost]:
        """Costs by message."""
        found = {
            name: self.cost(functools.partial(self.ask, name), repeats)
            for name in ("CURVE?", "TRIGGER:STATE?", "ACQUIRE:STATE?")
        }
        for name in LIMITS_MS:
            found[f"{name} after a silence"] = self.cost(functools.partial(self.ask, name), repeats, _SILENCE)
        positions = iter(range(1000))
        found["a setting"] = self.cost(
            lambda: self.write(f"CH1:POSITION {next(positions) % 9 / 100 - 1.2:g}"), repeats
        )
        if self.ask("TRIGGER:MAIN:MODE?").strip() == b"AUTO":
            found["a single"] = self.cost(self.single, repeats)
        return found

    def single(self) -> None:
        """Take one record and fetch it."""
        self.write("ACQUIRE:STOPAFTER SEQUENCE;STATE RUN")
        self.ask("*OPC?")
        self.ask("CURVE?")


def transform_ms() -> float:
    """CPU time of an rfft of one record, ms."""
    volts, seconds = np.random.default_rng(0).standard_normal(POINTS), []
    for _ in range(20):
        began = time.thread_time()
        for _ in range(50):
            np.fft.rfft(volts)
        seconds.append((time.thread_time() - began) / 50)
    return 1e3 * min(seconds)


CROWDED = {
    "scan, 0.5 s/div": "ACQUIRE:MODE SAMPLE;:HORIZONTAL:MAIN:SCALE 0.5",
    "scan, peak detect": "ACQUIRE:MODE PEAKDETECT;:HORIZONTAL:MAIN:SCALE 0.5",
    "100 us/div": "ACQUIRE:MODE SAMPLE;:HORIZONTAL:MAIN:SCALE 1E-4",
    "100 us/div, average 16": "ACQUIRE:MODE AVERAGE;NUMAVG 16;:HORIZONTAL:MAIN:SCALE 1E-4",
}
_CURVE_BYTES = len(b"#42500") + POINTS + len(b"\n")


def timed(scope: SimulatedTDS2014) -> dict[bytes, list[float]]:
    """Have a scope note the CPU time of each message in s, by message."""
    spent: dict[bytes, list[float]] = {}
    carry_out = scope.execute

    def execute(message: bytes, *, stream: bool = False) -> Iterator[bytes | None]:
        began = time.thread_time()
        for step in carry_out(message, stream=stream):
            spent.setdefault(message, []).append(time.thread_time() - began)
            yield step
            began = time.thread_time()

    scope.execute = execute  # type: ignore[method-assign]
    return spent


def ask_on(link: socket.socket, message: bytes) -> bytes:
    """Answer to a question on a socket; a curve has its length."""
    link.sendall(message + b"\n")
    answer = b""
    while not (len(answer) == _CURVE_BYTES if message == b"CURVE?" else answer.endswith(b"\n")):
        answer += link.recv(1 << 16)
    return answer


def crowd(clients: int, seconds: float) -> int:
    """Print what each of several clients gets of one scope; 1 if one of them gets less than half of another."""
    scope = simulated_scopes(load_settings())[0]
    spent, starved, out = timed(scope), 0, sys.stdout.write
    with TcpServer(scope) as server, ThreadPoolExecutor(clients) as pool:
        address = (server.host, server.port)

        def client() -> list[float]:
            waits, until = [], time.monotonic() + seconds
            with socket.create_connection(address) as link:
                while (now := time.monotonic()) < until:
                    ask_on(link, b"CURVE?" if len(waits) % 3 else b"TRIGGER:STATE?")
                    waits.append(time.monotonic() - now)
            return waits

        out(f"{clients} clients at once\n\n| | answers | wait, median / longest | CURVE? | TRIGGER:STATE? |\n")
        out("|---|---|---|---|---|\n")
        for name, message in CROWDED.items():
            with socket.create_connection(address) as link:
                ask_on(link, f"HEADER OFF;:DATA INIT;:{message};*OPC?".encode())
            time.sleep(1.0)
            spent.clear()
            waits = [one.result() for one in [pool.submit(client) for _ in range(clients)]]
            counts = sorted(map(len, waits))
            starved += counts[0] < counts[-1] / 2
            costs = [Cost.of(spent[message.encode()]) for message in LIMITS_MS]
            cells = [
                f"{counts[0]} to {counts[-1]}",
                f"{1e3 * np.median(np.concatenate(waits)):.1f} / {1e3 * max(map(max, waits)):.0f} ms",
                *(f"{cost.median:.2f} / {cost.largest:.2f} ms" for cost in costs),
            ]
            out(f"| {name} | {' | '.join(cells)} |\n")
            sys.stdout.flush()
    return int(starved > 0)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; 1 if a message usually costs more than its limit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=12, help="messages of each kind (default 12)")
    parser.add_argument("--mode", choices=[*MODES, "gyro with filters"], action="append", help="only this one")
    parser.add_argument("--base", type=float, action="append", help="only this time base, s/div")
    parser.add_argument("--clients", type=int, default=0, help="no table: so many clients of one scope at once")
    parser.add_argument("--seconds", type=float, default=5.0, help="time of each of their tries (default 5)")
    given = parser.parse_args(arguments)
    if given.clients:
        return crowd(given.clients, given.seconds)
    unit, too_slow, out = transform_ms(), 0, sys.stdout.write
    out(f"CPU time, median / largest in ms; in brackets the median over one rfft of {POINTS} ({unit:.3f} ms)\n\n")
    medians: dict[str, list[float]] = {}
    silent = [f"{name} after a silence" for name in LIMITS_MS]
    columns = (*LIMITS_MS, *silent, "ACQUIRE:STATE?", "a setting", "a single")
    out(f"| mode | s/div | {' | '.join(columns)} |\n|---|---|{'---|' * len(columns)}\n")
    for mode in given.mode or [*MODES, "gyro with filters"]:
        for base in given.base or TIME_BASES:
            overrides = GAINS if mode == "gyro with filters" else {}
            found = Client(overrides, MODES.get(mode, MODES["sample"]), base, seed=1).costs(given.repeats)
            cells = []
            for column in columns:
                cost = found.get(column)
                if cost is None:
                    cells.append("")
                    continue
                medians.setdefault(column, []).append(cost.median)
                over = cost.median > LIMITS_MS.get(column, np.inf)
                too_slow += over
                cells.append(
                    f"{cost.median:.2f} / {cost.largest:.2f}{' !' if over else ''} ({cost.median / unit:.0f})"
                )
            out(f"| {mode} | {base:g} | {' | '.join(cells)} |\n")
            sys.stdout.flush()
    for column in (*LIMITS_MS, *silent):
        found_ms = medians[column]
        middle, largest = float(np.median(found_ms)), max(found_ms)
        out(f"\n{column}: {middle:.2f} ms in the median of {len(found_ms)} cells, {largest:.2f} ms at most")
    out(f"\n\n{too_slow} of them above the limit: {LIMITS_MS} ms\n")
    return int(too_slow > 0)


if __name__ == "__main__":
    sys.exit(main())
