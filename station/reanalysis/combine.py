"""One result out of many sources: files of a memory card, or runs of one gyro."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from analysis.channel import ChannelResponse
from analysis.lock_in_run import AxisRates, RecordArrays, RunArrays, evaluate
from instrument import Waveform
from station.errors import NoUsableSignal, UsageError
from station.lock_in.found import LockInFound, SavedWaveforms
from station.lock_in.knowledge import channel_response, knowledge_of_files, stated_of_files
from station.lock_in.read import errors_in_words, gathered_arrays
from station.lock_in.records.collected import Collected
from station.lock_in.records.pieces import Gathered, estimate_pieces
from station.lock_in.result import result
from station.memory import given_back
from station.reanalysis.files import AnalyzedFiles, tested_by
from station.reanalysis.work import Work
from station.runs.operator import ask_number
from station.runs.progress import Progress
from station.settings.toml_files import read_text
from station.sources.batches import LeftOut
from station.sources.find import open_source
from station.sources.source import Source
from station.sources.workers import Workers

ONE_RATE = 0.02
"""Beat frequencies of records at one rate differ by less than this share."""

FILE_COLUMN, RATE_COLUMN, U_COLUMN = "file", "input_rate_dps", "input_rate_u_dps"


def combine(
    sources: Iterable[Path | Source],
    choices: Mapping[str, Any],
    workers: Workers,
    progress: Progress,
    *,
    config: Path | None = None,
    channel: str | None = None,
    rates: Path | None = None,
) -> AnalyzedFiles:
    """Make one result with its budget of the records of many sources."""
    work = Work(sources, choices, whole=True)
    settings = stated_of_files(config)
    found = _Sources(channel, None if settings is None else channel_response(settings.front_end))
    for parts in work.done_by(workers, estimate_pieces, progress):
        for part in parts:
            with errors_in_words():
                found.add(part)
    whole, left_out = found.gathered(), found.left_out
    if whole is None or whole.each is None or whole.method is None:
        reason = f": {left_out[0]}" if left_out else ""
        raise NoUsableSignal(f"none of {len(work)} sources holds a record of a beat{reason}")
    used, method, estimated = found.used, whole.method, whole.each
    names, waveforms = _Names(used, whole.places), _Waveforms(used, whole.numbers, work.opened)
    knowledge = knowledge_of_files(found.wfids, method, config)
    axis = _stated_rates(used, rates)
    if axis is None and method.input_rate is None:
        axis = _asked_rates(used, estimated.beat_frequency)
    unknown = np.broadcast_to(math.nan, (len(whole),))
    slow = replace(
        gathered_arrays(whole, waveforms),
        table_rate=unknown if axis is None else axis.rates,
        azimuth_start=unknown,
        azimuth_end=unknown,
        over_lock_in=unknown,
    )
    with errors_in_words(), given_back():
        found_run = evaluate(RunArrays(slow, _nothing(slow)), knowledge, method, estimated, axis)
    shown = LockInFound(
        **vars(found_run), names=names, waveforms=waveforms, damaged=tuple(str(n + 1) for n in whole.damaged)
    )
    paths = tuple(Path(one.name) for one in used)
    said, about = result(shown), tuple(one.about for one in used)
    return AnalyzedFiles(paths, shown, None, said, tuple(left_out), about, tested_by(config, said))


@dataclass
class _Used:
    """A source of which records count."""

    name: str
    about: dict[str, str | None]  # what it says of unit, gyro and oscilloscope
    taken: int  # records that it holds, and that were estimated
    count: int


class _Sources:
    """Sources of one gyro and one channel, as their pieces come: their estimates, and what else is needed."""

    def __init__(self, channel: str | None, response: ChannelResponse | None) -> None:
        self._channel, self._collected = channel, Collected(response)
        self._said: dict[str, tuple[str, str]] = {}
        self._seen: dict[str, str] = {}
        self._last = ""
        self.used: list[_Used] = []
        self.wfids: dict[str, None] = {}
        self.left_out: list[LeftOut] = []

    def add(self, part: Gathered) -> None:
        """Take a piece of a source, or a whole one."""
        self.left_out += part.left_out
        if part.each is None or self._is_known(part):
            return
        part = _of_channel(part, self._channel)
        if part.each is None:
            return
        self._check(part)
        self.wfids |= dict.fromkeys(part.labels["wfid"])
        # what says the rates is asked of whoever combines: the fast run of each source is not needed
        self._collected.add(replace(part, fast=()))
        if self.used and self.used[-1].name == part.name:
            self.used[-1].taken += part.taken
            self.used[-1].count += len(part)
            return
        about = part.about if not self.used or self.used[-1].about != part.about else self.used[-1].about
        self.used.append(_Used(part.name, about, part.taken, len(part)))

    def gathered(self) -> Gathered | None:
        """All records together; ``None`` if there is none."""
        return self._collected.gathered() if self.used else None

    def _is_known(self, part: Gathered) -> bool:
        """Whether the same measurement was there already: counted twice it would seem better known than it is."""
        if part.sha256 and (first := self._seen.setdefault(part.sha256, part.name)) != part.name:
            self.left_out.append(LeftOut(part.name, None, f"holds the same records as {first}: counted once"))
            return True
        return False

    def _check(self, part: Gathered) -> None:
        if part.paired:
            raise UsageError(
                f"{part.name}: runs with a second photodiode are not combined: analyze them one by one"
            )
        factor = "" if part.method is None else f"{part.method.scale_factor:g}"
        said: dict[str, Iterable[str | None]] = {
            "scale factors": [factor],
            "units": [part.about.get("unit")],
            "gyros": [part.about.get("gyro")],
            "inputs": dict.fromkeys(part.labels["channel"]),
        }
        for what, values in said.items():
            for value in filter(None, values):
                first, there = self._said.setdefault(what, (part.name, value))
                if value != there:
                    advice = _ADVICE.get(what, "combine those of one")
                    raise UsageError(
                        f"mixed {what}: {first} has {there}, {part.name} has {value}: {advice}, or leave --combine"
                    )


_ADVICE = {"scale factors": "give --scale-factor", "inputs": "choose one with --channel"}


def _nothing(like: RecordArrays) -> RecordArrays:
    """No fast run."""
    none = np.empty(0)
    count = np.empty(0, dtype=np.int64)
    return RecordArrays((), like.n_channels, count, none, none, none, none, none)


def _of_channel(part: Gathered, channel: str | None) -> Gathered:
    """The records of one input."""
    if channel is None or part.each is None:
        return part
    rows = np.flatnonzero([name.upper() == channel.upper() for name in part.labels["channel"]])
    return replace(
        part,
        numbers=part.numbers[rows],
        places=part.places[rows],
        columns={name: values[rows] for name, values in part.columns.items()},
        labels={name: [texts[row] for row in rows] for name, texts in part.labels.items()},
        truth={name: values[rows] for name, values in part.truth.items()},
        each=part.each[rows] if rows.size else None,
    )


def _stated_rates(parts: Sequence[_Used], rates: Path | None) -> AxisRates | None:
    if rates is None:
        return None
    stated = read_rates(rates)
    missing = [part.name for part in parts if _stated(part.name, stated) is None]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise UsageError(f"{rates}: says no rate for {missing[0]}{more}: add a line for it")
    found = [_stated(part.name, stated) or (math.nan, 0.0) for part in parts]
    return _axis_rates(parts, found)


def _axis_rates(parts: Sequence[_Used], found: Sequence[tuple[float, float]]) -> AxisRates:
    counts = [part.count for part in parts]
    rates = np.repeat([rate for rate, _ in found], counts)
    return AxisRates(rates, np.broadcast_to(0.0, rates.shape), np.repeat([u for _, u in found], counts))


def _stated(name: str, stated: Mapping[str, tuple[float, float]]) -> tuple[float, float] | None:
    """The rate of a file that is named with as much of its path as makes it plain."""
    parts = Path(name).parts
    for first in range(len(parts)):
        if (found := stated.get("/".join(parts[first:]))) is not None:
            return found
    return stated.get(name)


def read_rates(path: Path) -> dict[str, tuple[float, float]]:
    """Read the rates of files."""
    text = read_text(path)
    separator = ";" if text.partition("\n")[0].count(";") else ","
    rows = csv.DictReader(text.splitlines(), delimiter=separator, skipinitialspace=True)
    if not {FILE_COLUMN, RATE_COLUMN} <= set(rows.fieldnames or ()):
        raise UsageError(f"{path}: needs the columns {FILE_COLUMN} and {RATE_COLUMN} in its first line")
    found: dict[str, tuple[float, float]] = {}
    for number, row in enumerate(rows, start=2):
        name = (row[FILE_COLUMN] or "").strip().replace("\\", "/").removeprefix("./")
        try:
            rate = float((row[RATE_COLUMN] or "").replace(",", "."))
            u = float((row.get(U_COLUMN) or "0").replace(",", "."))
        except ValueError:
            rate, u = math.nan, 0.0
        if not (name and math.isfinite(rate) and rate and math.isfinite(u) and u >= 0):
            raise UsageError(f"{path}: line {number}: needs a file and a rate in deg/s other than 0")
        if name in found:
            raise UsageError(f"{path}: line {number}: {name} is there twice")
        found[name] = rate, u
    return found


def _asked_rates(parts: Sequence[_Used], frequency: NDArray[np.float64]) -> AxisRates | None:
    """Ask for the rate of each source where the beats show that there are several; ``None`` at one rate."""
    beats = frequency[np.isfinite(frequency)]
    if len(parts) < 2 or not beats.size or np.ptp(beats) < ONE_RATE * beats.max():
        return None
    missing = (
        f"the beats go from {beats.min():.4g} to {beats.max():.4g} Hz: the records were taken at several rates: "
        "give --rates-from FILE.csv, or analyze those of one rate"
    )
    found = [(ask_number(f"Rate on the gyro's axis in {part.name}, deg/s: ", missing), 0.0) for part in parts]
    return _axis_rates(parts, found)


class _Names(Sequence[str]):
    """What records of many sources are called: by their file, or by it and their number in it."""

    def __init__(self, used: Sequence[_Used], places: NDArray[np.int64]) -> None:
        self._used, self._places = used, places
        self._ends = np.cumsum([one.count for one in used])
        self._begins = np.cumsum([0, *(one.taken for one in used)])

    def __len__(self) -> int:
        return int(self._ends[-1])

    @overload
    def __getitem__(self, place: int) -> str: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[str]: ...
    def __getitem__(self, place: int | slice) -> str | Sequence[str]:
        if isinstance(place, slice):
            return [self[one] for one in range(*place.indices(len(self)))]
        source = int(np.searchsorted(self._ends, place, side="right"))
        one = self._used[source]
        return one.name if one.taken == 1 else f"{one.name}, {self._places[place] - self._begins[source] + 1}"


class _Waveforms(Sequence[Waveform]):
    """Records of many sources, read when they are asked for."""

    def __init__(self, used: Sequence[_Used], numbers: NDArray[np.int64], opened: Mapping[str, Source]) -> None:
        self._used, self._numbers, self._opened = used, numbers, opened
        self._ends = np.cumsum([one.count for one in used])

    def __len__(self) -> int:
        return int(self._ends[-1])

    @overload
    def __getitem__(self, place: int) -> Waveform: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[Waveform]: ...
    def __getitem__(self, place: int | slice) -> Waveform | Sequence[Waveform]:
        if isinstance(place, slice):
            return [self[one] for one in range(*place.indices(len(self)))]
        return self.many(np.array([place]))[0]

    def many(self, rows: NDArray[np.intp]) -> list[Waveform]:
        """Read some records, whose rows rise, each source in one pass."""
        found: list[Waveform] = []
        of = np.searchsorted(self._ends, rows, side="right")
        for place in np.unique(of).tolist():
            name = self._used[place].name
            source = self._opened.get(name) or open_source(Path(name))
            found += SavedWaveforms(source, self._numbers[rows[of == place]]).many(np.arange(np.sum(of == place)))
        return found


def said_of(left_out: Sequence[LeftOut], most: int = 20) -> list[str]:
    """Name what was left out, at most so many of them."""
    said = [f"left out: {one}" for one in left_out[:most]]
    return said if len(left_out) <= most else [*said, f"left out: {len(left_out) - most} more"]
