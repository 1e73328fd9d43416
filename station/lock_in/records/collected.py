"""Pieces of estimates put behind each other as they come: those of many records without holding them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from analysis import LockInEstimate
from analysis.channel import ChannelResponse
from analysis.lock_in_run import by_themselves
from station.lock_in.records.on_disk import ARRAYS, ColumnFiles, EstimatesOnDisk
from station.lock_in.records.pieces import Gathered, together
from station.lock_in.records.room import give_back_room

LONG = 20_000
"""Records from which on their estimates lie on the disk: some 250 bytes each."""

AT_ONCE = 5000
"""Records whose estimates go to the disk together: writing them run by run takes longer than making them one."""

FOLDED = 256
"""Pieces that are made one: ten thousand of them take memory of their own."""

_TRUTH = "truth "


class Collected:
    """Estimates of the records of one source, or of several that are to be one result, in their order."""

    def __init__(self, response: ChannelResponse | None) -> None:
        self._response = response
        self._parts: list[Gathered] = []
        self._fresh: list[Gathered] = []
        self._count = self._fresh_count = 0
        self._columns: ColumnFiles | None = None
        self._like: LockInEstimate | None = None
        self._truths: dict[str, None] = {}

    def add(self, part: Gathered) -> None:
        """Add a piece; its labels are not kept. OutsideResponse where a beat lies outside a measured response."""
        each = None if part.each is None else by_themselves(part.each, self._response)
        self._fresh.append(replace(part, labels={}, each=each))
        self._count += len(part)
        self._fresh_count += len(part)
        if self._columns is None and self._count > LONG:
            self._columns = ColumnFiles()
        if self._columns is not None and (self._fresh_count >= AT_ONCE or len(self._fresh) >= FOLDED):
            self._put_fresh_away()

    def gathered(self) -> Gathered:
        """All of it as one; nothing is added afterwards."""
        give_back_room()
        if self._columns is None:
            return together(self._fresh)
        self._put_fresh_away()
        whole = together(self._parts)
        if self._like is None:
            return whole
        each = EstimatesOnDisk.of(self._columns, self._like)
        return replace(whole, each=each, truth=_TruthOnDisk(self._columns, self._truths))

    def _put_fresh_away(self) -> None:
        if self._fresh:
            self._parts.append(self._put_away(together(self._fresh)))
            self._fresh, self._fresh_count = [], 0
        if len(self._parts) >= FOLDED:
            self._parts = [together(self._parts)]

    def _put_away(self, part: Gathered) -> Gathered:
        """Write the estimates of a piece to the disk; what is left of it is small."""
        each = part.each
        if each is None or self._columns is None:
            return part
        self._like = self._like or each
        self._truths |= dict.fromkeys(part.truth)
        truth = {f"{_TRUTH}{name}": values for name, values in part.truth.items()}
        self._columns.add({name: getattr(each, name) for name in ARRAYS} | truth, len(part))
        return replace(part, each=None, truth={})


class _TruthOnDisk(Mapping[str, NDArray[np.float64]]):
    """True values of a simulated bench, read when they are asked for."""

    def __init__(self, columns: ColumnFiles, names: Iterable[str]) -> None:
        self._columns, self._names = columns, tuple(names)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        if name not in self._names:
            raise KeyError(name)
        return self._columns.read(f"{_TRUTH}{name}")

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)
