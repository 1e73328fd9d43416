"""How long an answer is waited for, learned from those that came.

As TCP does it (RFC 6298): from their mean and how much they vary, and twice as long after each silence. Only where
every answer bears the mark of its question is it safe to give up early: one that comes too late is known as such.
"""

from __future__ import annotations

from dataclasses import dataclass, field

_MEAN_GAIN, _SPREAD_GAIN = 1 / 8, 1 / 4
_MEANS, _SPREADS = 2.0, 4.0  # RFC 6298 takes one mean: here a silence costs more than it does TCP
_FEWEST = 3
"""Answers of a kind from which on they tell something."""


@dataclass
class _Seen:
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
class Patience:
    """Waits for answers to begin."""

    shortest: float  # limits in s; the longest is also waited while too little is known
    longest: float
    _seen: dict[str, _Seen] = field(default_factory=dict)

    def seconds(self, kind: str) -> float:
        """How long to wait for the beginning of an answer of this kind."""
        seen = self._seen.get(kind, _Seen())
        if seen.count < _FEWEST:
            return self.longest
        usual = max(self.shortest, _MEANS * seen.mean + _SPREADS * seen.spread)
        return min(self.longest, usual * 2.0**seen.silences)

    def came(self, kind: str, after: float) -> None:
        """An answer that bears its mark began so many seconds after its question."""
        self._seen.setdefault(kind, _Seen()).add(after)

    def silent(self, kind: str) -> None:
        """No answer of this kind came."""
        self._seen.setdefault(kind, _Seen()).silences += 1
