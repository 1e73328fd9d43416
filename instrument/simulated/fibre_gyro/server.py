"""A simulated fibre gyro behind a serial port: any source of numbers, served as a gyro would send them.

What the numbers mean is the model's affair. Here they become frames, at the rate of the format, with the faults of
a real line; commands that arrive are handed to the model and answered.
"""

from __future__ import annotations

import contextlib
import math
import os
import selectors
import socket
import threading
import time
from collections.abc import Mapping
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from instrument.fibre_gyro.frame_format import FrameFormat
from instrument.fibre_gyro.messages import compose
from instrument.simulated.fibre_gyro.faults import GyroFaults
from instrument.simulated.fibre_gyro.frames import CommandReader, encode_frame

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


class _GyroServer:
    """Runs the gyro in a thread until it is closed.

    Attributes
    ----------
    port : str
        What `FibreGyroLink` opens.
    faults : GyroFaults
    frames_made : int
        Outputs that the model was asked for.
    commands : list of (str, float)
        Name and step of every command that was carried out.
    """

    port = ""

    def __init__(
        self, model: GyroModel, layout: FrameFormat, *, speed: float = 1.0, faults: GyroFaults | None = None
    ) -> None:
        if not speed > 0:
            raise ValueError(f"the speed of a simulated gyro must be positive, not {speed:g}")
        self.layout, self.speed = layout, speed
        self.faults = faults if faults is not None else GyroFaults()
        self.frames_made = 0
        self.commands: list[tuple[str, float]] = []
        self.error: BaseException | None = None
        self._model = model
        self._reader = CommandReader(layout)
        self._counter = self._silent_frames = self._commands_seen = 0
        self._unsent = bytearray()
        self._selector = selectors.DefaultSelector()
        self._wake_out, self._wake_in = socket.socketpair()
        self._selector.register(self._wake_out, selectors.EVENT_READ)
        self._closing = False
        self._began = time.monotonic()
        self._thread = threading.Thread(target=self._run, name=type(self).__name__, daemon=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Hang up and stop; a second call does nothing. Raises what the model raised, if it did."""
        if not self._closing:
            self._closing = True
            with contextlib.suppress(OSError):  # the thread may have ended by itself
                self._wake_in.send(b"x")
            self._thread.join()
            self._wake_in.close()
            if self.error is not None:
                raise self.error

    # ------------------------------------------------------------------ what a transport provides

    def _descriptor(self) -> int | None:
        """Where bytes go and come; None while nobody is connected."""
        raise NotImplementedError

    def _receive(self) -> bytes:
        raise NotImplementedError

    def _send(self, data: bytes) -> int:
        raise NotImplementedError

    def _hang_up(self) -> None:
        """The client is gone."""

    def _release(self) -> None:
        """The server ends."""

    # ------------------------------------------------------------------ the loop

    def _run(self) -> None:
        try:
            while not self._closing:
                self._make_frames()
                self._wait()
        except BaseException as error:  # a model that fails must not look like a silent gyro
            self.error = error
        finally:
            self._release()
            self._selector.close()
            self._wake_out.close()

    def _wait(self) -> None:
        descriptor = self._descriptor()
        self._flush()
        behind = self._due() > 0
        for key, _ in self._selector.select(0.0 if behind else _PACE_S):
            if key.fd == descriptor:
                self._take_commands()
            elif key.data is not None:
                key.data()

    def _due(self) -> int:
        """Frames to be made now."""
        if math.isinf(self.speed):
            return _AT_ONCE if self._descriptor() is not None and len(self._unsent) < _FULL else 0
        passed = (time.monotonic() - self._began) * self.speed * self.layout.output_rate_hz
        return int(passed) - self.frames_made

    def _make_frames(self) -> None:
        count = min(self._due(), _AT_ONCE)
        if count <= 0:
            return
        columns = {name: np.asarray(column, float) for name, column in self._model.samples(count).items()}
        for place in range(count):
            values = {name: float(column[place]) for name, column in columns.items()}
            data = self._frame(values)
            # Nobody reads: bytes are lost as a real line loses them, but never half a frame of ours.
            if len(self._unsent) < _FULL or math.isinf(self.speed):
                self._unsent += data

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

    # ------------------------------------------------------------------ commands

    def _take_commands(self) -> None:
        try:
            data = self._receive()
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._unsent.clear()
            self._hang_up()
            return
        for name, number in self._reader.feed(data):
            self._obey(name, number)

    def _obey(self, name: str, number: int) -> None:
        kinds = {fault.kind for fault in self.faults.hits_command(self._commands_seen)}
        self._commands_seen += 1
        if "lost command" in kinds:
            return
        accepted = "refusal" not in kinds and self._tell_model(name, number / self.layout.step_scale)
        answer = self.layout.accepted if accepted else self.layout.refused
        if answer is not None and "lost answer" not in kinds:
            self._unsent += compose(answer, number, self.layout.check)

    def _tell_model(self, name: str, step: float) -> bool:
        try:
            self._model.command(name, step)
        except ValueError:
            return False
        self.commands.append((name, step))
        return True

    def _flush(self) -> None:
        if not self._unsent or self._descriptor() is None:
            return
        try:
            sent = self._send(bytes(self._unsent))
        except BlockingIOError:
            return
        except OSError:
            self._unsent.clear()
            self._hang_up()
            return
        del self._unsent[:sent]


class PtyGyroServer(_GyroServer):
    """Serves a gyro on a pseudo-terminal, which programs open like a serial port.

    Parameters
    ----------
    model : GyroModel
    layout : FrameFormat
        From `parse_frame_format`.
    speed : float
        Seconds of the gyro's time in one second; inf: as fast as it is read.
    faults : GyroFaults, optional

    Raises
    ------
    OSError
        If this system has no pseudo-terminals (Windows).
    """

    def __init__(
        self, model: GyroModel, layout: FrameFormat, *, speed: float = 1.0, faults: GyroFaults | None = None
    ) -> None:
        try:
            import tty
        except ImportError:
            raise OSError("this system has no pseudo-terminals; serve the gyro on TCP instead") from None
        super().__init__(model, layout, speed=speed, faults=faults)
        self._master, self._slave = os.openpty()  # the slave end stays open, so that clients may come and go
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self._selector.register(self._master, selectors.EVENT_READ)
        self._thread.start()

    def _descriptor(self) -> int | None:
        return self._master

    def _receive(self) -> bytes:
        return os.read(self._master, 4096)

    def _send(self, data: bytes) -> int:
        return os.write(self._master, data)

    def _release(self) -> None:
        os.close(self._slave)
        os.close(self._master)


class TcpGyroServer(_GyroServer):
    """Serves a gyro on a TCP port, as behind a serial-to-Ethernet adapter; one client at a time.

    Parameters
    ----------
    model, layout, speed, faults
        As for `PtyGyroServer`.
    host : str
        Address to listen on; only this computer unless told otherwise.
    tcp_port : int
        0 takes any free one.

    Raises
    ------
    OSError
        If the port cannot be had.
    """

    def __init__(
        self,
        model: GyroModel,
        layout: FrameFormat,
        *,
        host: str = "127.0.0.1",
        tcp_port: int = 0,
        speed: float = 1.0,
        faults: GyroFaults | None = None,
    ) -> None:
        self._client: socket.socket | None = None
        self._listener = socket.create_server((host, tcp_port))
        super().__init__(model, layout, speed=speed, faults=faults)
        self._listener.setblocking(False)
        self.port = "socket://{}:{}".format(*self._listener.getsockname()[:2])
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)
        self._thread.start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            client, _ = self._listener.accept()
            if self._client is not None and not self._has_hung_up(self._client):
                client.close()
                return
            self._hang_up()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._unsent.clear()
            self._client = client
            self._selector.register(client, selectors.EVENT_READ)

    @staticmethod
    def _has_hung_up(client: socket.socket) -> bool:
        try:
            return client.recv(1, socket.MSG_PEEK) == b""
        except BlockingIOError:
            return False
        except OSError:
            return True

    def _descriptor(self) -> int | None:
        return None if self._client is None else self._client.fileno()

    def _receive(self) -> bytes:
        return b"" if self._client is None else self._client.recv(4096)

    def _send(self, data: bytes) -> int:
        return 0 if self._client is None else self._client.send(data)

    def _hang_up(self) -> None:
        if self._client is not None:
            self._selector.unregister(self._client)
            self._client.close()
            self._client = None

    def _release(self) -> None:
        self._hang_up()
        self._listener.close()
