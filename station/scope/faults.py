"""Faults of a simulated oscilloscope as a user writes them."""

from __future__ import annotations

from typing import get_args

from instrument.simulated.faults import Fault, FaultKind
from station.errors import UsageError

KINDS: tuple[str, ...] = get_args(FaultKind)
_DEFAULT_CHANCE = 0.01


def parse_fault(text: str) -> Fault:
    """Read `KIND`, `KIND:CHANCE` or `knob turned:CHANCE:COMMAND`; without a chance, one answer in a hundred.

    Examples
    --------
    >>> parse_fault("cut answer:0.05").probability
    0.05
    """
    kind, _, rest = text.partition(":")
    chance, _, command = rest.partition(":")
    if kind not in KINDS:
        raise UsageError(f"--faults {text}: there is no fault {kind!r}; choose one of {', '.join(KINDS)}")
    try:
        probability = float(chance) if chance else _DEFAULT_CHANCE
    except ValueError:
        probability = -1.0
    if not 0 <= probability <= 1:
        raise UsageError(f"--faults {text}: the chance {chance!r} is no number from 0 to 1")
    if kind.startswith("knob") and not command:
        raise UsageError(f"--faults {text}: say what the hand turns, as in 'knob turned:0.1:CH1:SCALE 2'")
    return Fault(kind, probability=probability, command=command)  # type: ignore[arg-type]
