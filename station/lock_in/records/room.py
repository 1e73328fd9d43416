"""Records that wait until there are enough of them for the estimator."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from analysis import LockInEstimate
from analysis.lock_in_run import Method
from instrument import Preamble
from station.lock_in.records.estimates import estimate_batch
from station.memory import keep_for_batches
from station.sources.batches import RecordBatch, codes_of


@dataclass
class Wanted:
    """Estimates of one source."""

    method: Method | None = None  # ``None``: nobody wants them
    # (rows, LockInEstimate): What there is so far, and of which rows of the source
    parts: list[tuple[NDArray[np.intp], LockInEstimate]] = field(default_factory=list)


@dataclass
class _Waits:
    """Codes of some records of one source, and the row of the first."""

    wanted: Wanted
    row: int
    payloads: Sequence[bytes]
    preamble: Preamble


@dataclass
class _Batch:
    """Records that may go through the estimator together."""

    waiting: list[_Waits] = field(default_factory=list)
    count: int = 0


class Room:
    """Records that wait, by what a batch must have in common."""

    def __init__(self, at_once: int) -> None:
        keep_for_batches()
        self._at_once = at_once
        self._batches: dict[tuple[int, float, int, Method | None], _Batch] = {}

    def add(self, wanted: Wanted, row: int, payloads: Sequence[bytes], preamble: Preamble) -> None:
        """Take records of one source whose rows follow each other, from `row` on."""
        key = preamble.nr_pt, preamble.xincr, preamble.byt_nr, wanted.method
        while payloads:
            batch = self._batches.setdefault(key, _Batch())
            some = payloads[: self._at_once - batch.count]
            batch.waiting.append(_Waits(wanted, row, some, preamble))
            batch.count += len(some)
            row, payloads = row + len(some), payloads[len(some) :]
            if batch.count >= self._at_once:
                self._estimate(self._batches.pop(key))

    def estimate_all(self) -> None:
        """Estimate what waits."""
        while self._batches:
            self._estimate(self._batches.popitem()[1])

    def _estimate(self, batch: _Batch) -> None:
        first = batch.waiting[0]
        if first.wanted.method is None:
            return
        codes = codes_of([payload for one in batch.waiting for payload in one.payloads], first.preamble)
        preambles = tuple(one.preamble for one in batch.waiting for _ in one.payloads)
        estimate = estimate_batch(RecordBatch(codes, preambles), first.wanted.method, _kept_room(codes.shape))
        begin = 0
        for one in batch.waiting:
            count = len(one.payloads)
            one.wanted.parts.append((np.arange(one.row, one.row + count), estimate[begin : begin + count]))
            begin += count


class NoRoom(Room):
    """Records that nobody estimates."""

    def add(self, wanted: Wanted, row: int, payloads: Sequence[bytes], preamble: Preamble) -> None:
        """Take records, and let them go."""


_OF_THREAD = threading.local()


def _kept_room(shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Memory for volts that the batches of one thread use in turn: the system clears new one first, each time."""
    room: NDArray[np.float64] | None = getattr(_OF_THREAD, "room", None)
    if room is None or room.shape[1:] != shape[1:] or len(room) < shape[0]:
        room = _OF_THREAD.room = np.empty(shape)
    return room


def give_back_room() -> None:
    """Free the memory that the batches of this thread used in turn: no further one comes."""
    _OF_THREAD.__dict__.clear()
