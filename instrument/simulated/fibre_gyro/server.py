"""A simulated fibre gyro behind a serial port: any source of numbers, served as a gyro would send them.

What the numbers mean is the model's affair. Here they become frames, at the rate of the format, with the faults of
a real line; commands that arrive are handed to the model and answered.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from instrument.fibre_gyro.frame_format import FrameFormat
from instrument.fibre_gyro.frame_format.messages import compose
from instrument.simulated.fibre_gyro.faults import GyroFaults
from instrument.simulated.fibre_gyro.frames import POLL, CommandReader, encode_frame
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
