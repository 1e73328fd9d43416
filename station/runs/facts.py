"""What is known of a run beside its records."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from instrument import Tally

COMPLETE = "complete"
TAKEN = "taken, but not evaluated to its end"
"""Outcomes of a run of which everything was taken: with result and wanted report, and before they are there."""


_KINDS: dict[str, type | tuple[type, ...]] = {
    **dict.fromkeys(("command", "started_at", "unit", "operator", "note"), str),
    **dict.fromkeys(("settings", "provenance", "identity", "truth", "scope_setting", "injected"), dict),
    **dict.fromkeys(("resumed_at", "left_out_of_plan", "logs", "rates", "rates_without_beat"), list),
    "simulated": (bool, int),
    "ended_at": str,
    "outcome": (str, dict),
}


def checked_fact(name: str, value: Any) -> Any:
    """Return a fact as it was read; ValueError if it is of a kind that it never is."""
    kind = _KINDS.get(name)
    if kind is not None and value is not None and not isinstance(value, kind):
        raise ValueError(f"holds {type(value).__name__}, which it never does")
    return value


class RunFacts(Mapping[str, Any]):
    """Facts of a run by name, and the common ones as attributes."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        self._values = dict(values)

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    @property
    def command(self) -> str:
        """Name of the measurement; the first layout was written by one measurement only and does not say."""
        return str(self._values.get("command") or "measure")

    @property
    def settings(self) -> dict[str, Any]:
        """Settings that the run was taken with; empty where none are saved."""
        return dict(self._values.get("settings") or {})

    @property
    def simulated(self) -> bool:
        """Whether the bench was simulated."""
        return bool(self._values.get("simulated", False))

    @property
    def started_at(self) -> str:
        """UTC, ISO 8601; empty if it is not known."""
        return str(self._values.get("started_at") or "")

    @property
    def ended_at(self) -> str | None:
        """UTC, ISO 8601; ``None`` for a run whose program was killed."""
        return self._values.get("ended_at")

    @property
    def resumed_at(self) -> tuple[str, ...]:
        """When the run was gone on with, UTC, ISO 8601."""
        return tuple(self._values.get("resumed_at") or ())

    @property
    def complete(self) -> bool:
        """Whether everything was taken that was wanted, and the result is there."""
        return self._values.get("outcome") == COMPLETE

    @property
    def outcome_text(self) -> str:
        """How the run ended, in words."""
        outcome = self._values.get("outcome") or "cut short: the program was killed"
        return outcome if isinstance(outcome, str) else str(outcome.get("message", "unknown"))

    def with_outcome(self, outcome: str | Mapping[str, Any]) -> RunFacts:
        """Return the facts with another outcome: as it will be, or could not be saved."""
        return RunFacts({**self._values, "outcome": outcome})

    @property
    def truth(self) -> dict[str, float] | None:
        """True values of a simulated run, where the whole run has one truth."""
        return self._values.get("truth")

    @property
    def link_faults(self) -> Tally | None:
        """What it took to keep the link to the oscilloscope; ``None`` where nobody counted."""
        from instrument import Tally  # with PyVISA: a list of runs must not wait for it

        return Tally(**self._values["link"]) if "link" in self._values else None

    @property
    def labels(self) -> dict[str, str]:
        """What the operator said of the run: ``unit``, ``operator`` and ``note``, those that were given."""
        return {name: str(self._values[name]) for name in LABELS if self._values.get(name)}

    @property
    def left_out_of_plan(self) -> dict[str, str]:
        """What was not taken at all, and why."""
        return {one["name"]: one["reason"] for one in self._values.get("left_out_of_plan", ())}

    @property
    def sources(self) -> tuple[str, ...]:
        """Files that the run was made of; empty if it was taken on a bench."""
        return tuple(self._values.get("logs", ()))


LABELS = ("unit", "operator", "note")
