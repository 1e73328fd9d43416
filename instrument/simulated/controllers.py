"""Simulated instruments on lines of text, on a terminal or a TCP port: rate table, chamber, supply, transcript."""

import math
import threading
import time
from collections import defaultdict, deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from instrument.simulated.clock import Clock, RealClock
from instrument.simulated.links.stream_server import LOOK_UP, Port, StreamServer
from instrument.text_files import TranscriptExchange

_LONGEST = 4096


class LineDevice(Protocol):
    """What answers a line."""

    def answer(self, line: str) -> str | bytes | None:
        """Return the answer to a line, both without their ends; bytes are sent as they are; ``None``: none."""


class LineServer(StreamServer):
    """Serves a device until it is closed."""

    def __init__(self, device: LineDevice, *, tcp_port: int | None = None, end: str = "\r\n") -> None:
        super().__init__()
        self._device, self._end = device, end
        self._begun: dict[Port, bytes] = {}
        if tcp_port is None:
            self.resource_name = f"ASRL{self._open_terminal()}::INSTR"
        else:
            host, port = self._listen("127.0.0.1", tcp_port)
            self.resource_name = f"TCPIP0::{host}::{port}::SOCKET"
        self._thread.start()

    def _add(self, port: Port) -> None:
        self._begun[port] = b""
        super()._add(port)

    def _drop(self, port: Port) -> None:
        self._begun.pop(port, None)
        super()._drop(port)

    def _pause(self) -> float:
        return LOOK_UP

    def _serve(self, port: Port) -> None:
        now = time.monotonic()
        *lines, rest = (self._begun[port] + port.incoming.take(now)).replace(b"\r", b"\n").split(b"\n")
        self._begun[port] = rest[-_LONGEST:]
        for line in lines:
            text = line.decode("ascii", errors="replace").strip()
            if text and (answer := self._device.answer(text)) is not None:
                sent = answer if isinstance(answer, bytes) else (answer + self._end).encode("ascii")
                port.outgoing.put(sent, now)
        self._send(port, now)


class Replay:
    """Answers each message of a transcript with the bytes that came then."""

    # A message is looked for among those that have not been asked yet, in their order; asked more often than it
    # was then, it gets the last answer again. A message that the transcript does not have gets none.

    def __init__(self, exchanges: Sequence[TranscriptExchange]) -> None:
        self._answers: dict[str, deque[bytes]] = defaultdict(deque)
        for exchange in exchanges:
            self._answers[exchange.message.decode("ascii", errors="replace").strip()].append(exchange.answer)
        self.unknown: list[str] = []

    def answer(self, line: str) -> bytes | None:
        """Return what came behind the message."""
        known = self._answers.get(line)
        if not known:
            self.unknown.append(line)
            return None
        return known.popleft() if len(known) > 1 else known[0]


# --------------------
# The simulated rate table: it follows the commanded rate as fast as its acceleration allows. The azimuth is the
# exact integral of the rate, known for every time that has passed, so that a simulated gyro on the table can be
# evaluated at any of them

Floats = NDArray[np.float64]
_STEP_S = 0.05  # s that pass in one piece while the table comes to its rate


@dataclass(frozen=True)
class TableMotion:
    """A piece of the motion of a table, with constant acceleration."""

    start: float  # absolute time, s
    azimuth_deg: float  # at the start; the acceleration holds for the whole piece
    rate_dps: float
    acceleration_dps2: float = 0.0

    def azimuth_at(self, times: Floats) -> Floats:
        """Azimuth in deg, not folded into one turn, at absolute times in s."""
        elapsed = times - self.start
        return self.azimuth_deg + (self.rate_dps + 0.5 * self.acceleration_dps2 * elapsed) * elapsed

    def rate_at(self, times: Floats) -> Floats:
        """Rate in deg/s at absolute times in s."""
        return self.rate_dps + self.acceleration_dps2 * (times - self.start)


class SimulatedRateTable:
    """A rate table on a clock.

    Parameters
    ----------
    clock : Clock, optional
        RealClock() if not given; share it with the oscilloscope.
    acceleration : float
        Largest acceleration in deg/s^2; inf changes the rate at once.
    highest_rate : float
        Largest rate in deg/s.
    azimuth : float
        Azimuth in deg at the beginning.

    Examples
    --------
    >>> from instrument.simulated.clock import VirtualClock
    >>> clock = VirtualClock()
    >>> table = SimulatedRateTable(clock, acceleration=10.0)
    >>> table.set_rate(20.0)
    >>> clock.sleep(3.0)
    >>> table.rate(), table.azimuth()
    (20.0, 40.0)
    """

    def __init__(
        self,
        clock: Clock | None = None,
        *,
        acceleration: float = math.inf,
        highest_rate: float = 1000.0,
        azimuth: float = 0.0,
    ) -> None:
        if not acceleration > 0 or not highest_rate > 0:
            raise ValueError("a rate table needs a positive acceleration and a positive highest rate")
        self._clock: Clock = clock if clock is not None else RealClock()
        self._acceleration, self._highest_rate = acceleration, highest_rate
        self._lock = threading.Lock()
        self.motion: tuple[TableMotion, ...] = (TableMotion(self._clock.now(), azimuth, 0.0),)

    def set_rate(self, rate_dps: float) -> None:
        """Command a rate in deg/s; the table accelerates to it and stays there.

        Raises
        ------
        ValueError
            If the table cannot turn so fast.
        """
        if not abs(rate_dps) <= self._highest_rate:
            raise ValueError(
                f"the rate table turns at most {self._highest_rate:g} deg/s; {rate_dps:g} deg/s was asked for"
            )
        with self._lock:
            now = self._clock.now()
            passed = [piece for piece in self.motion if piece.start < now] or [self.motion[0]]
            azimuth, before = (float(at(np.array([now]))[0]) for at in (self.azimuth_at, self.rate_at))
            if rate_dps == before and passed[-1].acceleration_dps2 == 0:
                return
            slew_s = abs(rate_dps - before) / self._acceleration
            if slew_s > 0:
                passed.append(
                    TableMotion(now, azimuth, before, math.copysign(self._acceleration, rate_dps - before))
                )
            reached = azimuth + slew_s * (before + rate_dps) / 2
            # one assignment: the thread of the scope may be reading it
            self.motion = (*passed, TableMotion(now + slew_s, reached, float(rate_dps)))

    def wait_until_steady(self) -> None:
        """Let time pass on the clock until the table turns at the rate that was commanded."""
        steady = self.motion[-1].start
        while (left := steady - self._clock.now()) > 0:
            self._clock.sleep(min(left, _STEP_S) + 1e-9)

    def rate(self) -> float:
        """Rate in deg/s now."""
        return float(self.rate_at(np.array([self._clock.now()]))[0])

    def azimuth(self) -> float:
        """Azimuth in deg now, not folded into one turn."""
        return float(self.azimuth_at(np.array([self._clock.now()]))[0])

    def rate_at(self, times: Floats) -> Floats:
        """Rate in deg/s at absolute times in s, any shape; before the beginning it is the first rate."""
        elapsed, _, rate, acceleration = self._look_up(times)
        return np.asarray(rate + acceleration * elapsed)

    def azimuth_at(self, times: Floats) -> Floats:
        """Azimuth in deg at absolute times in s, any shape."""
        elapsed, azimuth, rate, acceleration = self._look_up(times)
        return np.asarray(azimuth + (rate + acceleration / 2 * elapsed) * elapsed)

    def close(self) -> None:
        """Leave the table as it is."""

    def _look_up(self, times: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Time since the start of the piece of each time, and what that piece begins with."""
        start, azimuth, rate, acceleration = np.array([list(vars(piece).values()) for piece in self.motion]).T
        times = np.asarray(times, dtype=np.float64)
        index = np.maximum(np.searchsorted(start, times, side="right") - 1, 0)
        return times - start[index], azimuth[index], rate[index], acceleration[index]


# --------------------
# The controller of the simulated rate table: the language of ``config/controllers/rate_table.toml``


class RateTableController:
    """Answers lines: ``RATE 3.5`` sets deg/s, ``RATE?`` and ``POSITION?`` read, ``STOP`` stops."""

    # An order is answered by OK or by ERR and a reason, which ``ERROR?`` repeats.

    def __init__(self, table: SimulatedRateTable, name: str = "GYROLOCK RATE TABLE, SIM-1, 1.0") -> None:
        self._table, self._name = table, name
        self._enabled = False
        self._error = ""
        self.lines: list[str] = []
        """Orders, in the order in which they came."""

    def answer(self, line: str) -> str | None:
        """Carry out a line."""
        word, _, rest = line.upper().partition(" ")
        if word == "ID?":
            return self._name
        if word == "ERROR?":
            error, self._error = self._error or "0", ""
            return error
        if word == "RATE?":
            return f"RATE {self._table.rate():.6f}"
        if word == "POSITION?":
            return f"POSITION {self._table.azimuth() % 360.0:.4f}"
        self.lines.append(line)
        self._error = self._carry_out(word, rest)
        return f"ERR {self._error}" if self._error else "OK"

    def _carry_out(self, word: str, rest: str) -> str:
        """Carry out an order; why not, or nothing."""
        if word == "ENABLE":
            self._enabled = True
        elif word in ("STOP", "HOME"):
            self._table.set_rate(0.0)
        elif word == "RATE":
            return self._turn(rest)
        else:
            return f"no such command {word}"
        return ""

    def _turn(self, text: str) -> str:
        try:
            rate = float(text)
        except ValueError:
            rate = math.nan
        if not math.isfinite(rate):
            return f"{text} is no rate"
        if not self._enabled:
            return "the drive is not enabled"
        try:
            self._table.set_rate(rate)
        except ValueError as error:
            return str(error)
        return ""


# --------------------
# A simulated temperature chamber that speaks the commands of ``config/controllers/chamber.toml``


class SimulatedChamber:
    """A chamber whose air comes to the set point at a constant rate."""

    _LOWEST, _HIGHEST = -70.0, 150.0

    def __init__(
        self, clock: Clock | None = None, *, ambient_degc: float = 23.0, speed_degc_per_s: float = 0.05
    ) -> None:
        self._clock: Clock = clock if clock is not None else RealClock()
        self._from, self._since, self._to = ambient_degc, self._clock.now(), ambient_degc
        self._speed, self._set, self.on = speed_degc_per_s, ambient_degc, False

    @property
    def temperature(self) -> float:
        """Temperature now, deg C."""
        left = self._to - self._from
        gone = min(abs(left), self._speed * (self._clock.now() - self._since))
        return self._from + math.copysign(gone, left)

    def answer(self, line: str) -> str | None:
        """Carry out a line."""
        text = line.upper().replace(" ", "")
        if text == "TYPE?":
            return "T,T,S2,150.0"
        if text == "TEMP?":
            return f"{self.temperature:.1f},{self._set:.1f},{self._HIGHEST:.1f},{self._LOWEST:.1f}"
        if text.startswith("TEMP,S"):
            try:
                wanted = float(text.removeprefix("TEMP,S"))
            except ValueError:
                return f"NA:PARAERR:{line}"
            if not self._LOWEST <= wanted <= self._HIGHEST:
                return f"NA:DATAOUTOFRANGE:{line}"
            self._set = wanted
            if self.on:
                self._begin(wanted)
            return f"OK:{line}"
        if text in ("MODE,CONSTANT", "MODE,STANDBY"):
            self.on = text.endswith("CONSTANT")
            self._begin(self._set if self.on else self.temperature)
            return f"OK:{line}"
        return f"NA:CMDERR:{line}"

    def _begin(self, wanted: float) -> None:
        self._from, self._since, self._to = self.temperature, self._clock.now(), wanted


# --------------------
# A simulated power supply that speaks SCPI, as ``config/controllers/power_supply.toml`` asks


class SimulatedPowerSupply:
    """A supply with a resistance as its load."""

    def __init__(self, *, highest_v: float = 36.0, load_ohm: float = 48.0) -> None:
        self._highest, self._load = highest_v, load_ohm
        self._errors: list[str] = []
        self.set_v, self.on = 0.0, False

    @property
    def voltage(self) -> float:
        """Voltage at the terminals."""
        return self.set_v if self.on else 0.0

    def answer(self, line: str) -> str | None:
        """Carry out a line."""
        word, _, rest = line.upper().partition(" ")
        questions = {
            "*IDN?": "GYROLOCK,SIMULATED SUPPLY,SIM-2,1.0",
            "MEAS:VOLT?": f"{self.voltage:+.5E}",
            "MEAS:CURR?": f"{self.voltage / self._load:+.5E}",
        }
        if word in questions:
            return questions[word]
        if word == "SYST:ERR?":
            return self._errors.pop(0) if self._errors else '+0,"No error"'
        if word == "OUTP" and rest in ("ON", "OFF"):
            self.on = rest == "ON"
        elif word == "VOLT":
            self._set(rest)
        else:
            self._errors.append('-113,"Undefined header"')
        return None

    def _set(self, text: str) -> None:
        try:
            wanted = float(text)
        except ValueError:
            wanted = math.nan
        if 0 <= wanted <= self._highest:
            self.set_v = wanted
        else:
            self._errors.append('-222,"Data out of range"')
