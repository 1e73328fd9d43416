"""Work in pieces, done by this process, by several or by a cluster: the same pieces in the same order."""

import itertools
import logging
import multiprocessing
import os
import signal
import socket
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack, suppress
from typing import Any, Protocol, Self, TypeVar

from station.datasets.rows import package
from station.errors import RunError, StationError, UsageError
from station.files import keep_for_batches, version

T = TypeVar("T")
R = TypeVar("R")

AHEAD = 2  # pieces for each process that are begun before the first of them is asked for: what waits takes memory


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

    def __exit__(self, _: object, error: BaseException | None, *__: object) -> None:
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


# --------------------
# Several computers: work that falls into pieces, done by the workers of a Dask scheduler


LOCAL = "local"
_PATIENCE_S = 10.0  # for a scheduler to answer, and for its first worker
_AHEAD = 3  # pieces for each worker that are begun before the first of them is asked for
_SAME = ("gyrolock", "numpy", "scipy")
"""What must be of one version everywhere: another one may give another last bit."""


class Cluster:
    """Workers that a Dask scheduler has, to be used as a context."""

    # A worker that is lost costs time only: what it had begun, or held, is done again by another.

    def __init__(self, address: str, workers: int | None = None) -> None:
        self.address, self._wanted = address, workers
        self._open = ExitStack()
        self._client: Any = None
        self.count = 0

    def __enter__(self) -> Self:
        distributed = package("distributed", "cluster")
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # a lost worker is no news for a user
        with ExitStack() as opened:
            if self.address == LOCAL:
                address: Any = opened.enter_context(
                    distributed.LocalCluster(
                        n_workers=self._wanted,
                        threads_per_worker=1,
                        processes=True,
                        dashboard_address="127.0.0.1:0",
                    )
                )
            elif "://" in self.address:
                address = self.address
            else:
                raise UsageError(f"{self.address}: is no scheduler: write tcp://HOST:8786, or {LOCAL}")
            self._client = opened.enter_context(self._connected(distributed, address))
            self._look_at_workers()
            self._open = opened.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError, TimeoutError):  # a scheduler that has gone meanwhile needs no good-bye
            self._open.close()

    def map(self, work: Callable[[T], R], pieces: Iterable[T]) -> Iterator[R]:
        """Do the work on every piece; the results come in the order of the pieces."""
        distributed = package("distributed", "cluster")
        rest = iter(pieces)
        begun: deque[Any] = deque()

        def begin(count: int) -> None:
            for piece in itertools.islice(rest, count):
                begun.append(self._client.submit(done, work, piece, pure=False))

        try:
            begin(_AHEAD * self.count)
            while begun:
                found = begun.popleft().result()
                begin(1)
                yield found
        except distributed.KilledWorker as error:
            raise RunError(
                f"{self.address}: a piece of the work has ended several workers, the last of them "
                f"{error.last_worker.address} (too little memory?): give the workers more, or take smaller pieces"
            ) from None
        except (distributed.CancelledError, distributed.comm.CommClosedError, TimeoutError) as error:
            raise RunError(
                f"{self.address}: the scheduler has gone ({type(error).__name__}): start it and the command again"
            ) from None

    def _connected(self, distributed: Any, address: Any) -> Any:
        client = distributed.Client.__new__(distributed.Client)
        try:
            self._knock()
            client.__init__(address, timeout=_PATIENCE_S, set_as_default=False)
            return client
        except (
            OSError,
            TimeoutError,
            ValueError,
            MemoryError,
        ) as error:  # others may listen there, and say anything
            client.status = "closed"  # one that never was open would wait for its end
            reason = str(error).split("\n", maxsplit=1)[0]
            raise RunError(
                f"{self.address}: no Dask scheduler answers there ({reason}): start one with `dask scheduler`"
            ) from None

    def _knock(self) -> None:
        """See that somebody listens: Dask itself would try again until its patience ends; OSError if not."""
        scheme, _, rest = self.address.partition("://")
        host, _, port = rest.rstrip("/").rpartition(":")
        if scheme == "tcp" and host and port.isdecimal():
            with socket.create_connection((host.strip("[]"), int(port)), _PATIENCE_S):
                return

    def _look_at_workers(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=_PATIENCE_S)
        except TimeoutError:
            raise RunError(
                f"{self.address}: the scheduler has no worker: start some with `dask worker {self.address}`"
            ) from None
        here = versions()
        for worker, there in self._client.run(versions).items():
            for name in _SAME:
                if here[name] != there[name]:
                    raise RunError(
                        f"{worker}: this worker has {name} {there[name]}, here is {here[name]}: install the same, "
                        "or its results may differ in their last bits"
                    )
        self.count = len(self._client.nthreads())


def done(work: Callable[[T], R], piece: T) -> R:
    """Do a piece of work: what a worker is asked for."""
    # Dask makes its workers give every large array back to the system (MALLOC_TRIM_THRESHOLD_)
    keep_for_batches()
    return work(piece)


def versions() -> dict[str, str]:
    """Return versions of what computes, on this computer."""
    return {name: version(name) for name in _SAME}
