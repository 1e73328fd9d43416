"""A scope that is only as good as its recorded sentences: a line server for protocol tests.

It holds settings in a dictionary and answers with the preamble of a real unit. What goes out can be
damaged by a test. The complete simulated scope has its own package; this one shares no code with it.
"""

import contextlib
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest
import pyvisa

from instrument import TDS2014
from instrument.simulated import Faults, PtyServer, SimulatedTDS2014, TcpServer, resource_manager

IDENTITY = "TEKTRONIX,TDS 2014,0,CF:91.1CT FV:v4.12 TDS2CM:CMV:v1.04"
# As a TDS2024 answered, with the channel of these tests (programmer manual 071-1075-04, p. 2-243).
PREAMBLE = (
    '1;8;BIN;RI;MSB;2500;"Ch1, DC coupling, 5.0E-1 V/div, 5.0E-4 s/div, 2500 points, Sample mode";'
    'Y;2.0E-6;0;-2.5E-3;"s";2.0E-2;0.0E0;-1.69E2;"Volts"'
)
SETTINGS = {
    "HEADER": "1",
    "VERBOSE": "1",
    "DATA:ENCDG": "ASCII",
    "DATA:SOURCE": "CH2",
    "DATA:START": "10",
    "DATA:STOP": "500",
    "DATA:WIDTH": "2",
    "HORIZONTAL:MAIN:SCALE": "5.0E-4",
    "HORIZONTAL:MAIN:POSITION": "0.0E0",
    "ACQUIRE:MODE": "SAMPLE",
    "ACQUIRE:NUMAVG": "16",
    "ACQUIRE:STOPAFTER": "RUNSTOP",
    "ACQUIRE:STATE": "1",
    "TRIGGER:MAIN:MODE": "AUTO",
    "TRIGGER:MAIN:TYPE": "EDGE",
    "TRIGGER:MAIN:EDGE:SOURCE": "CH1",
    "TRIGGER:MAIN:EDGE:COUPLING": "DC",
    "TRIGGER:MAIN:EDGE:SLOPE": "RISE",
    "TRIGGER:MAIN:HOLDOFF:VALUE": "5.0E-7",
    "TRIGGER:MAIN:LEVEL": "0.0E0",
    "CURSOR:VBARS:POSITION1": "-2.0E-3",
    "CURSOR:VBARS:POSITION2": "2.0E-3",
    "CURSOR:HBARS:POSITION1": "-3.2E0",
    "CURSOR:HBARS:POSITION2": "3.2E0",
    "LOCK": "NONE",
    "BUSY": "0",
    "TRIGGER:STATE": "SAVE",
}
for _n in range(1, 5):
    SETTINGS |= {
        f"CH{_n}:PROBE": "10",
        f"CH{_n}:SCALE": "1.0E0",
        f"CH{_n}:POSITION": "0.0E0",
        f"CH{_n}:COUPLING": "DC",
        f"CH{_n}:BANDWIDTH": "OFF",
        f"CH{_n}:INVERT": "OFF",
        f"SELECT:CH{_n}": "1" if _n == 1 else "0",
    }


class LineScope:
    """Answers lines of SCPI from a dictionary; `damage` may change or swallow (b"") what goes out."""

    def __init__(self) -> None:
        self.identity = IDENTITY
        self.preamble = PREAMBLE
        # Every byte value occurs, line feeds and number signs too.
        self.codes = bytes(n * 7 % 256 for n in range(2500))
        self.settings = dict(SETTINGS)
        self.register = 0
        self.queue: list[str] = []
        self.lines: list[str] = []
        self.damage: Callable[[str, bytes], bytes] = lambda line, answer: answer
        self.forced: dict[str, str] = {}
        self.triggers = True
        self.hang_up_after: int | None = None

    def answer(self, line: str) -> bytes:
        self.lines.append(line)
        answers = []
        for part in (part.strip() for part in line.split(";")):
            try:
                answers += self._one(part.upper().lstrip(":"))
            except LookupError:
                self.register |= 32
                self.queue.append(f'113,"Undefined header; {part}"')
                return b""
        out = b";".join(answers) + b"\n" if answers else b""
        return self.damage(line, out)

    def _one(self, part: str) -> list[bytes]:
        if part == "*ESR?":
            register, self.register = self.register, 0
            return [str(register).encode()]
        if part == "ALLEV?":
            events, self.queue = self.queue or ['0,"No events to report : queue empty"'], []
            return [",".join(events).encode()]
        if part == "*IDN?":
            return [self.identity.encode()]
        if part in ("WFMPRE?", "WAVF?"):
            return [self._preamble()] + ([self._block()] if part == "WAVF?" and self._shown() else [])
        if part.endswith("?"):
            header = f":{part[:-1]} " if self.settings["HEADER"] == "1" else ""
            return [(header + self.settings[part[:-1].replace("ACQ:", "ACQUIRE:")]).encode()]
        self._command(part)
        return []

    def _command(self, part: str) -> None:
        if part == "*CLS":
            self.register, self.queue = 0, []
        if part in ("", "*CLS", "*WAI"):
            return
        name, value = part.split(" ", 1)
        name = {"ACQ:STOPA": "ACQUIRE:STOPAFTER", "STATE": "ACQUIRE:STATE"}.get(name, name)
        if name not in self.settings:
            raise LookupError(name)
        if value in ("ON", "OFF") and not name.startswith("CH"):
            value = "1" if value == "ON" else "0"
        if name == "ACQUIRE:STATE":
            value = {"RUN": "0" if self.triggers else "1", "STOP": "0"}.get(value, value)
            self.settings["BUSY"] = "0" if self.triggers or value == "0" else "1"
            self.settings["TRIGGER:STATE"] = "READY" if self.settings["BUSY"] == "1" else "SAVE"
        self.settings[name] = self.forced.get(name, value)

    def _shown(self) -> bool:
        return self.settings["SELECT:" + self.settings["DATA:SOURCE"]] == "1"

    def _preamble(self) -> bytes:
        if not self._shown():
            return b"1;8;BIN;RI;MSB"
        return self.preamble.replace("Ch1", self.settings["DATA:SOURCE"].capitalize()).encode()

    def _block(self) -> bytes:
        return b"#4%04d" % len(self.codes) + self.codes


class LineServer:
    """Serves a `LineScope` on a loopback TCP port, one client after the other."""

    def __init__(self, scope: LineScope) -> None:
        self.scope = scope
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._client: socket.socket | None = None
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    def resource_name(self) -> str:
        return f"TCPIP0::127.0.0.1::{self._listener.getsockname()[1]}::SOCKET"

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.hang_up()
        self._thread.join(5)

    def hang_up(self) -> None:
        if self._client is not None:
            with contextlib.suppress(OSError):
                self._client.shutdown(socket.SHUT_RDWR)

    def _serve(self) -> None:
        while True:
            try:
                self._client, _ = self._listener.accept()
            except OSError:
                return
            with self._client, contextlib.suppress(OSError):
                self._talk(self._client)

    def _talk(self, client: socket.socket) -> None:
        buffer = b""
        while data := client.recv(4096):
            *lines, buffer = (buffer + data).split(b"\n")
            for line in lines:
                out = self.scope.answer(line.decode())
                limit = self.scope.hang_up_after
                client.sendall(out if limit is None else out[:limit])
                if limit is not None and len(out) > limit:
                    return


class PtyPeer:
    """The other end of a serial line: answers each line that it reads, like any line server."""

    def __init__(self, answer: Callable[[bytes], bytes | None]) -> None:
        import tty

        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.name = f"ASRL{os.ttyname(self._slave)}::INSTR"
        self._answer = answer
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        buffer = b""
        while b"STOP" not in buffer:
            buffer += os.read(self.master, 1024)
            while b"\n" in buffer:
                line, buffer = buffer.split(b"\n", 1)
                os.write(self.master, self._answer(line) or b"")

    def close(self) -> None:
        os.write(self._slave, b"STOP")
        self._thread.join(5)
        os.close(self.master)
        os.close(self._slave)


@pytest.fixture
def peer() -> Iterator[Callable[[Callable[[bytes], bytes | None]], PtyPeer]]:
    made: list[PtyPeer] = []

    def make(answer):
        made.append(PtyPeer(answer))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.fixture
def line_scope() -> LineScope:
    return LineScope()


@pytest.fixture
def line_server(line_scope: LineScope) -> Iterator[LineServer]:
    server = LineServer(line_scope)
    yield server
    server.close()


@pytest.fixture
def manager() -> pyvisa.ResourceManager:
    """PyVISA-py, whatever other VISA the computer has."""
    return pyvisa.ResourceManager("@py")


@pytest.fixture(autouse=True)
def links_of_its_own(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A test finds no link of another one, which may run in another process, and leaves none in use.

    The number of a pseudo-terminal is given to the next one as soon as both its ends are closed: who opens a
    device that is gone would find a stranger there. So one end stays open until the test is over.
    """
    claims = tmp_path_factory.mktemp("claims")
    monkeypatch.setenv("GYROLOCK_LOCKS", str(claims))
    openpty, kept = getattr(os, "openpty", None), contextlib.ExitStack()

    def open_and_keep() -> tuple[int, int]:
        master, slave = openpty()
        kept.callback(os.close, os.dup(slave))
        return master, slave

    if openpty is not None:
        monkeypatch.setattr(os, "openpty", open_and_keep)
    with kept:
        yield
    until = time.monotonic() + 30  # what a test has started may still be ending
    while list(claims.iterdir()) and time.monotonic() < until:
        time.sleep(0.02)
    assert not list(claims.iterdir())


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A peer on this computer answers at once, so silence need not be waited for as long as at the bench."""
    monkeypatch.setattr("instrument.dialogue.link.ANSWER_TIME", 3.0)


@pytest.fixture
def bench_scope() -> SimulatedTDS2014:
    """The complete simulated scope: 1 kHz at channel 1 (0.8 V) and 2 (half of it), without noise."""

    def sine(times):
        return 0.8 * np.sin(2 * np.pi * 1000.0 * times)

    return SimulatedTDS2014({1: sine, 2: lambda t: 0.5 * sine(t)}, noise_levels=0.0, seed=3, faults=Faults(seed=5))


@pytest.fixture(params=["gpib", "tcp"] + ([] if sys.platform == "win32" else ["pty"]))
def bench(request, bench_scope, manager, impatient) -> Iterator[TDS2014]:
    """A driver on `bench_scope`: 0.5 V/div, 250 us/div, triggered on the rising edge of channel 1."""
    with contextlib.ExitStack() as stack:
        if request.param == "gpib":
            name = "GPIB0::1::INSTR"
            manager = resource_manager(scopes={name: bench_scope})
            stack.callback(manager.close)
        else:
            server = TcpServer(bench_scope) if request.param == "tcp" else PtyServer(bench_scope)
            name = stack.enter_context(server).resource_name
        driver = stack.enter_context(TDS2014(name, resource_manager=manager))
        for channel in (1, 2):
            driver.set_channel(channel, probe=1, scale=0.5, position=0.0)
        driver.set_timebase(2.5e-4)
        driver.set_trigger(source=1, level=0.1, slope="RISE")
        yield driver
