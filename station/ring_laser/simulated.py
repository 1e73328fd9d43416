"""The simulated bench: table, gyro and oscilloscope on one clock, the scope behind a real byte stream."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from instrument.simulated import VirtualClock
from station.ring_laser.bench import Bench
from station.ring_laser.instruments import build_instruments, true_values
from station.ring_laser.settings import BenchSettings
from station.scope.open import open_scope
from station.scope.serve import serve


@contextmanager
def open_simulated_bench(settings: BenchSettings, *, times_resumed: int = 0) -> Iterator[Bench]:
    """Open the simulated bench: on a clock that jumps instead of waiting, through a real link.

    Parameters
    ----------
    times_resumed : int, optional
        How often it was switched on before for the same run: phases and noise are other ones each time.
    """
    instruments = build_instruments(settings, VirtualClock(), times_resumed=times_resumed)
    turning_already = settings.table.kind == "none"
    # no byte changes inside this computer
    with serve(instruments.scope, instruments.link) as resource, open_scope(resource, read_twice=False) as scope:
        yield Bench(
            scope,
            table=None if turning_already else instruments.table,
            sleep=instruments.clock.sleep,
            now=instruments.clock.now,
            truth=lambda: true_values(instruments),
        )
