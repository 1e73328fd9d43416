"""What every measurement gives, in one form: report, terminal, JSON and limits need to know no more."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

from station.results.parts import Rows, TextTable

UNITS = {"dps": "deg/s", "dph": "deg/h", "hz": "Hz", "v": "V", "s": "s", "deg": "deg", "rad": "rad", "ppm": "ppm"}
"""Suffix of a name, and the unit that it stands for."""


def plain_words(name: str) -> str:
    """Say a name of the JSON as a person writes it.

    >>> plain_words("lock_in_rate")
    'lock-in rate'
    """
    return name.replace("_", " ").replace("lock in", "lock-in")


@dataclass(frozen=True)
class Measured:
    """A number that limits can be set on."""

    name: str  # with the unit at its end: the key in ``[limits]``
    value: float  # nan where the run gives none
    of: str = ""  # what it is of, where there are several: ``"X"``
    # standard uncertainty, where the result does not hold one under the name that goes with it
    u: float = math.nan

    @property
    def unit_suffix(self) -> str:
        """End of the name that stands for the unit; empty for a pure number."""
        end = self.name.rpartition("_")[2]
        return end if end in UNITS else ""

    @property
    def unit(self) -> str:
        """Unit as a person reads it."""
        return UNITS.get(self.unit_suffix, "")


@dataclass(frozen=True)
class LeftOut:
    """Something that was taken, or should have been, and is not in the result."""

    name: str
    reason: str

    @property
    def sentence(self) -> str:
        """One line."""
        return f"{self.name} is left out: {self.reason}"


@dataclass(frozen=True)
class Standing:
    """Whether a result holds, and what speaks against it."""

    # {"stands", "doubtful", "fails"}: "doubtful": something that was noticed, or that nobody knows, rules it.
    # "fails": there is no result, a check of it fails, or a simulation knows better.
    state: Literal["stands", "doubtful", "fails"]
    reasons: tuple[str, ...] = ()  # sentences; empty where it stands


@dataclass(frozen=True)
class Result:
    """What a run says."""

    name: str  # of the value: ``"lock-in rate"``
    value: str  # in large letters
    document: dict[str, Any]  # the body of the JSON document; arrays and nan may be in it
    measured: tuple[Measured, ...] = ()  # what limits can be set on
    lines: tuple[str, ...] = ()  # below the value in the report
    summary: Rows = ()  # (str, str): Below the value on the terminal
    sentences: tuple[str, ...] = ()  # what the result means
    to_watch: tuple[str, ...] = ()  # what spoils it or may spoil it
    flags: tuple[str, ...] = ()  # the same for programs
    left_out: tuple[LeftOut, ...] = ()
    tables: tuple[TextTable, ...] = ()  # above the value on the terminal
    problem: str = ""  # why there is no result; empty if there is one
    truth: str = ""  # truth of a simulated run, in words; empty: the run's facts tell it
    # what rules the result and is not known or not right; ``None``: whatever is `to_watch`
    doubts: tuple[str, ...] | None = None
    failures: tuple[str, ...] = ()  # checks of the result that fail

    @property
    def standing(self) -> Standing:
        """Whether it holds."""
        failures = (self.problem, *self.failures) if self.problem else self.failures
        doubts = self.to_watch if self.doubts is None else self.doubts
        if failures:
            return Standing("fails", (*failures, *doubts))
        return Standing("doubtful", doubts) if doubts else Standing("stands")
