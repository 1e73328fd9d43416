"""A TCP link with faults: spoils messages in both directions, and can be unplugged.

What arrives in one piece counts as one message; a program and a scope that take turns send it so.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable

import numpy as np

KINDS = ("drop", "lose a byte", "insert", "duplicate", "corrupt", "truncate", "late", "twice", "garbage")
"""What can happen to a message; the second and the fourth concern one byte of it."""

LATE = 1.0
"""Delay of a late message in s; what follows it does not wait."""

_LOOK_UP = 0.05  # s


def spoil(kind: str, message: bytes, rng: np.random.Generator) -> list[bytes]:
    """What becomes of a message: the pieces that arrive. A late one is as it was."""
    at = int(rng.integers(len(message)))
    match kind:
        case "drop":
            return []
        case "lose a byte":
            return [message[:at] + message[at + 1 :]]
        case "insert":
            return [message[:at] + rng.bytes(1) + message[at:]]
        case "duplicate":
            return [message[: at + 1] + message[at:]]
        case "corrupt":
            other = (message[at] + int(rng.integers(1, 256))) % 256
            return [message[:at] + bytes([other]) + message[at + 1 :]]
        case "truncate":
            return [message[:at]]
        case "twice":
            return [message, message]
        case "garbage":
            return [rng.bytes(len(message))]
        case _:
            return [message]


class FaultProxy:
    """Stands between a program and a server on this computer; a context manager.

    Parameters
    ----------
    port : int
        Port of the server; may be changed when the server has another one.
    share : float
        Share of the messages that are spoiled, in each direction.
    kinds : tuple of str, optional
        Those of `KINDS` that happen.
    late : float, optional
        Delay of late messages in s.

    Attributes
    ----------
    happened : Counter
        How often each kind happened.
    unplugged : bool
        No byte passes, as with a pulled cable: nobody is told.
    """

    def __init__(
        self, port: int, share: float, *, seed: int = 0, kinds: tuple[str, ...] = KINDS, late: float = LATE
    ) -> None:
        self.port, self.share = port, share
        self.happened: Counter[str] = Counter()
        self.messages = 0
        self.unplugged = False
        self._kinds, self._late, self._seed = kinds, late, seed
        self._closing = False
        self._lock = threading.Lock()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(_LOOK_UP)
        self._threads: list[threading.Thread] = []
        self._sockets: list[socket.socket] = []
        self._connections = 0
        self._start(self._accept)

    def __enter__(self) -> FaultProxy:
        return self

    def __exit__(self, *_: object) -> None:
        self._closing = True
        self.hang_up()
        for thread in list(self._threads):
            thread.join(5)
        self._listener.close()

    @property
    def resource_name(self) -> str:
        """VISA resource name of the program's side."""
        return f"TCPIP0::127.0.0.1::{self._listener.getsockname()[1]}::SOCKET"

    def hang_up(self) -> None:
        """End every connection."""
        for end in list(self._sockets):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def _start(self, target: Callable[[], None]) -> None:
        thread = threading.Thread(target=target, daemon=True)
        self._threads = [one for one in self._threads if one.is_alive()] + [thread]
        thread.start()

    def _accept(self) -> None:
        while not self._closing:
            try:
                client, _ = self._listener.accept()
            except TimeoutError:
                continue
            try:
                server = socket.create_connection(("127.0.0.1", self.port), 5)
            except OSError:
                client.close()
                continue
            self._connections += 1
            for place, (source, target) in enumerate(((client, server), (server, client))):
                target.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                source.settimeout(_LOOK_UP)
                rng = np.random.default_rng([self._seed, self._connections, place])
                self._sockets.append(source)
                self._start(lambda source=source, target=target, rng=rng: self._pass_on(source, target, rng))

    def _pass_on(self, source: socket.socket, target: socket.socket, rng: np.random.Generator) -> None:
        with contextlib.suppress(OSError):
            while not self._closing:
                try:
                    message = source.recv(65_536)
                except TimeoutError:
                    continue
                if not message:
                    break
                if not self.unplugged:
                    self._deliver(message, target, rng)
        for end in (source, target):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
        if source in self._sockets:
            self._sockets.remove(source)
        source.close()

    def _deliver(self, message: bytes, target: socket.socket, rng: np.random.Generator) -> None:
        kind = ""
        if rng.random() < self.share:
            kind = self._kinds[int(rng.integers(len(self._kinds)))]
        with self._lock:
            self.messages += 1
            self.happened.update([kind] if kind else [])
        if kind == "late":
            self._start(lambda: self._deliver_late(message, target))
            return
        for piece in spoil(kind, message, rng):
            target.sendall(piece)

    def _deliver_late(self, message: bytes, target: socket.socket) -> None:
        time.sleep(self._late)
        with contextlib.suppress(OSError):
            target.sendall(message)
