"""Sums by which a record of a test, and the runs that it was made of, are known again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from station.runs.store import SavedRun

CONTENT = "content_sha256"
_PIECE = 1 << 20


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file; OSError if it cannot be read."""
    total = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(_PIECE):
            total.update(piece)
    return total.hexdigest()


def records_sha256(run: SavedRun) -> str:
    """Return the SHA-256 of what was measured: command, settings, and of each record what makes it.

    It stays the same when a result is computed again and saved, or the file is copied page by page.
    """
    total = hashlib.sha256(canonical({"command": run.facts.command, "settings": run.facts.settings}))
    for one in run.records:
        head = [one.number, one.key, one.taken_at, one.purpose, one.header, one.conditions]
        total.update(canonical(head))
        total.update(hashlib.sha256(one.payload).digest())
    return total.hexdigest()


def content_sha256(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a record of a test without this sum itself."""
    rest = {name: value for name, value in document.items() if name != CONTENT}
    return hashlib.sha256(canonical(rest)).hexdigest()


def canonical(value: object) -> bytes:
    """Return plain JSON in the one form of which sums are made: sorted names, no spaces, UTF-8."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
