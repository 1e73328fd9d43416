"""A finding of `gyrolock doctor`: what was looked at, and what to do about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from station.errors import StationError, one_line


@dataclass(frozen=True)
class Check:
    """One finding."""

    name: str
    # {"ok", "note", "bad"}: ``note``: works, but something cannot be used or is not known; ``bad``: must be mended
    state: Literal["ok", "note", "bad"]
    text: str  # what was found, and where it is not well what to do


def guarded(name: str, check: Callable[[], Check]) -> Check:
    """Turn an error of the instruments or the store into a finding."""
    from instrument import InstrumentError

    try:
        return check()
    except (InstrumentError, StationError, OSError) as error:
        return Check(name, "bad", one_line(error))
