"""The bench as a measurement sees it: an oscilloscope, perhaps a rate table, and a way to wait."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from instrument import TDS2014
from instrument.rate_table import ManualRateTable, RateTable
from station.errors import UsageError
from station.settings.load import Settings


@dataclass(frozen=True)
class Bench:
    """What a measurement works with.

    Attributes
    ----------
    scope : TDS2014
    table : RateTable or None
        ``None`` where the table turns by itself.
    sleep : callable
        Waits so many seconds, of the clock that the instruments live by.
    truth : callable or None
        On a simulated bench: the true values of the last record, with the names of the results.
    """

    scope: TDS2014
    table: RateTable | None
    sleep: Callable[[float], None] = time.sleep
    truth: Callable[[], dict[str, float]] | None = None

    def turn_table(self, rate_dps: float, settle_s: float) -> float:
        """Set the table's rate, wait until it turns steadily, and then let it settle.

        Parameters
        ----------
        rate_dps : float
        settle_s : float

        Returns
        -------
        float
            The rate that the table has, deg/s.

        Raises
        ------
        UsageError
            If there is no table that could be set.
        """
        if self.table is None:
            raise UsageError("this bench has no rate table that could be set")
        self.table.set_rate(rate_dps)
        self.sleep(settle_s)
        return self.table.rate()

    def azimuth(self) -> float | None:
        """Return the table's azimuth in deg, or ``None`` where nobody knows it."""
        if self.table is None:
            return None
        azimuth = self.table.azimuth()
        return azimuth if math.isfinite(azimuth) else None


def operator_table() -> ManualRateTable:
    """Return a rate table that the operator sets by hand, asked on the terminal; its azimuth is not known.

    Raises
    ------
    UsageError
        If there is no terminal to ask on.
    """
    if not sys.stdin.isatty():
        raise UsageError(
            'table.kind = "manual" asks the operator on a terminal, and there is none: '
            'start it in a terminal, or set table.kind = "none"'
        )
    return ManualRateTable(ask=_ask, azimuth_deg=math.nan)


def _ask(question: str) -> str:
    """Ask on stderr: stdout belongs to the result."""
    sys.stderr.write(f"\n{question}")
    sys.stderr.flush()
    answer = sys.stdin.readline()
    if not answer:
        raise EOFError
    return answer


@contextmanager
def open_bench(settings: Settings) -> Iterator[Bench]:
    """Open the bench that the settings describe; afterwards the front panel is as it was found.

    Parameters
    ----------
    settings : Settings

    Yields
    ------
    Bench

    Raises
    ------
    InstrumentError
        If the oscilloscope cannot be opened or is another instrument.
    UsageError
        If an operator is needed and there is no terminal.
    """
    if settings.simulated:
        from station.lock_in.bench.simulated import open_simulated_bench

        with open_simulated_bench(settings) as bench:
            yield bench
        return
    table = operator_table() if settings.table.kind == "manual" else None
    with open_scope(settings.scope.resource, settings.scope.baud_rate) as scope:
        yield Bench(scope, table)


@contextmanager
def open_scope(resource: str, baud_rate: int = 0) -> Iterator[TDS2014]:
    """Open an oscilloscope by name and put its front panel back afterwards.

    Parameters
    ----------
    resource : str
        VISA resource name.
    baud_rate : int, optional
        RS-232 only; 0: the driver's default.

    Yields
    ------
    TDS2014

    Raises
    ------
    InstrumentError
        If it cannot be opened or is another instrument.
    """
    with TDS2014(resource, baud_rate=baud_rate or None) as scope:
        yield scope
