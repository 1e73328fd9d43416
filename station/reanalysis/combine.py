"""One result out of many sources, and files of an oscilloscope seen as a run."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis import Flag, fit_harmonics
from analysis.channel import ChannelResponse
from analysis.lock_in_run import AxisRates, RecordArrays, RunArrays, evaluate
from instrument import Waveform
from station.errors import NoUsableSignal, UsageError
from station.files import given_back
from station.live.events import Progress
from station.lock_in.beams import beams_of_files
from station.lock_in.columns import Collected, read_waveforms
from station.lock_in.estimate import Gathered, estimate_pieces
from station.lock_in.evaluate import LockInEvaluation, RowsOnDemand, errors_in_words, gathered_arrays
from station.lock_in.quantities import record_documents
from station.lock_in.report import sections
from station.lock_in.result import result
from station.lock_in.settings import (
    ask_scale_factor,
    channel_response,
    knowledge_of_files,
    load_settings,
    stated_of_files,
)
from station.reanalysis.analyze_table import Work
from station.results.numbers import AMPLITUDE, BEAT_FREQUENCY, INPUT_RATE, SCALE_FACTOR
from station.results.result import FactTable, Result, Section, TextTable, plain, with_prefix
from station.results.verdict import LimitOutcome, Verdict, judged, limits_in, worst
from station.ring_laser.records import saved_waveform
from station.runs.database import COMPLETE, RunFacts
from station.runs.store import SavedRun
from station.settings import read_text, read_toml
from station.shell.finish import SCHEMA_VERSION, standing_document
from station.sources.batches import ExcludedRecord, Source, check_over_time
from station.sources.find import open_source
from station.sources.workers import ThisProcess, Workers
from station.terminal import ask_number

ONE_RATE = 0.02  # beat frequencies of records at one rate differ by less than this share

FILE_COLUMN, RATE_COLUMN, U_COLUMN = "file", INPUT_RATE.key(), "input_rate_u_dps"


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
    if settings is not None and settings.beams.channels and config is not None:
        channel = channel or load_settings(config).scope.channel  # the others are no beats
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
    names, waveforms = _names(used, whole.places), _waveforms(used, whole.numbers, work.opened)
    knowledge = knowledge_of_files(found.wfids, method, config)
    axis = _stated_rates(used, rates)
    if axis is None and method.input_rate is None:
        axis = _asked_rates(used, estimated.beat_frequency)
    unknown = np.broadcast_to(math.nan, (len(whole),))
    slow = replace(
        gathered_arrays(whole, waveforms.many),
        table_rate=unknown if axis is None else axis.rates,
        azimuth_start=unknown,
        azimuth_end=unknown,
        over_lock_in=unknown,
    )
    none = np.empty(0)
    no_fast_run = RecordArrays((), slow.n_channels, np.empty(0, dtype=np.int64), *[none] * 5)
    with errors_in_words(), given_back():
        beams = None
        if settings is not None and settings.beams.channels and len(used) == len(whole):
            files = [one.name for one in used]
            beams = beams_of_files(files, work.opened, estimated.beat_frequency, settings)
        found_run = evaluate(RunArrays(slow, no_fast_run, beams), knowledge, method, estimated, axis)
    shown = LockInEvaluation(
        **vars(found_run), names=names, waveforms=waveforms, damaged=tuple(str(n + 1) for n in whole.damaged)
    )
    paths = tuple(Path(one.name) for one in used)
    said, about = result(shown), tuple(one.about for one in used)
    limited = stated_of_files(config)
    tested = () if limited is None else judged(said, said.document, limits_in(limited.limits.model_dump(), said))
    return AnalyzedFiles(paths, shown, None, said, tuple(left_out), about, tested)


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
        self.left_out: list[ExcludedRecord] = []

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
            self.left_out.append(
                ExcludedRecord(part.name, None, f"holds the same records as {first}: counted once")
            )
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


def _names(used: Sequence[_Used], places: NDArray[np.int64]) -> RowsOnDemand[str]:
    """What records of many sources are called: by their file, or by it and their number in it."""
    ends = np.cumsum([one.count for one in used])
    begins = np.cumsum([0, *(one.taken for one in used)])

    def called(rows: NDArray[np.intp]) -> list[str]:
        of = np.searchsorted(ends, rows, side="right")
        numbers = places[rows] - begins[of] + 1
        named = ((used[source], number) for source, number in zip(of, numbers, strict=True))
        return [one.name if one.taken == 1 else f"{one.name}, {number}" for one, number in named]

    return RowsOnDemand(int(ends[-1]), called)


def _waveforms(
    used: Sequence[_Used], numbers: NDArray[np.int64], opened: Mapping[str, Source]
) -> RowsOnDemand[Waveform]:
    """Records of many sources, each source read in one pass."""
    ends = np.cumsum([one.count for one in used])

    def read(rows: NDArray[np.intp]) -> list[Waveform]:
        of = np.searchsorted(ends, rows, side="right")
        sources = ((used[place].name, rows[of == place]) for place in np.unique(of).tolist())
        each = ((opened.get(name) or open_source(Path(name)), numbers[some]) for name, some in sources)
        return [wave for source, some in each for wave in read_waveforms(source, some)]

    return RowsOnDemand(int(ends[-1]), read)


def said_of(left_out: Sequence[ExcludedRecord], most: int = 20) -> list[str]:
    """Name what was left out, at most so many of them."""
    said = [f"left out: {one}" for one in left_out[:most]]
    return said if len(left_out) <= most else [*said, f"left out: {len(left_out) - most} more"]


# --------------------
# Files that an oscilloscope wrote, analysed without a run


_HARMONICS = 5

SIDE_FILE = "gyrolock.toml"  # settings beside the files of a memory card


@dataclass(frozen=True)
class AnalyzedFiles:
    """One file, or several as records at one rate, and what they say; see `station.report.show.Shown`."""

    paths: tuple[Path, ...]
    found: LockInEvaluation
    harmonics: list[dict[str, float]] | None
    result: Result
    left_out: tuple[ExcludedRecord, ...] = ()
    about: tuple[dict[str, str | None], ...] = ()
    tested: tuple[LimitOutcome, ...] = ()

    @property
    def verdict(self) -> Verdict | None:
        """The worst of all limits; without limits ``None``."""
        return worst(one.verdict for one in self.tested)

    @property
    def heading(self) -> str:
        """What was measured."""
        return f"Lock-in rate: {len(self.paths)} files" if len(self.paths) > 1 else "Lock-in rate"

    @property
    def run(self) -> SavedRun:
        """A run that holds nothing but where the files are."""
        return SavedRun(self.paths[0], RunFacts({"command": "analyze", "outcome": COMPLETE}), (), None)

    def sections(self) -> list[Section]:
        """Figures and tables."""
        return sections(self.found, self.result)

    def fact_tables(self) -> list[FactTable]:
        """Method, files, and what they say of the oscilloscope."""
        names = [(f"{number}", str(path)) for number, path in enumerate(self.paths[:40], start=1)]
        if len(self.paths) > len(names):
            names.append(("", f"and {len(self.paths) - len(names)} more"))
        missing = [(str(Path(one.source).name), one.reason) for one in self.left_out[:40]]
        said = [(first, rest) for first, _, rest in (line.partition("   ") for line in self.taken_with())]
        return [
            FactTable("Result", self.result.summary),
            FactTable("Oscilloscope", said),
            FactTable("Files", names),
            FactTable("Left out", missing),
        ]

    def document(self) -> dict[str, Any]:
        """Return the result as plain JSON; of one file with its harmonics."""
        schema = {"name": "gyrolock files", "version": SCHEMA_VERSION}
        document = {"schema": schema, **self.result.document, "flags": self.result.flags, "run": None}
        document |= standing_document(self.result)
        document |= {"limits": [one.as_json() for one in self.tested], "verdict": self.verdict}
        if len(self.paths) > 1:
            missing = [{"source": o.source, "record": o.record, "reason": o.reason} for o in self.left_out]
            scopes = [dict(one) for one in dict.fromkeys(tuple(about.items()) for about in self.about)]
            return dict(plain(document | {"files": self.paths, "left_out": missing, "taken_with": scopes}))
        document |= {"file": self.paths[0], "harmonics": self.harmonics}
        if self.harmonics and not np.isfinite(document[BEAT_FREQUENCY.key()]):
            document[BEAT_FREQUENCY.key()] = self.harmonics[0]["frequency_hz"]
        return dict(plain(document))

    def taken_with(self) -> list[str]:
        """Say what the files say of the oscilloscopes that wrote them, one line each."""
        told = ([f"{name} {value}" for name, value in about.items() if value] for about in self.about)
        return [f"oscilloscope   {', '.join(one)}" for one in dict.fromkeys(map(tuple, told)) if one]

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield one plain JSON object for each record."""
        return (dict(plain(row)) for row in record_documents(self.found, "file"))


def analyze_file(source: Path | Source, config: Path | None, choices: Mapping[str, Any]) -> AnalyzedFiles:
    """Analyse a file of an oscilloscope; NoUsableSignal if it holds no signal over time."""
    opened = open_source(source)
    (record,) = opened.records()
    waveform = saved_waveform(record, opened.path)
    check_over_time(waveform, opened.name)
    chosen = {name: value for name, value in choices.items() if value is not None}
    if "scale_factor" not in chosen:
        chosen["scale_factor"] = scale_factor_of_files(config, [source])
    analyzed = combine([opened], chosen, ThisProcess(), Progress(), config=config)
    if int(analyzed.found.combined.flags) & int(Flag.NO_BEAT | Flag.CONSTANT):
        return analyzed
    if (harmonics := harmonics_of(waveform)) is None:
        return analyzed
    first = harmonics[0][AMPLITUDE.key()]
    rows = tuple(
        (
            f"{one['order']}",
            with_prefix(one["frequency_hz"], "Hz"),
            with_prefix(one[AMPLITUDE.key()], "V"),
            f"{one['amplitude_v'] / first:.4f}" if first > 0 else "",
        )
        for one in harmonics
    )
    tables = (*analyzed.result.tables, TextTable(("harmonic", "frequency", "amplitude", "of the first"), rows))
    return replace(analyzed, harmonics=harmonics, result=replace(analyzed.result, tables=tables))


def scale_factor_of_files(config: Path | None, files: Sequence[Path | Source] = ()) -> float:
    """Return the scale factor of the gyro whose records are files."""
    # From a settings file, from ``gyrolock.toml`` beside the files or in the folder above, or asked for once. What
    # the shipped settings say of their simulated gyro is not true of another one.
    if config is not None and (stated := _stated_of_files(config)) is not None:
        return stated
    folders = dict.fromkeys(file.parent for file in files if isinstance(file, Path))
    files_of = {folder: (folder / SIDE_FILE, folder.parent / SIDE_FILE) for folder in folders}
    beside = {
        folder: next((_stated_of_files(one) for one in some if one.is_file()), None)
        for folder, some in files_of.items()
    }
    if len(set(beside.values())) > 1:
        first, second = [f"{folder} has {one or 'none'}" for folder, one in beside.items()][:2]
        raise UsageError(f"mixed scale factors: {first}, {second}: give --scale-factor")
    found = next(iter(beside.values()), None)
    return _asked_scale_factor() if found is None else found


def front_end_of_files(config: Path | None) -> dict[str, Any] | None:
    """The channel that a settings file states, for records of any source; ``None`` where it states none."""
    settings = stated_of_files(config)
    if settings is None or config is None or "front_end" not in read_toml(config):
        return None
    return settings.front_end.model_dump(exclude={"response_file"})  # what it holds is read already


def states_scale_factor(config: Path | None) -> bool:
    """Whether a settings file says how many pulses per degree the gyro has."""
    return config is not None and _stated_of_files(config) is not None


def _stated_of_files(config: Path) -> float | None:
    """The scale factor that a settings file states itself."""
    settings = load_settings(config)
    if SCALE_FACTOR.key() in read_toml(config).get("gyro", {}):
        return settings.gyro.scale_factor_pulses_per_deg
    return None


_asked_scale_factor = cache(ask_scale_factor)


def harmonics_of(waveform: Waveform) -> list[dict[str, float]] | None:
    """Return the harmonics of a record, also where they are none of a gyro; ``None`` if it has none."""
    if np.nanmax(waveform.volts) == np.nanmin(waveform.volts):
        return None
    fit = fit_harmonics(waveform.volts, waveform.sample_interval, harmonics=_HARMONICS, nan_policy="omit")
    if not np.isfinite(fit.frequency):
        return None
    return [
        {
            "order": order,
            "frequency_hz": order * float(fit.frequency),
            AMPLITUDE.key(): float(np.abs(amplitude)),
            "phase_rad": float(np.angle(amplitude)),
        }
        for order, amplitude in enumerate(fit.amplitudes, start=1)
    ]
