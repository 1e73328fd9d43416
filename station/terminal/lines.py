"""Lines on stdout and stderr: words, one JSON document, the one line of an error."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Mapping
from typing import Any, Self

from station.errors import Failure
from station.terminal.visible import visible

_IN_MEMORY = 1 << 22
"""Characters."""


def say(text: str) -> None:
    """Print lines to stdout."""
    sys.stdout.write(f"{visible(text)}\n")
    sys.stdout.flush()


def remark(text: str) -> None:
    """Print one line to stderr, with the name of the program before it."""
    sys.stderr.write(f"gyrolock: {visible(' '.join(text.splitlines()))}\n")
    sys.stderr.flush()


def print_json(document: Mapping[str, Any]) -> None:
    """Print one JSON document; null stands for what is not finite."""
    from station.results.as_json import plain  # needs NumPy

    say(json.dumps(plain(document), allow_nan=False))


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
        from station.results.as_json import plain  # needs NumPy

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
