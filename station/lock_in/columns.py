"""Pieces of estimates put behind each other as they come: those of many records without holding them."""

from __future__ import annotations

import os
import tempfile
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from analysis import LockInEstimate
from analysis.channel import ChannelResponse
from analysis.lock_in_run import Batch, by_themselves, rows_of_batches
from analysis.lockin_rate import noise_model
from instrument import Waveform
from station.errors import CannotWrite, RunError
from station.lock_in.estimate import Gathered, give_back_room, together
from station.ring_laser.records import saved_waveform
from station.sources.batches import Source

LONG = 20_000  # records from which on their estimates lie on the disk: some 250 bytes each

AT_ONCE = 5000
"""Records whose estimates go to the disk together: writing them run by run takes longer than making them one."""

FOLDED = 256  # pieces that are made one: ten thousand of them take memory of their own

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


# --------------------
# Estimates of a long run on the disk, a file for each column: one is read when it is asked for, and not kept


_AT_ONCE = 1 << 14  # rows that are read together where not all of them are to be in memory


class ColumnFiles:
    """Columns of numbers that grow together, in files without a name: they end with the program."""

    def __init__(self) -> None:
        self.count = 0
        self._files: dict[str, tuple[IO[bytes], np.dtype[Any], tuple[int, ...]]] = {}
        weakref.finalize(self, lambda files: [file.close() for file, _, _ in files.values()], self._files)

    def add(self, columns: Mapping[str, NDArray[Any]], count: int) -> None:
        """Add `count` rows (n, ...); a column that has none of them gets nan."""
        try:
            for name in columns.keys() - self._files.keys():
                file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115  # open as long as this object
                self._files[name] = file, columns[name].dtype, columns[name].shape[1:]
                if self.count:
                    self._write(name, np.full((self.count, *columns[name].shape[1:]), np.nan))
            for name, (_, kind, inner) in self._files.items():
                values = columns.get(name)
                self._write(name, np.full((count, *inner), np.nan, kind) if values is None else values)
        except OSError as error:
            raise CannotWrite(
                f"{tempfile.gettempdir()}: takes no more of the estimates of a long run "
                f"({error.strerror or error}): make room, or name another folder in TMPDIR"
            ) from None
        self.count += count

    def _write(self, name: str, values: NDArray[Any]) -> None:
        file, kind, _ = self._files[name]
        file.seek(0, os.SEEK_END)
        if values.size:
            file.write(np.ascontiguousarray(values, kind).data.cast("B"))

    def read(self, name: str, first: int = 0, count: int | None = None) -> NDArray[Any]:
        """Return rows of one column, all of them without `count`."""
        file, kind, inner = self._files[name]
        rows = np.empty((self.count - first if count is None else count, *inner), kind)
        file.seek(first * rows[:1].nbytes if len(rows) else 0)
        if len(rows) and file.readinto(rows.data.cast("B")) != rows.nbytes:  # type: ignore[attr-defined]  # raw file
            raise OSError(f"{tempfile.gettempdir()}: the estimates of a long run are gone from the disk")
        return rows

    def rows(self, name: str, rows: NDArray[np.intp]) -> NDArray[Any]:
        """Return some rows (n,) of one column; what lies between them is not in memory all at once."""
        if rows.size and np.all(np.diff(rows) == 1):
            return self.read(name, int(rows[0]), rows.size)
        _, kind, inner = self._files[name]
        found = np.empty((rows.size, *inner), kind)
        for first in range(0, self.count, _AT_ONCE):
            there = np.flatnonzero((rows >= first) & (rows < first + _AT_ONCE))
            if there.size:
                values = self.read(name, first, min(_AT_ONCE, self.count - first))
                found[there] = values[rows[there] - first]
        return found


ARRAYS = tuple(
    field.name for field in fields(LockInEstimate) if field.type not in ("float", "bool", "str", "Relation")
)


class EstimatesOnDisk(LockInEstimate):
    """What is said of many records, its arrays on the disk; made by :meth:`of`."""

    # Every field is read anew each time: who needs one more than once keeps it. What is derived from it by
    # `dataclasses.replace` is in memory.

    _columns: ColumnFiles
    _rows: NDArray[np.intp] | None

    @classmethod
    def of(
        cls, columns: ColumnFiles, like: LockInEstimate, rows: NDArray[np.intp] | None = None
    ) -> EstimatesOnDisk:
        """Return the estimates in columns called as the fields."""
        made = object.__new__(cls)
        common = {
            field.name: getattr(like, field.name) for field in fields(LockInEstimate) if field.name not in ARRAYS
        }
        for name, value in {**common, "_columns": columns, "_rows": rows}.items():
            object.__setattr__(made, name, value)
        object.__setattr__(made, "noise_model", noise_model(made.flags))  # of all, not of the first piece
        return made

    def __getattr__(self, name: str) -> NDArray[Any]:
        if name not in ARRAYS or "_columns" not in vars(self):
            raise AttributeError(name)
        return self._columns.read(name) if self._rows is None else self._columns.rows(name, self._rows)

    @property
    def _is_here(self) -> bool:
        """Whether it is in memory: `dataclasses.replace` makes such ones."""
        return "_columns" not in vars(self)

    def __len__(self) -> int:
        if self._is_here:
            return super().__len__()
        return self._columns.count if self._rows is None else int(self._rows.size)

    def __getitem__(self, key: Any) -> LockInEstimate:
        """Some of the records: one or a slice in memory, others on the disk as they are."""
        if self._is_here:
            return super().__getitem__(key)
        if self._rows is None:
            rows = np.arange(*key.indices(len(self))) if isinstance(key, slice) else np.arange(len(self))[key]
        else:
            rows = np.asarray(self._rows[key])
        if isinstance(key, slice) or rows.ndim == 0:
            values: dict[str, Any] = {
                field.name: getattr(self, field.name)
                for field in fields(LockInEstimate)
                if field.name not in ARRAYS
            }
            for name in ARRAYS:
                found = self._columns.rows(name, rows.ravel())
                values[name] = found.reshape((*rows.shape, *found.shape[1:]))
            return LockInEstimate(**values)
        if rows.size == len(self) and self._rows is None and np.array_equal(rows, np.arange(len(self))):
            return self
        return EstimatesOnDisk.of(self._columns, self, rows)

    def reshaped(self, *shape: int) -> LockInEstimate:
        """The same records in another leading shape; as they are where that is theirs already."""
        return self if shape == (-1,) and not self._is_here else super().reshaped(*shape)

    def changed(self, change: Callable[[LockInEstimate, slice], LockInEstimate]) -> LockInEstimate:
        """The records as a function makes others of them, some at a time: they lie on the disk too."""
        if self._is_here or not len(self):
            return super().changed(change)
        columns = ColumnFiles()
        for first in range(0, len(self), _AT_ONCE):
            rows = slice(first, min(first + _AT_ONCE, len(self)))
            part = change(self[rows], rows)
            columns.add({name: getattr(part, name) for name in ARRAYS}, len(part))
        return EstimatesOnDisk.of(columns, part).described(part.noise_model)

    def described(self, noise_model: str) -> LockInEstimate:
        """The same records, with other words on what their uncertainties rest on."""
        if self._is_here:
            return super().described(noise_model)
        made = EstimatesOnDisk.of(self._columns, self, self._rows)
        object.__setattr__(made, "noise_model", noise_model)
        return made


# --------------------
# Records of two photodiodes, pair by pair: read when their samples are asked for, none of them kept


@dataclass(frozen=True)
class Pairs:
    """Volts of both channels, batch by batch."""

    source: Source
    gathered: Gathered  # of the whole source; every record has its second one

    def __iter__(self) -> Iterator[Batch]:
        columns = self.gathered.columns
        samples = columns["samples"].astype(np.int64)
        for rows in rows_of_batches(columns["sample_interval_s"], samples):
            numbers = np.concatenate([self.gathered.numbers[rows], self.gathered.seconds[rows]])
            order = np.sort(numbers)
            waves = dict(zip(order.tolist(), read_waveforms(self.source, order), strict=True))
            picked = numbers.reshape(2, -1).tolist()
            volts = np.array([[waves[number].volts for number in channel] for channel in picked])
            clipped = np.array([[waves[number].clipped_samples for number in channel] for channel in picked])
            yield Batch(rows, waves[picked[0][0]].sample_interval, volts, clipped)


def whole_pairs(gathered: Gathered) -> Gathered | None:
    """The records of which both are intact; ``None`` where one never had a second."""
    # What is left out is counted as damaged, with the record that it belongs to.
    return None if (gathered.seconds == 0).any() else with_intact_seconds(gathered)


def with_intact_seconds(gathered: Gathered) -> Gathered:
    """The records whose second one, where there is one, is intact; others count as damaged."""
    lost = gathered.seconds < 0
    if not lost.any():
        return gathered
    kept = np.flatnonzero(~lost)
    return replace(
        gathered,
        numbers=gathered.numbers[kept],
        places=gathered.places[kept],
        seconds=gathered.seconds[kept],
        columns={name: values[kept] for name, values in gathered.columns.items()},
        labels={},
        truth={name: values[kept] for name, values in gathered.truth.items()},
        each=None if gathered.each is None else gathered.each[kept],
        damaged=tuple(sorted({*gathered.damaged, *map(int, gathered.places[lost])})),
    )


def read_waveforms(source: Source, numbers: NDArray[np.int64]) -> list[Waveform]:
    """Read records of a run by their numbers, which rise, in one pass."""
    wanted = set(numbers.tolist())
    between = source.records(range(int(numbers[0]), int(numbers[-1]) + 1)) if wanted else ()
    found = [saved_waveform(record, source.path) for record in between if record.number in wanted]
    if len(found) < len(wanted):  # SQLite finds them by one way through its pages and not by another
        lost = len(wanted) - len(found)
        raise RunError(f"{source.path}: is damaged: {lost} records cannot be read a second time")
    return found
