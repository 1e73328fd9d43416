"""The controller of the simulated rate table: the language of ``config/controllers/rate_table.toml``."""

from __future__ import annotations

import math

from instrument.simulated.rate_table import SimulatedRateTable


class RateTableController:
    """Answers lines: ``RATE 3.5`` sets deg/s, ``RATE?`` and ``POSITION?`` read, ``STOP`` stops.

    An order is answered by OK or by ERR and a reason, which ``ERROR?`` repeats.
    """

    def __init__(self, table: SimulatedRateTable, name: str = "GYROLOCK RATE TABLE, SIM-1, 1.0") -> None:
        self._table, self._name = table, name
        self._enabled = False
        self._error = ""
        self.lines: list[str] = []
        """Orders, in the order in which they came."""

    def answer(self, line: str) -> str | None:
        """Carry out a line."""
        word, _, rest = line.upper().partition(" ")
        if word == "ID?":
            return self._name
        if word == "ERROR?":
            error, self._error = self._error or "0", ""
            return error
        if word == "RATE?":
            return f"RATE {self._table.rate():.6f}"
        if word == "POSITION?":
            return f"POSITION {self._table.azimuth() % 360.0:.4f}"
        self.lines.append(line)
        self._error = self._carry_out(word, rest)
        return f"ERR {self._error}" if self._error else "OK"

    def _carry_out(self, word: str, rest: str) -> str:
        """Carry out an order; why not, or nothing."""
        if word == "ENABLE":
            self._enabled = True
        elif word in ("STOP", "HOME"):
            self._table.set_rate(0.0)
        elif word == "RATE":
            return self._turn(rest)
        else:
            return f"no such command {word}"
        return ""

    def _turn(self, text: str) -> str:
        try:
            rate = float(text)
        except ValueError:
            rate = math.nan
        if not math.isfinite(rate):
            return f"{text} is no rate"
        if not self._enabled:
            return "the drive is not enabled"
        try:
            self._table.set_rate(rate)
        except ValueError as error:
            return str(error)
        return ""
