"""Writes down each message of every link with its time: one JSON object a line.

    {"at": 0.012, "link": "GPIB0::1::INSTR", "did": "write", "text": "*IDN?\\n"}
    {"at": 0.015, "link": "GPIB0::1::INSTR", "did": "read", "text": "TEKTRONIX,..."}

Bytes that are no plain text stand in `base64`. Nothing but what went over the link is written. A file that has
reached its size goes no further and says so in its last line.
"""

from __future__ import annotations

import base64
import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

LARGEST_FILE = 100_000_000
"""Bytes of a transcript: some 20 000 records."""

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
    r"""Bytes as JSON can hold them: `text` where they are plain ASCII, else `base64`.

    Examples
    --------
    >>> as_text(b"*IDN?\n"), as_text(b"\x80\x81")
    ({'text': '*IDN?\n'}, {'base64': 'gIE='})
    """
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
