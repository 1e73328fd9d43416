"""The kinds of values that a setting can hold: how each is read, forced into range, and written.

A number outside its range is silently forced to the nearest allowed value (programmer manual 071-1075-04,
p. 2-12); a word that is not in the list is refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

from instrument.simulated.panel.event_table import Guess, Refusal
from instrument.simulated.panel.formats import abbreviations, nr3, quoted, spell
from instrument.simulated.panel.parsing import Argument

Value = str | int | float


class Kind(Protocol):
    """How one setting's value is read from an argument and written into an answer."""

    def read(self, argument: Argument) -> Value:
        """Value of the argument, forced into range; raises Refusal."""

    def write(self, value: Value, verbose: bool) -> str:
        """The value as it stands in an answer."""


def number(argument: Argument) -> float:
    """Read NR1, NR2 or NR3; refuse anything else."""
    text = argument.text
    try:
        value = float(text) if not argument.quoted and "_" not in text else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise Refusal(Guess.NUMBER_EXPECTED)
    return value


def nearest(value: float, steps: Sequence[float]) -> float:
    """The step closest to a value; the lower one in the middle."""
    return min(steps, key=lambda step: abs(step - value))


@dataclass(frozen=True)
class Words:
    """One word of a list, spelled with capitals for its short form: `Words("SAMple", "AVErage")`."""

    words: tuple[str, ...]
    _spellings: dict[str, str] = field(init=False, repr=False, compare=False)

    def __init__(self, *words: str) -> None:
        spellings: dict[str, str] = {}
        for word in words:
            for spelling in abbreviations(word):
                spellings.setdefault(spelling, word)
        object.__setattr__(self, "words", words)
        object.__setattr__(self, "_spellings", spellings)

    def read(self, argument: Argument) -> str:
        """The long form in capitals."""
        word = None if argument.quoted else self._spellings.get(argument.text.upper())
        if word is None:
            raise Refusal(Guess.UNKNOWN_WORD)
        return word.upper()

    def write(self, value: Value, verbose: bool) -> str:
        """Long form, or with VERBose off the short form."""
        return str(value) if verbose else spell(self._spellings[str(value)], verbose)


@dataclass(frozen=True, init=False)
class QuotedWords(Words):
    """One word of a list that travels in quotes, as the unit of a probe does."""

    def read(self, argument: Argument) -> str:
        """The word in capitals."""
        if not argument.quoted:
            raise Refusal(Guess.STRING_EXPECTED)
        return super().read(Argument(argument.text))

    def write(self, value: Value, verbose: bool) -> str:
        """In double quotes."""
        return quoted(super().write(value, verbose))


@dataclass(frozen=True)
class Switch:
    """ON, OFF or a number; `words` chooses whether it answers `ON`/`OFF` or `1`/`0`."""

    words: bool = False

    def read(self, argument: Argument) -> int:
        """1 for ON and any number that rounds to something else than zero."""
        word = argument.text.upper()
        if word in ("ON", "OFF") and not argument.quoted:
            return int(word == "ON")
        return int(round(number(argument)) != 0)

    def write(self, value: Value, verbose: bool) -> str:
        """`1` or `0`, `ON` or `OFF`."""
        return ("OFF", "ON")[int(value)] if self.words else str(int(value))


@dataclass(frozen=True)
class Whole:
    """A whole number in a range, answered as NR1."""

    low: int
    high: int

    def read(self, argument: Argument) -> int:
        """Rounded and forced into the range."""
        return round(min(max(number(argument), self.low), self.high))

    def write(self, value: Value, verbose: bool) -> str:
        """NR1."""
        return str(int(value))


@dataclass(frozen=True)
class Real:
    """A number in a range, in steps if `step` is given, answered as NR3."""

    low: float
    high: float
    step: float = 0.0
    digits: int = 7

    def read(self, argument: Argument) -> float:
        """Rounded to the step and forced into the range."""
        value = min(max(number(argument), self.low), self.high)
        if self.step:
            value = round(round(value / self.step) * self.step, 12)
        return float(f"{value:.{self.digits - 1}e}")

    def write(self, value: Value, verbose: bool) -> str:
        """NR3."""
        return nr3(float(value), self.digits)


@dataclass(frozen=True)
class PulseWidth(Real):
    """Multiples of 16.5 ns, and of 0.1 % where those are coarser, p. 2-232."""

    def read(self, argument: Argument) -> float:
        """The nearest multiple in the range."""
        value = super().read(argument)
        fine = max(value, self.low)
        step = max(self.low / 2, 10.0 ** math.floor(math.log10(fine)) / 1e4)
        return float(f"{round(fine / step) * step:.6e}")


@dataclass(frozen=True)
class Steps:
    """One of a list of numbers; others go to the nearest. `whole` answers NR1, else NR3."""

    steps: tuple[float, ...]
    whole: bool = False

    def read(self, argument: Argument) -> float:
        """The nearest step."""
        return nearest(number(argument), self.steps)

    def write(self, value: Value, verbose: bool) -> str:
        """NR1 or NR3."""
        return str(int(value)) if self.whole else nr3(float(value))


@dataclass(frozen=True)
class NumberedWords:
    """Words that stand for numbers, answered as the number: `PERSistence INF` answers 99."""

    words: tuple[tuple[str, int], ...]

    def read(self, argument: Argument) -> int:
        """Number of the word, or the nearest of the numbers."""
        for word, value in self.words:
            if argument.text.upper() in abbreviations(word) and not argument.quoted:
                return value
        return int(nearest(number(argument), [value for _, value in self.words]))

    def write(self, value: Value, verbose: bool) -> str:
        """NR1."""
        return str(int(value))


@dataclass(frozen=True)
class Text:
    """A quoted string."""

    longest: int = 1000

    def read(self, argument: Argument) -> str:
        """The string without its quotes."""
        if not argument.quoted:
            raise Refusal(Guess.STRING_EXPECTED)
        return argument.text[: self.longest]

    def write(self, value: Value, verbose: bool) -> str:
        """In double quotes."""
        return quoted(str(value))


@dataclass(frozen=True)
class Constant:
    """A value that can be asked for but not set."""

    answer: str

    def read(self, argument: Argument) -> Value:
        """Refuse: there is no such command."""
        raise Refusal(Guess.QUERY_HAS_NO_COMMAND)

    def write(self, value: Value, verbose: bool) -> str:
        """The constant."""
        return self.answer
