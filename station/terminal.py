"""Lines on stdout and stderr that do not break, whoever has closed the stream; asking the operator."""

from __future__ import annotations

import codecs
import errno
import io
import json
import math
import os
import re
import select
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Self

from station.errors import Failure, UsageError

if TYPE_CHECKING:
    from instrument import ManualRateTable

_IN_MEMORY = 1 << 22  # characters


PRINTS_ALL, PRINTS_ONE_LINE = "gyrolock prints all", "gyrolock prints one line"
"""Where a command keeps whether ``--full`` or ``--quiet`` was given."""


def prints(what: str) -> bool:
    """Whether the user wants more (`PRINTS_ALL`) or less (`PRINTS_ONE_LINE`) than a short page."""
    import click

    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(what))


def say(text: str, *, answer: bool = False) -> None:
    """Print lines to stdout; with ``--quiet`` only the one that is the `answer`."""
    if answer or not prints(PRINTS_ONE_LINE):
        sys.stdout.write(f"{visible(text)}\n")
        sys.stdout.flush()


def say_briefly(text: str) -> None:
    """Print with ``--quiet`` only: the line that stands for tables."""
    if prints(PRINTS_ONE_LINE):
        say(text, answer=True)


def remark(text: str) -> None:
    """Print one line to stderr, with the name of the program before it."""
    sys.stderr.write(f"gyrolock: {visible(' '.join(text.splitlines()))}\n")
    sys.stderr.flush()


def print_json(document: Mapping[str, Any]) -> None:
    """Print one JSON document; null stands for what is not finite."""
    from station.results.result import plain  # needs NumPy

    say(json.dumps(plain(document), allow_nan=False), answer=True)


class JsonResults:
    """JSON documents that are printed together at the end: ten thousand of them wait in a file."""

    def __init__(self, *, alone: bool) -> None:
        self._alone, self._count = alone, 0
        self._file = tempfile.SpooledTemporaryFile(_IN_MEMORY, "w+", encoding="utf-8")  # noqa: SIM115  # see __exit__

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, document: Mapping[str, Any]) -> None:
        """Take one document; null stands for what is not finite."""
        from station.results.result import plain  # needs NumPy

        self._file.write(", " if self._count else "")
        self._file.write(json.dumps(plain(document), allow_nan=False))
        self._count += 1

    def print(self) -> None:
        """Print all of them."""
        before, behind = ("", "\n") if self._alone else ('{"results": [', "]}\n")
        self._file.seek(0)
        sys.stdout.write(before)
        while text := self._file.read(_IN_MEMORY):
            sys.stdout.write(text)
        sys.stdout.write(behind)
        sys.stdout.flush()


def print_failure(failure: Failure) -> None:
    """Print the one line of an error to stderr."""
    remark(failure.message)


# --------------------
# Standard streams that do not break: what cannot be written is lost, and nothing else is.
#
# Progress may go to a full disk, to a reader that has gone or sleeps, to a closed terminal, or to nowhere under a
# daemon. The result may as well: then the exit code says so, and the run is as it would have been


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


def takes_now(stream: IO[str] | int) -> bool:
    """Tell whether a stream, or a descriptor, would take a line of some thousand letters without waiting."""
    try:
        descriptor = stream if isinstance(stream, int) else stream.fileno()
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
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            with suppress(OSError):
                os.open(os.devnull, os.O_RDWR)
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


# --------------------
# Text of others (file names, gyro names, answers of instruments) as it may be shown


# what moves a cursor, colours a terminal, turns the direction of writing, or cannot be written at all
_UNSEEN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff\ufeff]")


def visible(text: str) -> str:
    """Return a text in which every character that is not seen, but does something, is written out."""
    return _UNSEEN.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


# --------------------
# Who draws on the terminal steps aside while the operator is asked there, and says that an answer is awaited


_stepping_aside: list[tuple[Callable[[str], None], Callable[[], None]]] = []


@contextmanager
def stepping_aside(aside: Callable[[str], None], back: Callable[[], None]) -> Iterator[None]:
    """Be told of questions: `aside` gets each before it is asked, `back` is called when it is answered."""
    _stepping_aside.append((aside, back))
    try:
        yield
    finally:
        _stepping_aside.remove((aside, back))


@contextmanager
def free_terminal(question: str) -> Iterator[None]:
    """Have the terminal free for a question."""
    for aside, _ in _stepping_aside:
        with suppress(OSError, ValueError):
            aside(question)
    try:
        yield
    finally:
        for _, back in _stepping_aside:
            with suppress(OSError, ValueError):
                back()


# --------------------
# Asking the operator


WIRING = """\
    gyro ── photodiode ── amplifier ── coaxial cable ── CH1 of the oscilloscope
                                                         │ GPIB, RS-232 or USB
    rate table ── its controller ─────────────────────── computer
"""
"""How the bench is wired, for a prompt."""


ANSWERS_VARIABLE = "GYROLOCK_ANSWERS"
"""Names a file in the environment: lines that another program appends to it are the operator's answers."""

_ANSWER_EVERY_S = 0.1
_answers_read = 0


def _answered(file: Path, question: str) -> str:
    """Wait for the next line of a file of answers; meanwhile the question stands in ``question`` beside it."""
    global _answers_read
    asked = file.with_name("question")
    asked.write_text(question, encoding="utf-8")
    try:
        while True:
            with file.open("rb") as lines:
                lines.seek(_answers_read)
                line = lines.readline()
            if line.endswith(b"\n"):
                _answers_read += len(line)
                return line.decode("utf-8", "replace")
            time.sleep(_ANSWER_EVERY_S)
    finally:
        asked.unlink(missing_ok=True)


def ask_operator(question: str) -> str:
    """Ask on stderr, since stdout belongs to the result."""
    check_terminal()
    try:
        with free_terminal(question):
            sys.stderr.write(f"\n{visible(question)}")
            sys.stderr.flush()
            answers = os.environ.get(ANSWERS_VARIABLE)
            answer = _answered(Path(answers), question) if answers else sys.stdin.readline()
    except (OSError, ValueError):
        answer = ""
    if not answer:
        raise UsageError("the terminal was closed while the operator was asked")
    return answer


def ask_number(question: str, missing: str, default: str = "") -> float:
    """Ask for a positive number until one is typed; Enter means the default."""
    if not somebody_answers():
        raise UsageError(missing)
    asked = question
    while True:
        try:
            number = float(ask_operator(asked).strip().replace(",", ".") or default)
        except ValueError:
            number = math.nan
        if math.isfinite(number) and number > 0:
            return number
        asked = f"That is not a positive number. {question}"


def somebody_answers() -> bool:
    """Whether there is a terminal, or a program that appends answers."""
    try:
        return bool(os.environ.get(ANSWERS_VARIABLE)) or (sys.stdin is not None and sys.stdin.isatty())
    except ValueError:  # it is closed
        return False


def check_terminal() -> None:
    """See that there is somebody to ask, before anything moves; UsageError if there is not."""
    if not somebody_answers():
        raise UsageError(
            "an operator must turn the table and the gyro, and there is no terminal to ask on: start it in a "
            "terminal"
        )


def operator_table() -> ManualRateTable:
    """Return a rate table that the operator sets by hand; its azimuth is not known. Raises as above."""
    from instrument import ManualRateTable  # needs NumPy

    check_terminal()
    return ManualRateTable(ask=ask_operator, azimuth_deg=math.nan)
