"""Lines on stdout and stderr: words, one JSON document, the one line of an error."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import Any

from station.errors import Failure
from station.terminal.visible import visible


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


def print_failure(failure: Failure) -> None:
    """Print the one line of an error to stderr."""
    remark(failure.message)
