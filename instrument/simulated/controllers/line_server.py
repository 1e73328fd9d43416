"""Serves a device that answers lines of text on a pseudo-terminal or a TCP port."""

from __future__ import annotations

import time
from typing import Protocol

from instrument.simulated.links.stream_server import LOOK_UP, Port, StreamServer

_LONGEST = 4096


class LineDevice(Protocol):
    """What answers a line."""

    def answer(self, line: str) -> str | None:
        """Return the answer to a line, both without their ends; ``None`` where there is none."""


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
                port.outgoing.put((answer + self._end).encode("ascii"), now)
        self._send(port, now)
