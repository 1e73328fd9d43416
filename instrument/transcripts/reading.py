"""Reads a transcript as questions and what was answered to each, byte for byte."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from instrument.errors import FileFormatError


@dataclass(frozen=True)
class Exchange:
    """One message to the instrument and all bytes that came before the next one."""

    link: str
    message: bytes
    answer: bytes


def read_transcript(path: Path) -> list[Exchange]:
    """All exchanges of a file, in their order."""
    found: list[Exchange] = []
    for entry in _entries(path):
        link, did, data = str(entry["link"]), entry["did"], _data(entry)
        if did == "write":
            found.append(Exchange(link, data, b""))
        elif did == "read" and found:
            last = next((n for n in range(len(found) - 1, -1, -1) if found[n].link == link), None)
            if last is not None:
                found[last] = Exchange(link, found[last].message, found[last].answer + data)
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
