"""Who draws on the terminal steps aside while the operator is asked there, and says that an answer is awaited."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

_stepping_aside: list[tuple[Callable[[str], None], Callable[[], None]]] = []


@contextmanager
def stepping_aside(aside: Callable[[str], None], back: Callable[[], None]) -> Iterator[None]:
    """Be told of questions: `aside` gets each before it is asked, `back` is called when it is answered."""
    _stepping_aside.append((aside, back))
    try:
        yield
    finally:
        _stepping_aside.remove((aside, back))


@contextmanager
def free_terminal(question: str) -> Iterator[None]:
    """Have the terminal free for a question."""
    for aside, _ in _stepping_aside:
        with suppress(OSError, ValueError):
            aside(question)
    try:
        yield
    finally:
        for _, back in _stepping_aside:
            with suppress(OSError, ValueError):
                back()
