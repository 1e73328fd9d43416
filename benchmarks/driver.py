"""`python -m benchmarks.driver`: what one record costs, beside plain PyVISA programs on the same links.

The rivals are written here in plain PyVISA the way such programs are usually written. *Lean* sends two
messages for a record and trusts a preamble that it has read once. *Usual* sends nine: it sets source and format
again and asks for the five numbers of the scaling one by one. All of them read the same simulated scope. Their
sockets have TCP_NODELAY set, which PyVISA-py leaves off by default: a forgotten option is not what is compared.
"""

from __future__ import annotations

import argparse
import socket
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pyvisa
from pyvisa.resources import MessageBasedResource

from analysis.arrays import Floats
from benchmarks.links.delaying_proxy import DelayingProxy, Traffic
from instrument import TDS2014
from instrument.scpi import POINTS
from instrument.simulated import PtyServer, SimulatedTDS2014, TcpServer, VirtualClock, resource_manager
from instrument.simulated.links.exchange import MessageExchange

BAUD_RATE = 19_200
BITS_PER_BYTE = 10

LATENCY = 0.02  # s, there and back
SECONDS_PER_DIVISION = 1e-5  # a record of 0.1 ms: what is measured is the link
LINE_LIMIT, LEAN_GAIN, USUAL_GAIN = 1.08, 1.6, 4.0

Record = Callable[[], object]


@dataclass(frozen=True)
class Cost:
    """Median cost of one record: what passes over the link, and the time in s."""

    traffic: Traffic
    seconds: float

    @property
    def line_time(self) -> float:
        """Time in s that the bytes alone take at `BAUD_RATE`."""
        return (self.traffic.up + self.traffic.down) * BITS_PER_BYTE / BAUD_RATE


def sine(times: Floats) -> Floats:
    """The signal at the scope: 30 kHz, 2 V."""
    return np.asarray(2.0 * np.sin(2 * np.pi * 3e4 * times))


# ------------------------------------------------------------------ plain PyVISA


class PlainScope:
    """The usual script, kept short: a PyVISA resource and the preamble that was read at the start."""

    def __init__(self, resource_name: str, manager: pyvisa.ResourceManager) -> None:
        resource = manager.open_resource(resource_name)
        assert isinstance(resource, MessageBasedResource)
        self.resource = resource
        resource.timeout = 10_000
        resource.read_termination = resource.write_termination = "\n"
        interface = resource.visalib.sessions[resource.session].interface  # type: ignore[attr-defined]
        interface.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for message in ("HEADER OFF", "DATA:ENCDG RIBINARY", "DATA:WIDTH 1", "ACQUIRE:STOPAFTER SEQUENCE"):
            resource.write(message)
        self.scaling = self.read_scaling()

    def close(self) -> None:
        self.resource.close()

    def read_scaling(self) -> list[float]:
        names = ("YMULT", "YZERO", "YOFF", "XINCR", "XZERO")
        return [float(self.resource.query(f"WFMPRE:{name}?")) for name in names]

    def curve(self, scaling: list[float]) -> Floats:
        codes = np.array(self.resource.query_binary_values("CURVE?", datatype="b", container=np.ndarray))
        return np.asarray((codes - scaling[2]) * scaling[0] + scaling[1])

    def lean_stored(self) -> Floats:
        self.resource.write("DATA:SOURCE CH1")
        return self.curve(self.scaling)

    def lean_fresh(self) -> Floats:
        self.resource.query("ACQUIRE:STATE RUN;*OPC?")
        return self.curve(self.scaling)

    def usual_stored(self) -> Floats:
        for message in ("DATA:SOURCE CH1", "DATA:ENCDG RIBINARY", "DATA:WIDTH 1"):
            self.resource.write(message)
        return self.curve(self.read_scaling())

    def usual_fresh(self) -> Floats:
        self.resource.write("ACQUIRE:STATE RUN")
        self.resource.query("*OPC?")
        self.resource.write("DATA:SOURCE CH1")
        return self.curve(self.read_scaling())


# ------------------------------------------------------------------ measuring


def measure(record: Record, proxy: DelayingProxy, repeats: int) -> Cost:
    """Median of single records, after two that bring the driver into its steady state."""
    record()
    record()
    proxy.traffic()
    seconds, traffics = [], []
    for _ in range(repeats):
        began = time.perf_counter()
        record()
        seconds.append(time.perf_counter() - began)
        traffics.append(proxy.traffic())
    return Cost(sorted(traffics, key=lambda each: each.up + each.down)[repeats // 2], statistics.median(seconds))


def costs_with_latency(repeats: int) -> dict[str, dict[str, Cost]]:
    """Cost of a stored and a fresh record of each program on a link with `LATENCY`, by kind and program."""
    scope = SimulatedTDS2014({1: sine}, seed=1)
    prepare(scope)
    manager = pyvisa.ResourceManager("@py")
    with TcpServer(scope) as server, DelayingProxy(server.port, LATENCY) as proxy:
        plain = PlainScope(proxy.resource_name, manager)
        costs = {
            "fresh": {
                "lean PyVISA": measure(plain.lean_fresh, proxy, repeats),
                "usual PyVISA": measure(plain.usual_fresh, proxy, repeats),
            },
            "stored": {
                "lean PyVISA": measure(plain.lean_stored, proxy, repeats),
                "usual PyVISA": measure(plain.usual_stored, proxy, repeats),
            },
        }
        plain.close()
        with TDS2014(proxy.resource_name, resource_manager=manager) as ours:
            costs["fresh"]["gyrolock"] = measure(lambda: ours.acquire("CH1"), proxy, repeats)
            costs["stored"]["gyrolock"] = measure(lambda: ours.fetch("CH1"), proxy, repeats)
    manager.close()
    return costs


def prepare(scope: SimulatedTDS2014) -> None:
    """A fast time base, set as from the front panel."""
    for _ in scope.execute(f"HORIZONTAL:MAIN:SCALE {SECONDS_PER_DIVISION}".encode()):
        pass


def time_at_baud_rate(repeats: int) -> float:
    """Median time in s of a fresh record over a pseudo-terminal whose bytes take their time."""
    scope = SimulatedTDS2014({1: sine}, seed=1)
    prepare(scope)
    manager = pyvisa.ResourceManager("@py")
    seconds = []
    with (
        PtyServer(scope, BAUD_RATE) as server,
        TDS2014(server.resource_name, resource_manager=manager, baud_rate=BAUD_RATE) as ours,
    ):
        ours.acquire("CH1")
        for _ in range(repeats):
            began = time.perf_counter()
            ours.acquire("CH1")
            seconds.append(time.perf_counter() - began)
    manager.close()
    return statistics.median(seconds)


def in_process_speed(repeats: int) -> dict[str, float]:
    """Time in s per record without a wait: of the scope and its link alone, and with driver and PyVISA."""
    scope = SimulatedTDS2014({1: sine}, clock=VirtualClock(), seed=1)
    prepare(scope)
    link = MessageExchange(scope, message_ends=True)

    def fresh() -> None:
        link.receive(b"ACQ:STOPA SEQ;STATE RUN;*WAI;*ESR?;:WAVF?")
        link.wait_for_answer(1.0)

    times = {}
    for _ in scope.execute(b"CH1:BANDWIDTH ON"):
        pass
    times["fresh, 20 MHz limit"] = each(fresh, repeats)
    for _ in scope.execute(b"CH1:BANDWIDTH OFF"):
        pass
    times["fresh"] = each(fresh, repeats)
    times["stored"] = each(lambda: list(scope.execute(b"WAVF?")), repeats)
    manager = resource_manager(scopes={"GPIB0::1::INSTR": scope})
    with TDS2014("GPIB0::1::INSTR", resource_manager=manager) as ours:
        ours.acquire("CH1")
        times["fresh, with driver and PyVISA"] = each(lambda: ours.acquire("CH1"), repeats)
    manager.close()
    return times


def messages_per_second(repeats: int) -> float:
    """Questions that one client asks and has answered over TCP."""
    with TcpServer(SimulatedTDS2014()) as server, socket.create_connection((server.host, server.port)) as peer:
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with peer.makefile("rwb") as stream:

            def question() -> None:
                stream.write(b"CH1:SCALE?\n")
                stream.flush()
                stream.readline()

            return 1 / each(question, 5 * repeats)


def each(action: Record, repeats: int, batches: int = 8) -> float:
    """Mean time in s of one of many, in the best of several batches: other programs' share is not ours."""
    action()
    count = max(1, repeats // batches)
    spent = []
    for _ in range(batches):
        began = time.perf_counter()
        for _ in range(count):
            action()
        spent.append((time.perf_counter() - began) / count)
    return min(spent)


# ------------------------------------------------------------------ report


def print_table(costs: dict[str, dict[str, Cost]]) -> None:
    """One row for each kind of record and program."""
    out = sys.stdout.write
    out("| record | program | messages | turn-arounds | bytes up / down | ")
    out(f"s at {BAUD_RATE} baud | ms at {1000 * LATENCY:g} ms | times ours |\n")
    out("|---|---|---|---|---|---|---|---|\n")
    for kind, rows in costs.items():
        ours = rows["gyrolock"].seconds
        for program in sorted(rows):
            cost, passed = rows[program], rows[program].traffic
            out(f"| {kind} | {program} | {passed.messages} | {passed.turn_arounds} | {passed.up} / {passed.down} ")
            out(f"| {cost.line_time:.3f} | {1000 * cost.seconds:.1f} | {cost.seconds / ours:.2f} |\n")


def print_verdict(name: str, value: float, limit: float, *, at_most: bool) -> bool:
    """One line that says whether a limit is kept; returns that."""
    kept = value <= limit if at_most else value >= limit
    sign = "<=" if at_most else ">="
    sys.stdout.write(f"{'holds' if kept else 'FAILS':6}{name}: {value:.3f} {sign} {limit:g}\n")
    return kept


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, and return 0 if every limit is kept."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.driver", description="What one record costs, beside plain PyVISA."
    )
    parser.add_argument("--repeats", type=int, default=40, help="records of each kind (default 40)")
    repeats = parser.parse_args(arguments).repeats
    costs = costs_with_latency(repeats)
    print_table(costs)
    fresh = costs["fresh"]
    ours = fresh["gyrolock"]
    measured = time_at_baud_rate(max(3, repeats // 10))
    times, rate = in_process_speed(10 * repeats), messages_per_second(10 * repeats)
    data_time = POINTS * BITS_PER_BYTE / BAUD_RATE
    acquisition = 10 * SECONDS_PER_DIVISION
    sys.stdout.write("\nfresh records\n")
    kept = [
        print_verdict(
            "bytes over those of the data, line time", ours.line_time / data_time, LINE_LIMIT, at_most=True
        ),
        print_verdict(
            f"the same measured on a pty at {BAUD_RATE} baud",
            (measured - acquisition) / data_time,
            LINE_LIMIT,
            at_most=True,
        ),
        print_verdict("faster than lean", fresh["lean PyVISA"].seconds / ours.seconds, LEAN_GAIN, at_most=False),
        print_verdict(
            "faster than usual", fresh["usual PyVISA"].seconds / ours.seconds, USUAL_GAIN, at_most=False
        ),
        *(
            print_verdict(
                f"simulated scope in this process, ms a record ({kind})", 1000 * spent, 1.0, at_most=True
            )
            for kind, spent in times.items()
        ),
        print_verdict("simulated scope over TCP, messages/s", rate, 2000.0, at_most=False),
    ]
    return 0 if all(kept) else 1


if __name__ == "__main__":
    sys.exit(main())
