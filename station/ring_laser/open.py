"""Opening the bench that the settings describe, real or simulated."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from instrument import FoundPanel, Identity, RateTable
from station.controllers.open import open_rate_table, open_surroundings
from station.ring_laser.bench import Bench
from station.ring_laser.settings import BenchSettings
from station.runs.operator import check_terminal, operator_table
from station.runs.taking import Session
from station.scope.open import open_scope


@contextmanager
def open_bench(
    settings: BenchSettings,
    *,
    times_resumed: int = 0,
    tell: Callable[[str], None] | None = None,
    put_back: FoundPanel | None = None,
    same_as: Identity | None = None,
) -> Iterator[Bench]:
    """Open the bench; afterwards the front panel of the oscilloscope is as it was found."""
    said = tell or (lambda text: None)
    if settings.simulated:
        # PyVISA's simulated side and the gyro are not for a real bench
        from station.ring_laser.simulated import open_simulated_bench

        with open_simulated_bench(settings, times_resumed=times_resumed, tell=said) as bench:
            yield bench
        return
    if settings.table.kind == "manual":
        check_terminal()  # before anything is opened
    wanted = settings.scope
    opened = open_scope(
        wanted.resource,
        wanted.baud_rate,
        reconnect_s=wanted.reconnect_s,
        tell=tell,
        put_back=put_back,
        same_as=same_as,
    )
    with (
        opened as scope,
        open_surroundings(settings.controllers, tell=said) as surroundings,
        _table(settings, said) as table,  # the last to be opened is the first to be closed: it is stopped
    ):
        yield Bench(scope, table, surroundings=surroundings)


@contextmanager
def _table(settings: BenchSettings, tell: Callable[[str], None]) -> Iterator[RateTable | None]:
    """The rate table of a real bench; whatever ends this, it is stopped, or the operator is told to do it."""
    named = None if settings.controllers is None else settings.controllers.rate_table
    if settings.table.kind == "controller" and named is not None:
        with open_rate_table(named, tell=tell) as turned:
            yield turned
    elif settings.table.kind == "manual":
        by_hand = operator_table()
        try:
            yield by_hand
        finally:
            if rate := by_hand.rate():
                tell(f"The rate table still turns at {rate:+.6g} deg/s: stop it by hand.")
    else:
        yield None


def open_for(session: Session, settings: BenchSettings) -> Bench:
    """Open the bench for the taking of a run; the run keeps what the link took, and the front panel as found."""
    bench = session.open(
        open_bench(
            settings,
            times_resumed=session.times_resumed,
            tell=session.progress.note,
            put_back=session.panel_to_put_back,
            same_as=session.scope_so_far,
        )
    )
    session.watch(bench.scope)
    return bench
