"""A simulated fibre gyro behind a serial port: any source of numbers, served as a gyro would send them.

What the numbers mean is the model's affair. Here they become frames, at the rate of the format, with the faults of
a real line; commands that arrive are handed to the model and answered.
"""

from __future__ import annotations

import math
import re
import struct
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike

from instrument.fibre_gyro.frame_fields import COUNTER, FIXED, PARITY, STATUS, UNUSED, Field
from instrument.fibre_gyro.frame_format import FrameFormat, Message, compose
from instrument.simulated.links.stream_server import Port, StreamServer

_PACE_S = 0.005  # s of real time whose frames are sent in one piece
_AT_ONCE = 64  # frames made in one piece at most: commands take effect between two pieces
_FULL = 4096  # bytes that wait for a reader; a real gyro does not wait for one


class GyroModel(Protocol):
    """Where the numbers come from."""

    def samples(self, count: int) -> Mapping[str, ArrayLike]:
        """The next `count` outputs, one array of numbers for each field of the frames, "counts" among them."""

    def command(self, name: str, step: float) -> None:
        """Do what was commanded, from the next output on; ValueError refuses.

        `name` is "inject" (with the `step` in codes per transit time), "close_loop", "open_loop" or
        "hold_feedback".
        """


class GyroServer(StreamServer):
    """A gyro that makes its frames in time, whether they are read or not, or one for each poll."""

    port = ""  # what `FibreGyroLink` opens

    def __init__(
        self,
        model: GyroModel,
        layout: FrameFormat,
        *,
        speed: float = 1.0,
        faults: GyroFaults | None = None,
        clock_ppm: float = 0.0,
    ) -> None:
        if not speed > 0:
            raise ValueError(f"the speed of a simulated gyro must be positive, not {speed:g}")
        super().__init__()
        self.layout, self.speed = layout, speed
        self._rate_hz = layout.output_rate_hz * (1 + 1e-6 * clock_ppm)
        self.faults = faults if faults is not None else GyroFaults()
        self.frames_made = 0
        self.commands: list[tuple[str, float]] = []
        self._model = model
        self._reader = CommandReader(layout)
        self._counter = self._silent_frames = self._commands_seen = 0
        self._began = time.monotonic()

    @property
    def unsent(self) -> int:
        """Bytes that wait for their reader."""
        return sum(len(port.outgoing) for port in self._ports)

    # The line

    def _welcomes(self) -> bool:
        """One client at a time; whether the one before has hung up, reading from it tells."""
        for port in list(self._ports):
            self._read(port)
        return not self._ports

    def _serve(self, port: Port) -> None:
        now = time.monotonic()
        for name, number in self._reader.feed(port.incoming.take(now)):
            self._obey(port, name, number)
        self._send(port, now)

    def _pause(self) -> float:
        return 0.0 if self.layout.poll is None and self._due() > 0 else _PACE_S

    # Frames

    def _advance(self) -> None:
        if self.layout.poll is None and (count := min(self._due(), _AT_ONCE)) > 0:
            self._make_frames(count)
        super()._advance()

    def _make_frames(self, count: int) -> None:
        columns = {name: np.asarray(column, float) for name, column in self._model.samples(count).items()}
        for place in range(count):
            data = self._frame({name: float(column[place]) for name, column in columns.items()})
            for port in self._ports:
                # Nobody reads: bytes are lost as a real line loses them, but never half a frame of ours.
                if len(port.outgoing) < _FULL or math.isinf(self.speed):
                    port.outgoing.put(data, time.monotonic())

    def _due(self) -> int:
        """Frames to be made now."""
        if math.isinf(self.speed):
            return _AT_ONCE if self._ports and self.unsent < _FULL else 0
        passed = (time.monotonic() - self._began) * self.speed * self._rate_hz
        return int(passed) - self.frames_made

    def _frame(self, values: Mapping[str, float]) -> bytes:
        met = self.faults.hits_frame(self.frames_made)
        self.frames_made += 1
        per_frame = self.layout.counter.per_frame if self.layout.counter is not None else 1
        self._counter += per_frame + sum(fault.amount for fault in met if fault.kind == "counter jump")
        data = encode_frame(self.layout, self._counter - per_frame, values)
        for fault in met:
            if fault.kind in ("silence", "lost frame"):
                self._silent_frames = max(self._silent_frames, fault.amount)
            elif fault.kind != "counter jump":
                data = self.faults.spoil(data, fault)
        if self._silent_frames:
            self._silent_frames -= 1
            return b""
        return data

    # Commands

    def _obey(self, port: Port, name: str, number: int) -> None:
        if name == POLL:
            self._make_frames(1)
            return
        kinds = {fault.kind for fault in self.faults.hits_command(self._commands_seen)}
        self._commands_seen += 1
        if "lost command" in kinds:
            return
        accepted = "refusal" not in kinds and self._tell_model(name, number / self.layout.step_scale)
        answer = self.layout.accepted if accepted else self.layout.refused
        if answer is not None and "lost answer" not in kinds:
            port.outgoing.put(compose(answer, number, self.layout.check), time.monotonic())

    def _tell_model(self, name: str, step: float) -> bool:
        try:
            self._model.command(name, step)
        except ValueError:
            return False
        self.commands.append((name, step))
        return True


class PtyGyroServer(GyroServer):
    """Serves a gyro on a pseudo-terminal, which programs open like a serial port."""

    def __init__(
        self,
        model: GyroModel,
        layout: FrameFormat,
        *,
        speed: float = 1.0,
        faults: GyroFaults | None = None,
        clock_ppm: float = 0.0,
    ) -> None:
        super().__init__(model, layout, speed=speed, faults=faults, clock_ppm=clock_ppm)
        self.port = self._open_terminal()
        self._thread.start()


class TcpGyroServer(GyroServer):
    """Serves a gyro on a TCP port, as behind a serial-to-Ethernet adapter; one client at a time."""

    def __init__(
        self,
        model: GyroModel,
        layout: FrameFormat,
        *,
        host: str = "127.0.0.1",
        tcp_port: int = 0,
        speed: float = 1.0,
        faults: GyroFaults | None = None,
        clock_ppm: float = 0.0,
    ) -> None:
        super().__init__(model, layout, speed=speed, faults=faults, clock_ppm=clock_ppm)
        self.port = "socket://{}:{}".format(*self._listen(host, tcp_port))
        self._thread.start()


# --------------------
# The sending side of a fibre gyro's link: frames out of numbers, commands out of bytes


_MOST_UNREAD = 4096  # bytes that no command is long enough for
POLL = "poll"  # name of the command that asks for a frame


def encode_frame(layout: FrameFormat, counter: int, values: Mapping[str, float]) -> bytes:
    """The bytes of one frame."""
    if layout.kind == "ascii":
        words = [_written(entry, _number(layout, entry, counter, values)) for entry in layout.fields]
        body = layout.header + layout.separator.join(words)
    else:
        body = _packed(layout, counter, values)
    if layout.check is not None:
        body += layout.check.mark
        body += layout.check.of_frame(body, binary=layout.kind == "binary")
    return body + layout.ending


def _packed(layout: FrameFormat, counter: int, values: Mapping[str, float]) -> bytes:
    body = layout.header
    word = bits = 0
    parity: tuple[int, bool] | None = None
    for entry in layout.fields:
        if not entry.bits:
            if entry.check is not None:
                covered = body[len(layout.header) :]
                body += entry.check.compute(covered).to_bytes(entry.size, entry.byte_order)
            else:
                body += _bytes_of(entry, _number(layout, entry, counter, values))
            continue
        word, bits = word << entry.bits, bits + entry.bits
        if entry.name == PARITY:
            parity = (bits, entry.kind == "odd")
        else:
            word |= _whole(entry, _number(layout, entry, counter, values))
        if bits % 8 == 0:
            if parity is not None and word.bit_count() % 2 != parity[1]:
                word |= 1 << (bits - parity[0])
            body += word.to_bytes(bits // 8, entry.byte_order)
            word, bits, parity = 0, 0, None
    return body


def _number(layout: FrameFormat, entry: Field, counter: int, values: Mapping[str, float]) -> float:
    rule = layout.counter
    if entry.name == COUNTER and rule is not None:
        return rule.first + counter % rule.modulus
    if entry.name == STATUS:
        return values.get(STATUS, layout.status.value)
    if entry.name == FIXED:
        return entry.expected
    if entry.cycle and rule is not None:
        return _in_turn(entry, (rule.first + counter % rule.modulus) % entry.cycle, values)
    return 0.0 if entry.name == UNUSED else (values.get(entry.name, 0.0) - entry.offset) / entry.scale


def _in_turn(entry: Field, phase: int, values: Mapping[str, float]) -> int:
    """What a field holds whose quantities take turns."""
    for quantity in entry.quantities:
        if phase in quantity.phases:
            good = quantity.status.value if quantity.status is not None else quantity.offset
            number = (values.get(quantity.name, good) - quantity.offset) / quantity.scale
            if quantity.kind == "float":
                whole = int.from_bytes(struct.pack("<f", number), "little")
            else:
                whole = round(number) & ((1 << 8 * entry.size * len(quantity.phases)) - 1)
            return whole >> (8 * entry.size * quantity.phases.index(phase)) & ((1 << 8 * entry.size) - 1)
    return 0


def _written(entry: Field, number: float) -> bytes:
    whole = number == int(number)
    if entry.kind == "hex":
        return b"%02X" % int(number)
    if entry.decimals is not None:
        return f"{number:.{entry.decimals}f}".encode("ascii")
    return b"%d" % int(number) if whole else repr(float(number)).encode("ascii")


def _bytes_of(entry: Field, number: float) -> bytes:
    if entry.kind == "float":
        packed = struct.pack("<f" if entry.size == 4 else "<d", number)
        return bytes(packed[rank] for rank in entry.significance)
    whole, keep = _whole(entry, number), (1 << entry.data_bits) - 1
    return bytes(whole >> (entry.data_bits * rank) & keep for rank in entry.significance)


def _whole(entry: Field, number: float) -> int:
    """A whole number as the bits that carry it."""
    span = 1 << entry.carried_bits
    lowest = -span // 2 if entry.kind == "signed" else 0
    if not lowest <= round(number) < lowest + span:
        width = f"{entry.bits} bits" if entry.bits else f"{entry.size} bytes"
        raise ValueError(f"{number:g} does not fit into the {width} of {entry.name}")
    return round(number) % span


class CommandReader:
    """Finds the commands of a format in what a computer sends."""

    def __init__(self, layout: FrameFormat) -> None:
        self._layout = layout
        self._messages = dict(layout.commands)
        if layout.poll is not None:
            self._messages[POLL] = layout.poll
        self._patterns = {name: _pattern(message, layout) for name, message in self._messages.items()}
        self._buffer = b""

    def feed(self, data: bytes) -> list[tuple[str, int]]:
        """Take bytes; returns name and number of every whole and undamaged command, in their order."""
        self._buffer = (self._buffer + data)[-_MOST_UNREAD:]
        found: list[tuple[str, int]] = []
        while True:
            matches = [(name, pattern.search(self._buffer)) for name, pattern in self._patterns.items()]
            hits = [(match.start(), name, match) for name, match in matches if match is not None]
            if not hits:
                return found
            _, name, match = min(hits, key=lambda hit: hit[0])
            number = self._value(name, match)
            # What only looked like a command is passed over by its first byte.
            self._buffer = self._buffer[match.start() + 1 if number is None else match.end() :]
            if number is not None:
                found.append((name, number))

    def _value(self, name: str, match: re.Match[bytes]) -> int | None:
        message = self._messages[name]
        spelled = match.groupdict().get("step", b"0")
        number = int.from_bytes(spelled, message.byte_order, signed=True) if message.binary else int(spelled)
        if not message.has_step:
            number = 0
        return number if compose(message, number, self._layout.check) == match[0] else None


def _pattern(message: Message, layout: FrameFormat) -> re.Pattern[bytes]:
    pattern = b""
    for part in message.parts:
        if isinstance(part, bytes):
            pattern += re.escape(part)
        elif part == "step":
            size = message.step_format.encode("ascii")
            pattern += b"(?P<step>.{" + size + b"})" if message.binary else rb"(?P<step>[+-]?\d{1,19})"
        elif part == "checksum" and layout.check is not None:
            size = b"%d" % (layout.check.size if message.binary else 2 * layout.check.size)
            pattern += b".{" + size + b"}"
    return re.compile(pattern, re.DOTALL)


# --------------------
# What can happen to the frames and commands of a simulated fibre gyro, on demand


FrameFaultKind = Literal["lost byte", "inserted byte", "flipped bit", "lost frame", "counter jump", "silence"]
CommandFaultKind = Literal["lost command", "lost answer", "refusal"]

_COMMAND_KINDS = ("lost command", "lost answer", "refusal")


@dataclass(frozen=True)
class GyroFault:
    """One fault and the frames, or commands, that it meets."""

    # "lost byte", "inserted byte", "flipped bit" at a random place of the frame; "lost frame": it is not sent;
    # "counter jump": the counter goes on from somewhere else, nothing is lost; "silence": the gyro measures on but
    # nothing of it is sent. "lost command", "lost answer", "refusal" meet a command instead.
    kind: FrameFaultKind | CommandFaultKind
    # number of the frame, or command, counted from 0 since the server began. None: any.
    number: int | None = None
    # chance that one that fits is hit. A fault with a number, or with probability 1, happens once.
    probability: float = 1.0
    # bytes, bits or frames that are lost, inserted or flipped; ticks that the counter jumps; frames of silence
    amount: int = 1


class GyroFaults:
    """The faults of one simulated gyro; `add` them at any time, also while it is served."""

    def __init__(self, *faults: GyroFault, seed: int = 0) -> None:
        self._armed = list(faults)
        self._rng = np.random.default_rng(seed)
        self._lock = threading.Lock()
        self.happened: list[tuple[int, GyroFault]] = []

    def add(self, fault: GyroFault) -> GyroFaults:
        """Arm one more fault; returns itself."""
        with self._lock:
            self._armed.append(fault)
        return self

    def clear(self) -> None:
        """Disarm every fault that has not happened yet."""
        with self._lock:
            self._armed.clear()

    def hits_frame(self, number: int) -> list[GyroFault]:
        """What happens to a frame."""
        return self._hits(number, commands=False)

    def hits_command(self, number: int) -> list[GyroFault]:
        """What happens to a command."""
        return self._hits(number, commands=True)

    def spoil(self, data: bytes, fault: GyroFault) -> bytes:
        """A frame with bytes lost or inserted or bits flipped."""
        damaged = bytearray(data)
        for _ in range(min(fault.amount, len(data))):
            at = int(self._rng.integers(len(damaged)))
            if fault.kind == "lost byte":
                del damaged[at]
            elif fault.kind == "inserted byte":
                damaged.insert(at, int(self._rng.integers(256)))
            elif fault.kind == "flipped bit":
                damaged[at] ^= 1 << int(self._rng.integers(8))
        return bytes(damaged)

    def _hits(self, number: int, *, commands: bool) -> list[GyroFault]:
        with self._lock:
            met = [
                fault
                for fault in self._armed
                if (fault.kind in _COMMAND_KINDS) == commands
                and fault.number in (None, number)
                and (fault.probability >= 1 or self._rng.random() < fault.probability)
            ]
            for fault in met:
                self.happened.append((number, fault))
                if fault.number is not None or fault.probability >= 1:
                    self._armed.remove(fault)
            return met
