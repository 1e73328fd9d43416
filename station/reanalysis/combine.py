"""One result out of many sources: files of a memory card, or runs of one gyro."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from analysis.lock_in_run import AxisRates, Method, RecordArrays, RunArrays, evaluate
from instrument import Waveform
from station.errors import NoUsableSignal, RunError, UsageError
from station.lock_in.found import LockInFound
from station.lock_in.knowledge import knowledge_of_records, run_knowledge
from station.lock_in.read import gathered_arrays
from station.lock_in.records.pieces import Gathered, Piece, estimate_pieces, together
from station.lock_in.result import result
from station.lock_in.settings import load_settings
from station.reanalysis.files import AnalyzedFiles
from station.ring_laser.records import saved_waveform
from station.runs.operator import ask_number
from station.runs.progress import Progress
from station.settings.toml_files import read_text
from station.sources.batches import LeftOut
from station.sources.find import open_source
from station.sources.source import Source
from station.sources.workers import Workers

TOGETHER = 200
"""Sources that make one piece of work."""

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
    """Make one result with its budget of the records of many sources.

    Parameters
    ----------
    sources : iterable of Path or Source
        Files, runs, what lies in data sets.
    choices : mapping
        Of :class:`analysis.lock_in_run.Method`.
    config : Path, optional
        Settings file: what is known of the bench.
    channel : str, optional
        Only records of this input.
    rates : Path, optional
        CSV with the rate on the gyro's axis of each file, where they are at several.

    Raises
    ------
    UsageError
        The sources are not of one gyro, or of one channel, or at several rates that nobody states.
    NoUsableSignal
        None of them holds a record of a beat.
    """
    everything = list(sources)
    work = [
        [Piece(source, None, choices) for source in everything[first : first + TOGETHER]]
        for first in range(0, len(everything), TOGETHER)
    ]
    progress.start("pieces of work", len(work))
    parts: list[Gathered] = []
    for found in workers.map(estimate_pieces, work):
        parts += [_of_channel(part, channel) for part in found]
        progress.advance()
    left_out = [one for part in parts for one in part.left_out]
    used = [part for part in parts if part.each is not None]
    if not used:
        reason = f": {left_out[0]}" if left_out else ""
        raise NoUsableSignal(f"none of {len(everything)} sources holds a record of a beat{reason}")
    method = _one_gyro(used)
    names = [name for part in used for name in _names(part)]
    waveforms = _Waveforms([part.name for part in used], [part.numbers for part in used])
    whole = together(used)
    knowledge = run_knowledge(load_settings(config)) if config is not None else None
    if knowledge is None:
        knowledge = knowledge_of_records(whole.labels["wfid"], method)
    estimated = whole.each
    if estimated is None:
        raise NoUsableSignal("no record is left")
    axis = _stated_rates(used, rates)
    if axis is None and method.input_rate is None:
        axis = _asked_rates(used, estimated.beat_frequency)
    unknown = np.full(len(whole), math.nan)
    slow = replace(
        gathered_arrays(whole, waveforms),
        table_rate=unknown if axis is None else axis.rates,
        azimuth_start=unknown,
        azimuth_end=unknown,
        over_lock_in=unknown,
    )
    found_run = evaluate(RunArrays(slow, _nothing(slow)), knowledge, method, estimated, axis)
    shown = LockInFound(
        **vars(found_run), names=names, waveforms=waveforms, damaged=tuple(str(n + 1) for n in whole.damaged)
    )
    paths = tuple(Path(part.name) for part in used)
    return AnalyzedFiles(paths, shown, None, result(shown), tuple(left_out), tuple(part.about for part in used))


def _nothing(like: RecordArrays) -> RecordArrays:
    """No fast run."""
    none = np.empty(0)
    count = np.empty(0, dtype=np.int64)
    return RecordArrays((), like.n_channels, count, none, none, none, none, none)


def _names(part: Gathered) -> list[str]:
    if part.taken == 1:
        return [part.name]
    return [f"{part.name}, {place + 1}" for place in part.places.tolist()]


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


def _one_gyro(parts: Sequence[Gathered]) -> Method:
    """The method of all; UsageError if they are not of one gyro and one channel."""
    for what, said in (
        (
            "scale factors",
            {part.name: f"{part.method.scale_factor:g}" for part in parts if part.method is not None},
        ),
        ("units", {part.name: part.about["unit"] for part in parts if part.about.get("unit")}),
        ("gyros", {part.name: part.about["gyro"] for part in parts if part.about.get("gyro")}),
        ("inputs", {part.name: name for part in parts for name in part.labels["channel"] if name}),
    ):
        first = next(iter(said.items()), None)
        other = next((item for item in said.items() if first is not None and item[1] != first[1]), None)
        if first is not None and other is not None:
            advice = {"scale factors": "give --scale-factor", "inputs": "choose one with --channel"}.get(
                what, "combine those of one"
            )
            raise UsageError(
                f"mixed {what}: {first[0]} has {first[1]}, {other[0]} has {other[1]}: {advice}, or leave --combine"
            )
    if any(part.paired for part in parts):
        raise UsageError("runs with a second photodiode are not combined: analyze them one by one")
    method = parts[0].method
    if method is None:
        raise RunError(f"{parts[0].name}: was not read")
    return method


def _stated_rates(parts: Sequence[Gathered], rates: Path | None) -> AxisRates | None:
    if rates is None:
        return None
    stated = read_rates(rates)
    missing = [part.name for part in parts if _stated(part.name, stated) is None]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise UsageError(f"{rates}: says no rate for {missing[0]}{more}: add a line for it")
    found = [_stated(part.name, stated) or (math.nan, 0.0) for part in parts]
    return _axis_rates(parts, found)


def _axis_rates(parts: Sequence[Gathered], found: Sequence[tuple[float, float]]) -> AxisRates:
    counts = [len(part) for part in parts]
    rates = np.repeat([rate for rate, _ in found], counts)
    return AxisRates(rates, np.zeros(rates.size), np.repeat([u for _, u in found], counts))


def _stated(name: str, stated: Mapping[str, tuple[float, float]]) -> tuple[float, float] | None:
    """The rate of a file that is named with as much of its path as makes it plain."""
    parts = Path(name).parts
    for first in range(len(parts)):
        if (found := stated.get("/".join(parts[first:]))) is not None:
            return found
    return stated.get(name)


def read_rates(path: Path) -> dict[str, tuple[float, float]]:
    """Read the rates of files.

    Parameters
    ----------
    path : Path
        CSV with the columns ``file``, ``input_rate_dps`` and, if known, ``input_rate_u_dps``.

    Returns
    -------
    dict
        Rate on the gyro's axis and its standard uncertainty, deg/s, by the file's name as it stands there.

    Raises
    ------
    UsageError
        A column or a number is missing, or a file is there twice.
    """
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


def _asked_rates(parts: Sequence[Gathered], frequency: NDArray[np.float64]) -> AxisRates | None:
    """Ask for the rate of each source where the beats show that there are several; ``None`` at one rate.

    Raises
    ------
    UsageError
        There is nobody to ask.
    """
    beats = frequency[np.isfinite(frequency)]
    if len(parts) < 2 or not beats.size or np.ptp(beats) < ONE_RATE * beats.max():
        return None
    missing = (
        f"the beats go from {beats.min():.4g} to {beats.max():.4g} Hz: the records were taken at several rates: "
        "give --rates-from FILE.csv, or analyze those of one rate"
    )
    found = [(ask_number(f"Rate on the gyro's axis in {part.name}, deg/s: ", missing), 0.0) for part in parts]
    return _axis_rates(parts, found)


class _Waveforms(Sequence[Waveform]):
    """Records of many sources, read when they are asked for."""

    def __init__(self, names: Sequence[str], numbers: Sequence[NDArray[np.int64]]) -> None:
        self._names, self._numbers = names, numbers
        self._ends = np.cumsum([part.size for part in numbers])

    def __len__(self) -> int:
        return int(self._ends[-1])

    @overload
    def __getitem__(self, place: int) -> Waveform: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[Waveform]: ...
    def __getitem__(self, place: int | slice) -> Waveform | Sequence[Waveform]:
        if isinstance(place, slice):
            return [self[one] for one in range(*place.indices(len(self)))]
        part = int(np.searchsorted(self._ends, place, side="right"))
        within = place - (int(self._ends[part - 1]) if part else 0)
        number = int(self._numbers[part][within])
        path = Path(self._names[part])
        (record,) = open_source(path).records(range(number, number + 1))
        return saved_waveform(record, path)


def said_of(left_out: Sequence[LeftOut], most: int = 20) -> list[str]:
    """Name what was left out, at most so many of them."""
    said = [f"left out: {one}" for one in left_out[:most]]
    return said if len(left_out) <= most else [*said, f"left out: {len(left_out) - most} more"]
