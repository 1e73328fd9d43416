"""How hard a program tries before it gives an instrument up, and what it took.

A person at a keyboard wants to hear at once that something is wrong; a run that nobody watches goes on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from instrument.dialogue.clock import Clock, ComputerClock


def _say_nothing(text: str) -> None:
    """Nobody wants to hear."""


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
    """

    attempts: int = 1
    reconnect_for: float = 0.0
    read_twice: bool = True
    tell: Callable[[str], None] = _say_nothing
    clock: Clock = field(default_factory=ComputerClock)

    @property
    def careful(self) -> bool:
        """Whether anything is done again at all."""
        return self.attempts > 1


ATTEMPTS = 8
"""Attempts of a run that nobody watches: one message in five may be spoiled each way, and it goes on."""

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
