"""Opening an oscilloscope by name, for a run that nobody watches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from instrument import ATTEMPTS, RECONNECT_FOR, TDS2014, FoundPanel, Identity, Persistence, WrongInstrument


@contextmanager
def open_scope(
    resource: str,
    baud_rate: int = 0,
    *,
    reconnect_s: float = RECONNECT_FOR,
    read_twice: bool = True,
    tell: Callable[[str], None] | None = None,
    put_back: FoundPanel | None = None,
    same_as: Identity | None = None,
) -> Iterator[TDS2014]:
    """Open an oscilloscope and put its front panel back afterwards."""
    persistence = Persistence(ATTEMPTS, reconnect_s, read_twice, tell or (lambda _: None))
    with TDS2014(resource, baud_rate=baud_rate or None, persistence=persistence) as scope:
        if same_as is not None and not scope.identity.same_unit(same_as):
            raise WrongInstrument(
                f"the run was begun with {same_as.text!r}, and on {resource} answers {scope.identity.text!r}: "
                "connect the one it was begun with, or take a new run (`gyrolock analyze --combine` makes one "
                "result of several)"
            )
        if put_back is not None:
            scope.put_back_in_the_end(put_back)
        yield scope
