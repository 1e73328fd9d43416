"""Events as lines of JSON, for other programs: to a file, a pipe, or a descriptor that the caller has opened.

A reader that is slow, has gone or never came costs lines, never the measurement: nothing here waits for it.
"""

from __future__ import annotations

import os
import select
import stat
import time
from collections import deque
from contextlib import suppress

from station.errors import UsageError
from station.events.event import Event

_LINES = 1000  # that wait for a reader; of more the oldest are lost, and counted
_PIECE = 4096  # bytes: a pipe that is said to take some takes so many (PIPE_BUF) without waiting
_LAST_S = 1.0  # for so long the end of the program waits for a reader


class EventLines:
    """Writes events to a descriptor as it takes them."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._held: deque[bytes] = deque()
        self._begun = b""
        """What is left of a line that is partly written."""
        self._untold = 0
        self.lost, self.error = 0, ""

    def __call__(self, event: Event) -> None:
        """Take an event, and write as much as is taken now."""
        if self.error:
            self.lost += 1
            return
        if len(self._held) >= _LINES:
            self._held.popleft()
            self._untold, self.lost = self._untold + 1, self.lost + 1
        self._held.append(event.line().encode() + b"\n")
        if self._untold and takes_now(self._descriptor):  # in the place of those that are lost
            told = Event(event.counter, "lost", event.at, {"count": self._untold})
            self._held.appendleft(told.line().encode() + b"\n")
            self._untold = 0
        self._write()

    def close(self) -> None:
        """Write what is left, if the reader takes it within a second, and close."""
        until = time.monotonic() + _LAST_S
        while (self._held or self._begun) and not self.error and time.monotonic() < until:
            self._write()
            if self._held or self._begun:
                time.sleep(0.01)
        self.lost += len(self._held) + bool(self._begun)
        self._held.clear()
        with suppress(OSError):
            os.close(self._descriptor)

    def _write(self) -> None:
        try:
            while (self._begun or self._held) and takes_now(self._descriptor):
                self._begun = self._begun or self._held.popleft()
                self._begun = self._begun[os.write(self._descriptor, self._begun[:_PIECE]) :]
        except BlockingIOError:
            return
        except OSError as error:
            self.error = error.strerror or str(error)


def takes_now(descriptor: int) -> bool:
    """Tell whether a descriptor takes :data:`_PIECE` bytes without waiting."""
    if not hasattr(select, "poll"):
        return True
    poll = select.poll()
    poll.register(descriptor, select.POLLOUT)
    return bool(poll.poll(0))


def open_lines(target: str) -> EventLines:
    """Open where events are written to."""
    try:
        return EventLines(_opened(target))
    except OSError as error:
        raise UsageError(f"--events {target}: {error.strerror}") from None


def _opened(target: str) -> int:
    if target.isdecimal():
        if int(target) == 1:
            raise UsageError("--events 1: stdout belongs to the result; give a file or another descriptor")
        descriptor = os.dup(int(target))
        if not _writable(descriptor):
            os.close(descriptor)
            raise UsageError(f"--events {target}: this descriptor is not open for writing")
    else:
        mode = os.O_WRONLY | os.O_CREAT | os.O_APPEND
        with suppress(FileNotFoundError):
            if stat.S_ISFIFO(os.stat(target).st_mode):
                mode = os.O_RDWR  # the reader of a pipe may come later, or go and come again
        descriptor = os.open(target, mode | getattr(os, "O_NONBLOCK", 0), 0o666)
    if stat.S_ISSOCK(os.fstat(descriptor).st_mode):
        os.set_blocking(descriptor, False)
    return descriptor


def _writable(descriptor: int) -> bool:
    try:
        import fcntl
    except ImportError:
        return True
    return fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_ACCMODE != os.O_RDONLY
