"""The rate table under the gyro: what any table must do, and a table that a person turns by hand or panel."""

import math
from collections.abc import Callable
from typing import Protocol

from instrument.errors import LinkError

_AS_ASKED = 0.1  # share of a rate by which a table may be off without being asked about

_ANTICLOCKWISE = r"""
      .--<--.
     /       \       seen from above:
    v    o    ^      anticlockwise, + on the display
     \       /
      '-->--'
"""

_CLOCKWISE = r"""
      .-->--.
     /       \       seen from above:
    ^    o    v      clockwise, - on the display
     \       /
      '--<--'
"""


class RateTable(Protocol):
    """A single-axis turntable. Rates in deg/s, angles in deg; positive is anticlockwise seen from above."""

    def set_rate(self, rate_dps: float) -> None:
        """Bring the table to `rate_dps` and return when it turns steadily."""

    def rate(self) -> float:
        """Rate of the table in deg/s."""

    def azimuth(self) -> float:
        """Angle of the table in deg from its zero mark."""

    def close(self) -> None:
        """Stop the table and let it go."""


class ManualRateTable:
    """A table without a remote interface: the operator sets it and confirms.

    Parameters
    ----------
    ask : callable
        Shows a question and returns the typed answer; `input` by default.
    azimuth_deg : float
        Angle of the table that is reported; a slow table without read-out stays near where it was set.

    Attributes
    ----------
    why : str
        What the next rate is for and what comes then, one sentence each: stands in the question.
    """

    def __init__(self, *, ask: Callable[[str], str] = input, azimuth_deg: float = 0.0) -> None:
        self._ask = ask
        self._azimuth_deg = azimuth_deg
        self._rate_dps = 0.0
        self.why = ""

    def set_rate(self, rate_dps: float) -> None:
        """Ask the operator to set the rate, and which rate the table shows then.

        An empty answer means "exactly as asked". A rate of the other sense, or a tenth off, must be typed twice.
        LinkError if the operator cannot be asked (no terminal).
        """
        lines = [f"Set the rate table to {rate_dps:+.6g} deg/s and wait until it turns steadily."]
        if rate_dps:
            lines.append((_ANTICLOCKWISE if rate_dps > 0 else _CLOCKWISE).strip("\n"))
        if self.why:
            lines.append(self.why)
        question = "\n".join([*lines, "Press Enter when done, or type the rate that it shows in deg/s: "])
        typed: float | None = None
        while True:
            answer = self._answer(question)
            number = _number(answer) if answer else rate_dps
            if number is None:
                question = f"{answer!r} is not a number. Rate in deg/s (Enter for {rate_dps:+.6g}): "
            elif number == typed or abs(number - rate_dps) <= _AS_ASKED * abs(rate_dps):
                self._rate_dps = number
                return
            else:
                typed = number
                question = (
                    f"The table was to turn at {rate_dps:+.6g} deg/s, not at {number:+.6g}. If it does, type it "
                    "again; else set it right and press Enter, or type what it shows: "
                )

    def doubt(self, seen: str) -> bool:
        """Ask the operator again, because the beat does not fit the rate that was confirmed.

        Parameters
        ----------
        seen : str
            What the beat shows, and what it should show.

        Returns
        -------
        bool
            Whether the operator has set the table or its rate right: then it is to be looked at again. If not, the
            operator has seen that everything is as it was said.
        """
        question = (
            f"The beat does not fit the table's rate of {self._rate_dps:+.6g} deg/s: {seen}.\n"
            "Look at the table: does it turn at this rate, in this sense, and is its display in deg/s?\n"
            "Set it right and press Enter, or type the rate that it shows; if all is right, type ok: "
        )
        while True:
            answer = self._answer(question)
            if answer.lower() in ("ok", "yes", "y"):
                return False
            if not answer:
                return True
            if (number := _number(answer)) is not None:
                self._rate_dps = number
                return True
            question = f"{answer!r} is neither a number nor ok. Rate in deg/s, Enter, or ok: "

    def rate(self) -> float:
        """Rate in deg/s that the operator confirmed last."""
        return self._rate_dps

    def azimuth(self) -> float:
        """Angle in deg, as given when the table was set up."""
        return self._azimuth_deg

    def close(self) -> None:
        """Ask the operator to stop the table, if it still turns."""
        if self._rate_dps != 0.0:
            self.why = ""
            self.set_rate(0.0)

    def _answer(self, question: str) -> str:
        try:
            return self._ask(question).strip()
        except EOFError:
            raise LinkError(
                "the rate table must be set by hand, but there is nobody to ask; run this in a terminal"
            ) from None


def _number(text: str) -> float | None:
    try:
        number = float(text.replace(",", "."))
    except ValueError:
        return None
    return number if math.isfinite(number) else None
