"""A TCP socket that notices what PyVISA-py waits over."""

from __future__ import annotations

import math
import socket
import time


class HungUp(ConnectionError):
    """The other side has closed the connection."""


class Overdue(Exception):
    """Bytes go on coming one by one, and not all that were asked for are there in time."""


class WatchfulSocket(socket.socket):
    """A socket that notices what PyVISA-py waits over: the other side's hanging up, and its trickling."""

    _ends_at = math.inf
    _looked_behind = False

    def patience(self, seconds: float) -> None:
        """Let one read take so long in all."""
        self._ends_at, self._looked_behind = time.monotonic() + seconds, False

    def recv(self, bufsize: int, flags: int = 0, /) -> bytes:
        """Receive as a socket does; HungUp and Overdue beside its own errors."""
        if self._looked_behind:
            raise Overdue
        self._looked_behind = time.monotonic() > self._ends_at
        data = super().recv(bufsize, flags)
        if not data and bufsize > 0:
            raise HungUp
        return data
