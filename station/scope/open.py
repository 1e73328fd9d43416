"""Opening an oscilloscope by name."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from instrument import TDS2014


@contextmanager
def open_scope(resource: str, baud_rate: int = 0) -> Iterator[TDS2014]:
    """Open an oscilloscope and put its front panel back afterwards.

    Parameters
    ----------
    resource : str
        VISA resource name.
    baud_rate : int, optional
        RS-232 only; 0: the driver's default.

    Raises
    ------
    InstrumentError
        If it cannot be opened or is another instrument.
    """
    with TDS2014(resource, baud_rate=baud_rate or None) as scope:
        yield scope
