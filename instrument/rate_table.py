"""The rate table under the gyro: what any table must do, and a table that a person turns by hand or panel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from instrument.errors import LinkError


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
    """

    def __init__(self, *, ask: Callable[[str], str] = input, azimuth_deg: float = 0.0) -> None:
        self._ask = ask
        self._azimuth_deg = azimuth_deg
        self._rate_dps = 0.0

    def set_rate(self, rate_dps: float) -> None:
        """Ask the operator to set the rate, and which rate the table shows then.

        An empty answer means "exactly as asked". LinkError if the operator cannot be asked (no terminal).
        """
        question = (
            f"Set the rate table to {rate_dps:+.6g} deg/s and wait until it turns steadily.\n"
            "Press Enter when done, or type the rate that it shows in deg/s: "
        )
        while True:
            try:
                answer = self._ask(question).strip()
            except EOFError:
                raise LinkError(
                    "the rate table must be set by hand, but there is nobody to ask; run this in a terminal"
                ) from None
            if not answer:
                self._rate_dps = rate_dps
                return
            try:
                self._rate_dps = float(answer.replace(",", "."))
                return
            except ValueError:
                question = f"{answer!r} is not a number. Rate in deg/s (Enter for {rate_dps:+.6g}): "

    def rate(self) -> float:
        """Rate in deg/s that the operator confirmed last."""
        return self._rate_dps

    def azimuth(self) -> float:
        """Angle in deg, as given when the table was set up."""
        return self._azimuth_deg

    def close(self) -> None:
        """Ask the operator to stop the table, if it still turns."""
        if self._rate_dps != 0.0:
            self.set_rate(0.0)
