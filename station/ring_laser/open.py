"""Opening the bench that the settings describe, real or simulated."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from station.ring_laser.bench import Bench
from station.ring_laser.settings import BenchSettings
from station.runs.operator import operator_table
from station.scope.open import open_scope


@contextmanager
def open_bench(settings: BenchSettings, *, times_resumed: int = 0) -> Iterator[Bench]:
    """Open the bench; afterwards the front panel of the oscilloscope is as it was found.

    Parameters
    ----------
    times_resumed : int, optional
        How often the run was gone on with: a simulated bench that is switched on again has other noise.

    Raises
    ------
    InstrumentError
        If the oscilloscope cannot be opened or is another instrument.
    UsageError
        If an operator is needed and there is no terminal.
    """
    if settings.simulated:
        # PyVISA's simulated side and the gyro are not for a real bench
        from station.ring_laser.simulated import open_simulated_bench

        with open_simulated_bench(settings, times_resumed=times_resumed) as bench:
            yield bench
        return
    table = operator_table() if settings.table.kind == "manual" else None
    with open_scope(settings.scope.resource, settings.scope.baud_rate) as scope:
        yield Bench(scope, table)
