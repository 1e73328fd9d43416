"""Work that falls into pieces, done by this process or by several: the same pieces in the same order."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Any, Protocol, Self, TypeVar

from station.errors import StationError

T = TypeVar("T")
R = TypeVar("R")

AHEAD = 2
"""Pieces for each process that are begun before the first of them is asked for: what waits takes memory."""


class Workers(Protocol):
    """Whatever works through pieces."""

    def map(self, work: Callable[[T], R], pieces: Iterable[T]) -> Iterator[R]:
        """Do the work on every piece; the results come in the order of the pieces, a few of them in advance."""
        ...


class ThisProcess:
    """One piece after the other, here."""

    def map(self, work: Callable[[T], R], pieces: Iterable[T]) -> Iterator[R]:
        """Do the work; see `Workers`."""
        return map(work, pieces)


class Processes(AbstractContextManager["Processes"]):
    """Several processes of this computer."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=error is None, cancel_futures=True)

    def map(self, work: Callable[[T], R], pieces: Iterable[T]) -> Iterator[R]:
        """Do the work; see `Workers`."""
        if self.count == 1:
            yield from map(work, pieces)
            return
        pool, rest = self._opened(), iter(pieces)
        begun: deque[Future[R]] = deque()
        try:
            for piece in itertools.islice(rest, AHEAD * self.count):
                begun.append(pool.submit(work, piece))
            while begun:
                found = begun.popleft().result()
                for piece in itertools.islice(rest, 1):
                    begun.append(pool.submit(work, piece))
                yield found
        except BrokenProcessPool:
            raise StationError(
                f"one of {self.count} processes was ended from outside (too little memory?): "
                "start again with fewer --processes"
            ) from None

    def _opened(self) -> ProcessPoolExecutor:
        if self._pool is None:
            # a copy of this process has everything imported; beside other threads a copy may hang
            copies = os.name == "posix" and threading.active_count() == 1
            context: Any = multiprocessing.get_context("fork" if copies else "spawn")
            self._pool = ProcessPoolExecutor(self.count, context, initializer=_ignore_interrupts)
        return self._pool


def _ignore_interrupts() -> None:
    """Ctrl-C reaches every process of a terminal; the first one ends the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
