"""Opening the bench that the settings describe, real or simulated."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from instrument import FoundPanel, Identity
from station.ring_laser.bench import Bench
from station.ring_laser.settings import BenchSettings
from station.runs.operator import operator_table
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
    """Open the bench; afterwards the front panel of the oscilloscope is as it was found.

    Parameters
    ----------
    times_resumed : int, optional
        How often the run was gone on with: a simulated bench that is switched on again has other noise.
    tell : callable, optional
        Is told when the link is lost, and when it is there again.
    put_back : FoundPanel, optional
        The front panel to put back, where an earlier session found it and could not do it.
    same_as : Identity, optional
        The oscilloscope that it must be: that of the run which is gone on with.

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
    wanted = settings.scope
    opened = open_scope(
        wanted.resource,
        wanted.baud_rate,
        reconnect_s=wanted.reconnect_s,
        tell=tell,
        put_back=put_back,
        same_as=same_as,
    )
    try:
        with opened as scope:
            yield Bench(scope, table)
    finally:
        # Told and not asked: the result must not wait for an operator who has gone.
        if table is not None and table.rate() and tell is not None:
            tell(f"the rate table still turns at {table.rate():+.6g} deg/s: nothing more is measured, stop it")


def open_for(session: Session, settings: BenchSettings) -> Bench:
    """Open the bench for the taking of a run; the run keeps what the link took, and the front panel as found.

    Raises
    ------
    InstrumentError, UsageError
        As for :func:`open_bench`.
    """
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
