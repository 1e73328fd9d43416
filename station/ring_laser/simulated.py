"""The simulated bench: table, gyro and oscilloscope on one clock, the scope behind a real byte stream."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from instrument import RateTable
from instrument.simulated import VirtualClock
from instrument.simulated.controllers import RateTableController
from station.controllers.open import open_simulated_rate_table, open_surroundings
from station.ring_laser.bench import Bench
from station.ring_laser.instruments import SimulatedInstruments, build_instruments, true_values
from station.ring_laser.settings import BenchSettings
from station.scope.open import open_scope
from station.scope.serve import serve


@contextmanager
def open_simulated_bench(
    settings: BenchSettings, *, times_resumed: int = 0, tell: Callable[[str], None] = lambda text: None
) -> Iterator[Bench]:
    """Open the simulated bench: on a clock that jumps instead of waiting, through a real link."""
    instruments = build_instruments(settings, VirtualClock(), times_resumed=times_resumed)
    with (
        serve(instruments.scope, instruments.link) as resource,
        # no byte changes inside this computer
        open_scope(resource, read_twice=False) as scope,
        _table(settings, instruments, tell) as table,
        open_surroundings(settings.controllers, tell=tell, simulated=True) as surroundings,
    ):
        yield Bench(
            scope,
            table=table,
            surroundings=surroundings,
            sleep=instruments.clock.sleep,
            now=instruments.clock.now,
            truth=lambda: true_values(instruments),
        )


@contextmanager
def _table(
    settings: BenchSettings, instruments: SimulatedInstruments, tell: Callable[[str], None]
) -> Iterator[RateTable | None]:
    """The simulated table: within this program, or through the bytes of its controller."""
    named = None if settings.controllers is None else settings.controllers.rate_table
    if settings.table.kind == "controller" and named is not None:
        device = RateTableController(instruments.table)
        with open_simulated_rate_table(device, named, instruments.clock, tell) as table:
            yield table
        return
    yield None if settings.table.kind == "none" else instruments.table
