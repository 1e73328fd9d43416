"""Asking the operator on the terminal."""

import math
import sys

from instrument import ManualRateTable
from station.errors import UsageError
from station.terminal import free_terminal, visible

WIRING = """\
    gyro ── photodiode ── amplifier ── coaxial cable ── CH1 of the oscilloscope
                                                         │ GPIB, RS-232 or USB
    rate table ── its controller ─────────────────────── computer
"""
"""How the bench is wired, for a prompt."""


def ask_operator(question: str) -> str:
    """Ask on stderr, since stdout belongs to the result."""
    check_terminal()
    try:
        with free_terminal(question):
            sys.stderr.write(f"\n{visible(question)}")
            sys.stderr.flush()
            answer = sys.stdin.readline()
    except (OSError, ValueError):
        answer = ""
    if not answer:
        raise UsageError("the terminal was closed while the operator was asked")
    return answer


def ask_number(question: str, missing: str, default: str = "") -> float:
    """Ask for a positive number until one is typed; Enter means the default."""
    if not sys.stdin.isatty():
        raise UsageError(missing)
    asked = question
    while True:
        try:
            number = float(ask_operator(asked).strip().replace(",", ".") or default)
        except ValueError:
            number = math.nan
        if math.isfinite(number) and number > 0:
            return number
        asked = f"That is not a positive number. {question}"


def check_terminal() -> None:
    """See that there is somebody to ask, before anything moves; UsageError if there is not."""
    try:
        there = sys.stdin is not None and sys.stdin.isatty()
    except ValueError:  # it is closed
        there = False
    if not there:
        raise UsageError(
            "an operator must turn the table and the gyro, and there is no terminal to ask on: start it in a "
            "terminal"
        )


def operator_table() -> ManualRateTable:
    """Return a rate table that the operator sets by hand; its azimuth is not known. Raises as above."""
    check_terminal()
    return ManualRateTable(ask=ask_operator, azimuth_deg=math.nan)
