"""How hard a program tries: retry policy and its counts, time for an answer, the clock of both.

A person at a keyboard wants to hear at once that something is wrong; a run that nobody watches goes on.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

# --------------------
# How long an answer is waited for, learned from those that came.
#
# As TCP does it (RFC 6298): from their mean and how much they vary, and twice as long after each silence. Only
# where every answer bears the mark of its question is it safe to give up early: one that comes too late is known
# as such

ANSWER_TIME = 3.0
"""Longest time in s until an answer begins: twice the 1.5 s that units of this family were seen to take."""

_MEAN_GAIN, _SPREAD_GAIN = 1 / 8, 1 / 4
_MEANS, _SPREADS = 2.0, 4.0  # RFC 6298 takes one mean: here a silence costs more than it does TCP
_FEWEST = 3  # answers of a kind from which on they tell something


@dataclass
class _SeenAnswers:
    """Times in s until answers of one kind began, and how many in a row did not come."""

    count: int = 0
    mean: float = 0.0
    spread: float = 0.0
    silences: int = 0

    def add(self, after: float) -> None:
        if self.count:
            self.spread += _SPREAD_GAIN * (abs(after - self.mean) - self.spread)
            self.mean += _MEAN_GAIN * (after - self.mean)
        else:
            self.mean, self.spread = after, after / 2
        self.count += 1
        self.silences = 0


@dataclass
class AnswerTimeout:
    """Waits for answers to begin."""

    shortest: float  # limits in s; the longest is also waited while too little is known
    longest: float
    _seen: dict[str, _SeenAnswers] = field(default_factory=dict)

    def seconds(self, kind: str) -> float:
        """How long to wait for the beginning of an answer of this kind."""
        seen = self._seen.get(kind, _SeenAnswers())
        if seen.count < _FEWEST:
            return self.longest
        usual = max(self.shortest, _MEANS * seen.mean + _SPREADS * seen.spread)
        return min(self.longest, usual * 2.0**seen.silences)

    def came(self, kind: str, after: float) -> None:
        """An answer that bears its mark began so many seconds after its question."""
        self._seen.setdefault(kind, _SeenAnswers()).add(after)

    def silent(self, kind: str) -> None:
        """No answer of this kind came."""
        self._seen.setdefault(kind, _SeenAnswers()).silences += 1


# --------------------
# The time that limits are measured on


class RetryClock(Protocol):
    """Seconds that pass, and a way to let them pass; a simulated instrument's virtual clock is one."""

    def now(self) -> float:
        """Time in s since some moment."""

    def sleep(self, seconds: float) -> None:
        """Let `seconds` pass; zero or less returns at once."""


class ComputerClock:
    """The computer's own time, which nobody sets."""

    def now(self) -> float:
        """Time in s since some moment."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait."""
        if seconds > 0:
            time.sleep(seconds)


@dataclass(frozen=True)
class Persistence:
    """What is done about a bad link.

    Attributes
    ----------
    attempts : int
        How often an exchange or a step is tried in a row. From 2 on every setting is asked for twice, and on a
        stream every answer must bear the mark of its question: so a damaged, late or repeated answer is taken
        for nothing else.
    read_twice : bool
        From 2 attempts on, whether every record is sent twice and must come alike.
    reconnect_for : float
        Time in s for which a lost link is tried again; 0: not at all. Settings are verified afterwards.
    tell : callable
        Is called with one sentence when the link is lost, and when it is there again.
    clock : Clock
        The time that is waited by.
    answer_time : float
        Longest time in s until an answer begins, besides that of the acquisition.
    """

    attempts: int = 1
    reconnect_for: float = 0.0
    read_twice: bool = True
    tell: Callable[[str], object] = str  # nobody hears it
    clock: RetryClock = field(default_factory=ComputerClock)
    answer_time: float = ANSWER_TIME

    @property
    def careful(self) -> bool:
        """Whether anything is done again at all."""
        return self.attempts > 1


ATTEMPTS = 8  # attempts of a run that nobody watches: one message in five may be spoiled each way, and it goes on

RECONNECT_FOR = 90.0
"""Time in s for which it tries to connect again: a plug that was pulled, a scope that starts up."""


@dataclass
class Tally:
    """What it took to keep the link.

    Attributes
    ----------
    repeated : int
        Exchanges and steps that were done again.
    reconnected : int
        How often the link was opened again.
    set_again : int
        Settings that the scope had lost and that were made again.
    """

    repeated: int = 0
    reconnected: int = 0
    set_again: int = 0

    @property
    def clean(self) -> bool:
        """Whether nothing happened."""
        return not (self.repeated or self.reconnected or self.set_again)

    def __str__(self) -> str:
        """``12 exchanges repeated, 1 reconnection``."""
        counted = (
            (self.repeated, "exchange repeated", "exchanges repeated"),
            (self.reconnected, "reconnection", "reconnections"),
            (self.set_again, "setting made again", "settings made again"),
        )
        told = [f"{count} {one if count == 1 else many}" for count, one, many in counted if count]
        return ", ".join(told) or "no faults"
