"""Who draws on the terminal steps aside while somebody else writes there: a question for the operator."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

_drawing: list[tuple[Callable[[], None], Callable[[], None]]] = []


@contextmanager
def drawing(hide: Callable[[], None], show: Callable[[], None]) -> Iterator[None]:
    """Say that the terminal is drawn on; `hide` and `show` take the drawing away and bring it back."""
    _drawing.append((hide, show))
    try:
        yield
    finally:
        _drawing.remove((hide, show))


@contextmanager
def free_terminal() -> Iterator[None]:
    """Have the terminal free of drawings."""
    for hide, _ in _drawing:
        with suppress(OSError, ValueError):
            hide()
    try:
        yield
    finally:
        for _, show in _drawing:
            with suppress(OSError, ValueError):
                show()
