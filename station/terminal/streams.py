"""Standard streams that do not break: what cannot be written is lost, and nothing else is.

Progress may go to a full disk, to a reader that has gone or sleeps, to a closed terminal, or to nowhere under a
daemon. The result may as well: then the exit code says so, and the run is as it would have been.
"""

from __future__ import annotations

import codecs
import errno
import io
import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import IO

_PIECE = 4096  # bytes: a pipe that is said to take some takes so many (PIPE_BUF) without waiting
_PATIENCE_S = 1.0  # a reader of progress that takes nothing for so long is not waited for again
_PLAIN = {
    "\N{BULLET}": "-",
    "\N{MINUS SIGN}": "-",
    "\N{MULTIPLICATION SIGN}": "x",
    "\N{GREEK SMALL LETTER PI}": "pi",
    "\N{GREEK SMALL LETTER SIGMA}": "sigma",
    "\N{MICRO SIGN}": "u",
    "\N{DEGREE SIGN}": " deg",
    "\N{SUPERSCRIPT TWO}": "^2",
    "\N{MIDDLE DOT}": "-",
    "\N{PLUS-MINUS SIGN}": "+-",
}


class _Descriptor(io.RawIOBase):
    """An open file that takes what it can."""

    def __init__(self, descriptor: int, *, waits: bool) -> None:
        self._descriptor, self._waits = descriptor, waits
        self._asleep = False
        self.error: OSError | None = None

    def write(self, data: object) -> int:
        """Write all, or as much as can be; says in every case that all was taken."""
        rest = memoryview(data).cast("B")  # type: ignore[arg-type]  # io calls it with buffers
        count = len(rest)
        if self.error is not None and self._waits:
            return count  # a document with a hole in it is none
        try:
            while rest and self._takes():
                with suppress(BlockingIOError):
                    rest = rest[os.write(self._descriptor, rest[:_PIECE]) :]
        except OSError as error:
            self.error = error
        return count

    def _takes(self) -> bool:
        """Whether bytes would be taken: waits for a reader of results, and once for one of progress."""
        if not hasattr(select, "poll"):
            return True
        poll = select.poll()
        poll.register(self._descriptor, select.POLLOUT)
        if self._waits:
            poll.poll()
            return True
        ready = bool(poll.poll(0 if self._asleep else 1000 * _PATIENCE_S))
        self._asleep = not ready
        return ready

    def fileno(self) -> int:
        return self._descriptor

    def isatty(self) -> bool:
        return os.isatty(self._descriptor)

    def writable(self) -> bool:
        return True


class _Nowhere(_Descriptor):
    """In the place of a stream that was closed before the program began."""

    def __init__(self) -> None:
        super().__init__(-1, waits=True)
        self.error = OSError(errno.EBADF, "it is closed")

    def fileno(self) -> int:
        raise OSError(errno.EBADF, "it is closed")

    def isatty(self) -> bool:
        return False


class Streams:
    """Standard output and standard error while a command runs."""

    def __init__(self, out: _Descriptor | None) -> None:
        self._out = out

    @property
    def lost(self) -> str:
        """Why some of the standard output is lost; empty if nothing is."""
        with suppress(ValueError):
            sys.stdout.flush()
        if self._out is None or self._out.error is None:
            return ""
        return self._out.error.strerror or str(self._out.error)


def takes_now(stream: IO[str]) -> bool:
    """Tell whether a stream would take a line of some thousand letters without waiting."""
    try:
        descriptor = stream.fileno()
    except (OSError, ValueError):
        return True
    if not hasattr(select, "poll"):
        return True
    poll = select.poll()
    poll.register(descriptor, select.POLLOUT)
    return bool(poll.poll(0))


@contextmanager
def unbreakable_streams() -> Iterator[Streams]:
    """Put streams that do not break into the place of ``sys.stdout`` and ``sys.stderr``."""
    before = sys.stdin, sys.stdout, sys.stderr
    _fill_descriptors()
    raw: list[_Descriptor | None] = []
    for stream, waits in ((before[1], True), (before[2], False)):
        raw.append(_descriptor_of(stream, waits=waits))
    if before[0] is None:
        sys.stdin = open(os.devnull, encoding="utf-8")  # noqa: SIM115  # as long as the command runs
    sys.stdout, sys.stderr = _text(before[1], raw[0]), _text(before[2], raw[1])
    try:
        yield Streams(raw[0])
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(ValueError):
                stream.flush()
        sys.stdin, sys.stdout, sys.stderr = before


def _fill_descriptors() -> None:
    """Open what was closed: a run must not get the number of a standard stream, to which others write."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            with suppress(OSError):
                os.open(os.devnull, os.O_RDWR)


def _descriptor_of(stream: IO[str] | None, *, waits: bool) -> _Descriptor | None:
    """The open file behind a stream; ``None`` for one in memory, which is left as it is."""
    if stream is None:
        return _Nowhere()
    try:
        stream.flush()
        return _Descriptor(stream.fileno(), waits=waits)
    except io.UnsupportedOperation:
        return None
    except (OSError, ValueError):
        return _Nowhere()


def _text(stream: IO[str] | None, raw: _Descriptor | None) -> IO[str]:
    if raw is None and stream is not None:
        return stream
    codecs.register_error("plainly", _plainly)
    encoding = getattr(stream, "encoding", None) or "utf-8"
    buffer = io.BufferedWriter(raw or _Nowhere())
    return io.TextIOWrapper(buffer, encoding=encoding, errors="plainly", line_buffering=True)


def _plainly(error: UnicodeError) -> tuple[str, int]:
    """Write what an encoding does not have with the characters that every encoding has."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    letters = error.object[error.start : error.end]
    plain = (_PLAIN.get(one) or one.encode("ascii", "backslashreplace").decode("ascii") for one in letters)
    return "".join(plain), error.end
