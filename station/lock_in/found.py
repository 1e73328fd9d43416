"""The result of a run with the records that it was found from, for everything that shows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

from analysis import flag_names
from analysis.lock_in_run import LockInRun, Method
from instrument import Waveform
from station.ring_laser.records import saved_waveform
from station.sources.source import Source

RELATIONS = {
    "exact": "harmonic ratio, exact relation",
    "paper-13": "harmonic ratio, relation (13) of the paper",
    "paper-10": "harmonic ratio, relation (10) of the paper",
}


@dataclass(frozen=True, kw_only=True)
class LockInFound(LockInRun):
    """What the records of a run say, and the records."""

    names: Sequence[str]  # what each record is called: its number in the run, or its file
    waveforms: Sequence[Waveform]  # the records; those of a long run are read when they are asked for
    damaged: tuple[str, ...] = ()  # records that were left out because they are not what was once saved
    truth: dict[str, float] | None = None  # the true values of a simulated run
    without_beat: tuple[str, ...] = ()  # rates of several that gave no record

    @property
    def method_text(self) -> str:
        """Describe in words how the lock-in rate was found."""
        text = describe_method(self.method)
        if self.quadratures is not None:
            text = f"{text}, sine and cosine channel"
        if self.several is None:
            return text
        fitted = {"lock-in": "", "distortion": " and distortion", "gain": " and gain corner"}
        fit = self.several.by_beat
        what = "" if fit is None else fitted.get(fit.model, ", distortion and gain corner")
        return f"{text}; lock-in rate{what} fitted to {len(self.several.groups)} rates"

    @property
    def flags(self) -> list[str]:
        """Names of the flags of the combined result, and of the store."""
        names = flag_names(int(self.combined.flags))
        return [*names, "damaged"] if self.damaged and "damaged" not in names else names

    @property
    def records_rejected(self) -> int:
        """Records that do not count in the combined result."""
        return int(self.combined.records_rejected) + len(self.damaged)


def describe_method(method: Method) -> str:
    """Describe in words how single records are turned into a lock-in rate."""
    reference = "self-referenced" if method.input_rate is None else "input rate given"
    return f"{RELATIONS[method.relation]}, {reference}"


class Numbered(Sequence[str]):
    """Names of records that are called by their places, from 0: "1", "2", ..."""

    def __init__(self, places: NDArray[np.int64]) -> None:
        self._places = places

    def __len__(self) -> int:
        return int(self._places.size)

    @overload
    def __getitem__(self, place: int) -> str: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[str]: ...
    def __getitem__(self, place: int | slice) -> str | Sequence[str]:
        if isinstance(place, slice):
            return Numbered(self._places[place])
        return str(self._places[place] + 1)


class SavedWaveforms(Sequence[Waveform]):
    """Records of a run by their numbers, read from it when they are asked for."""

    def __init__(self, source: Source, numbers: NDArray[np.int64]) -> None:
        self._source, self._numbers = source, numbers

    def __len__(self) -> int:
        return int(self._numbers.size)

    @overload
    def __getitem__(self, place: int) -> Waveform: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[Waveform]: ...
    def __getitem__(self, place: int | slice) -> Waveform | Sequence[Waveform]:
        if isinstance(place, slice):
            return SavedWaveforms(self._source, self._numbers[place])
        number = int(self._numbers[place])
        (record,) = self._source.records(range(number, number + 1))
        return saved_waveform(record, self._source.path)

    def many(self, rows: NDArray[np.intp]) -> list[Waveform]:
        """Read some records, whose rows rise, in one pass."""
        numbers = self._numbers[rows]
        wanted = set(numbers.tolist())
        between = self._source.records(range(int(numbers[0]), int(numbers[-1]) + 1))
        return [saved_waveform(record, self._source.path) for record in between if record.number in wanted]
