r"""Small text files: read with a bound on their size, and transcripts of every message, written and read again.

    {"at": 0.012, "link": "GPIB0::1::INSTR", "did": "write", "text": "*IDN?\n"}
    {"at": 0.015, "link": "GPIB0::1::INSTR", "did": "read", "text": "TEKTRONIX,..."}

Bytes that are no plain text stand in `base64`. Nothing but what went over the link is written. A file that has
reached its size goes no further and says so in its last line.
"""

import base64
import json
import os
import stat
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, BinaryIO

from instrument.errors import FileFormatError

LARGEST_FILE = 100_000_000  # bytes of a transcript: some 20 000 records

_PLAIN = frozenset(b"\n\r\t") | frozenset(range(0x20, 0x7F))


class Transcript:
    """An open file of messages; it may be written from several threads."""

    def __init__(self, file: IO[str], largest: int = LARGEST_FILE) -> None:
        self._file, self._left = file, largest
        self._began = time.monotonic()
        self._lock = threading.Lock()
        self._arriving: dict[str, tuple[float, bytearray]] = {}  # answers that may go on, by link

    def note(self, link: str, did: str, data: bytes = b"") -> None:
        """Note what a link did; bytes that are read piece by piece become one line."""
        at = time.monotonic() - self._began
        with self._lock:
            if did == "read":
                self._arriving.setdefault(link, (at, bytearray()))[1].extend(data)
                return
            self._end_answer(link)
            self._write(at, link, did, data)

    def finish(self) -> None:
        """Write what has been read and not written yet."""
        with self._lock:
            for link in list(self._arriving):
                self._end_answer(link)

    def _end_answer(self, link: str) -> None:
        at, data = self._arriving.pop(link, (0.0, b""))
        if data:
            self._write(at, link, "read", bytes(data))

    def _write(self, at: float, link: str, did: str, data: bytes) -> None:
        if self._left <= 0:
            return
        entry: dict[str, Any] = {"at": round(at, 6), "link": link, "did": did}
        line = json.dumps(entry | as_text(data) if data else entry) + "\n"
        self._left -= len(line)
        if self._left <= 0:
            line = json.dumps(entry | {"did": "full"}) + "\n"
        self._file.write(line)
        self._file.flush()


def as_text(data: bytes) -> dict[str, str]:
    """Bytes as JSON can hold them: `text` where they are plain ASCII, else `base64`."""
    if _PLAIN.issuperset(data):
        return {"text": data.decode("ascii")}
    return {"base64": base64.b64encode(data).decode("ascii")}


_open: list[Transcript] = []


@contextmanager
def recorded(path: Path) -> Iterator[Transcript]:
    """Write down what every link of this process carries until the block ends; OSError without the file."""
    with path.open("w", encoding="ascii") as file:
        transcript = Transcript(file)
        _open.append(transcript)
        try:
            yield transcript
        finally:
            _open.remove(transcript)
            transcript.finish()


def note(link: str, did: str, data: bytes = b"") -> None:
    """Write a line into every transcript that is open."""
    for transcript in tuple(_open):
        transcript.note(link, did, data)


# --------------------
# Reads a transcript as questions and what was answered to each, byte for byte


@dataclass(frozen=True)
class TranscriptExchange:
    """One message to the instrument and all bytes that came before the next one."""

    link: str
    message: bytes
    answer: bytes


def read_transcript(path: Path) -> list[TranscriptExchange]:
    """All exchanges of a file, in their order."""
    found: list[TranscriptExchange] = []
    for entry in _entries(path):
        link, did, data = str(entry["link"]), entry["did"], _data(entry)
        if did == "write":
            found.append(TranscriptExchange(link, data, b""))
        elif did == "read" and found:
            last = next((n for n in range(len(found) - 1, -1, -1) if found[n].link == link), None)
            if last is not None:
                found[last] = TranscriptExchange(link, found[last].message, found[last].answer + data)
    return found


def _entries(path: Path) -> Iterator[dict[str, Any]]:
    try:
        lines = path.read_text(encoding="ascii").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{path} cannot be read as a transcript: {error}") from None
    for number, line in enumerate(lines, start=1):
        try:
            entry = json.loads(line)
            _data(entry)
            yield {"link": entry["link"], "did": entry["did"], **entry}
        except (ValueError, KeyError, TypeError, AttributeError) as problem:
            raise FileFormatError(f"{path}, line {number}, is not of a transcript: {problem}") from None


def _data(entry: dict[str, Any]) -> bytes:
    if "base64" in entry:
        return base64.b64decode(entry["base64"], validate=True)
    return str(entry.get("text", "")).encode("ascii")


# --------------------
# Reading files that must be plain, and whole where they must be small: what is given by name may be anything


_KINDS = (
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
_WITHOUT_WAITING = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)  # a pipe would wait for its writer


def read_small_file(path: str | os.PathLike[str], largest: int) -> bytes:
    """Read a file of at most `largest` bytes."""
    with open_plain_file(path) as file:
        size = os.fstat(file.fileno()).st_size
        content = file.read(largest + 1) if size <= largest else b""
    if max(size, len(content)) > largest:
        megabytes = largest / 1e6
        raise FileFormatError(
            f"{os.fspath(path)}: is larger than any such file ({megabytes:.3g} MB): is it the right one?"
        )
    return content


def open_plain_file(path: str | os.PathLike[str]) -> BinaryIO:
    """Open a plain file for reading; FileFormatError if it is none, OSError if it is not there."""
    if os.path.isdir(path):  # some systems do not open one at all
        raise FileFormatError(f"{os.fspath(path)}: is a directory, not a file")
    descriptor = os.open(path, os.O_RDONLY | _WITHOUT_WAITING)
    try:
        found = os.fstat(descriptor)
        for is_kind, name in _KINDS:
            if is_kind(found.st_mode):
                raise FileFormatError(f"{os.fspath(path)}: is {name}, not a file")
        return os.fdopen(os.dup(descriptor), "rb")
    finally:
        os.close(descriptor)
