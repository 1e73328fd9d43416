"""From saved records to the result: read once, as arrays; always computed again, never remembered."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean
from typing import Any, Protocol, overload

import numpy as np
from numpy.typing import NDArray

from analysis import LockInEstimate, flag_names
from analysis.arrays import NoTilt, OneRateOnly, OutsideResponse
from analysis.lock_in_run import (
    Batch,
    LockInRun,
    Method,
    PreliminaryLockIn,
    RecordArrays,
    RunArrays,
    Tilt,
    evaluate,
    fast_estimates,
    find_tilt,
    preliminary_lock_in,
    rows_of_batches,
)
from instrument import Waveform
from station.errors import NoUsableSignal, RunError, UsageError
from station.files import given_back
from station.lock_in.columns import Collected, Pairs, whole_pairs
from station.lock_in.estimate import Gathered, Piece, described_records, estimate_pieces, pieces_of
from station.lock_in.settings import Settings, knowledge_of_files, run_knowledge
from station.ring_laser.records import saved_waveform
from station.runs.progress import Progress
from station.runs.store import SavedRecord, SavedRun
from station.sources.batches import Source
from station.sources.workers import Workers

_LOOKED_AT = 200
"""Records that are read together where only some are looked at."""


def evaluate_run(run: SavedRun, settings: Settings, method: Method | None = None) -> LockInEvaluation:
    """Evaluate the records that a run took at its slow rate, or at its slow rates."""
    method = method or Method(settings.gyro.scale_factor_pulses_per_deg)
    acquisitions = acquisitions_of(run)
    intact = [taken for taken in acquisitions if taken.intact]
    if not intact:
        what = "only damaged records" if acquisitions else "no record at the slow rate"
        raise RunError(f"{run.path}: the run holds {what}")
    records = [taken.sine for taken in intact]
    waveforms = tuple(saved_waveform(record, run.path) for record in records)
    cosines = [saved_waveform(taken.cosine, run.path) for taken in intact if taken.cosine is not None]
    channels = (waveforms, cosines) if len(cosines) == len(waveforms) else (waveforms,)
    found = _evaluated(RunArrays(_arrays(channels, records), _fast_run(run)), settings, method)
    shown = records
    if found.several is not None:
        shown = [records[row] for row in found.several.reference_group.rows]
    return LockInEvaluation(
        **vars(found),
        names=tuple(taken.name for taken in intact),
        waveforms=waveforms,
        damaged=tuple(taken.name for taken in acquisitions if not taken.intact),
        truth=_mean_truth(shown),
        without_beat=tuple(run.facts.get("rates_without_beat", ())),
    )


def evaluate_source(
    source: Source, settings: Settings, choices: Mapping[str, Any], workers: Workers, progress: Progress
) -> tuple[LockInEvaluation, tuple[str, ...]] | None:
    """Evaluate a saved run without holding its samples: the same numbers as :func:`evaluate_run`, bit for bit."""
    chosen = {"scale_factor": settings.gyro.scale_factor_pulses_per_deg, **choices}
    gathered = _read_pairs(source, chosen) if settings.scope.quadrature_channel else None
    paired = gathered is not None
    if gathered is None:
        gathered = _estimated(source, settings, chosen, workers, progress)
    if gathered.paired and not paired:
        return None
    if not len(gathered):
        what = "only damaged records" if gathered.taken else "no record at the slow rate"
        raise RunError(f"{source.name}: the run holds {what}")
    fast = _arrays(([saved_waveform(record, source.path) for record in gathered.fast],), gathered.fast)
    waveforms = SavedWaveforms(source, gathered.numbers)
    slow = gathered_arrays(gathered, waveforms)
    if paired:
        slow = replace(slow, batches=Pairs(source, gathered), n_channels=2)
    found = _evaluated(RunArrays(slow, fast), settings, Method(**chosen), gathered.each)
    rows: slice | NDArray[np.intp] = slice(None)
    if found.several is not None:
        rows = found.several.reference_group.rows
    in_words = LockInEvaluation(
        **vars(found),
        names=Numbered(gathered.places),
        waveforms=waveforms,
        damaged=tuple(str(place + 1) for place in gathered.damaged),
        truth={name: fmean(values[rows]) for name, values in gathered.truth.items()} or None,
        without_beat=tuple(source.facts.get("rates_without_beat", ())),
    )
    return in_words, gathered.damage


def _estimated(
    source: Source, settings: Settings, choices: Mapping[str, Any], workers: Workers, progress: Progress
) -> Gathered:
    """Estimates of all records of a run, piece by piece; RunError if it cannot be read."""
    collected, pieces = Collected(run_knowledge(settings).response), pieces_of(source, choices)
    progress.start("thousands of records", len(pieces))
    for (part,) in workers.map(estimate_pieces, pieces):
        if part.left_out and part.left_out[-1].record is None:
            raise RunError(str(part.left_out[-1]))
        with errors_in_words():
            collected.add(part)
        progress.advance()
    return collected.gathered()


def _read_pairs(source: Source, choices: Mapping[str, Any]) -> Gathered | None:
    """What is known of the records of two photodiodes but their samples; ``None`` where not all are pairs."""
    gathered = described_records(Piece(source, None, choices))
    if gathered.left_out and gathered.left_out[-1].record is None:
        raise RunError(str(gathered.left_out[-1]))
    return whole_pairs(gathered)


def _evaluated(
    arrays: RunArrays, settings: Settings, method: Method, estimated: LockInEstimate | None = None
) -> LockInRun:
    with errors_in_words(), given_back():
        return evaluate(arrays, run_knowledge(settings), method, estimated)


@contextmanager
def errors_in_words() -> Iterator[None]:
    """Errors of the evaluation as those of a run."""
    try:
        yield
    except NoTilt as error:
        raise RunError(_no_tilt(error)) from None
    except OutsideResponse as error:
        raise RunError(f"front_end.response: {error}") from None
    except OneRateOnly as error:
        raise UsageError(str(error)) from None


class ReadAgain(Protocol):
    """Records that are read when they are asked for."""

    def many(self, rows: NDArray[np.intp]) -> list[Waveform]:
        """Read some of them, whose rows rise, in one pass."""


@dataclass(frozen=True)
class _AskedFor:
    """Volts of records that are estimated already, for what looks at some of them again."""

    waveforms: ReadAgain
    intervals: NDArray[np.float64]
    samples: NDArray[np.int64]

    def __iter__(self) -> Iterator[Batch]:
        for shape in rows_of_batches(self.intervals, self.samples):
            for first in range(0, shape.size, _LOOKED_AT):
                rows = shape[first : first + _LOOKED_AT]
                waves = self.waveforms.many(rows)
                volts, clipped = [wave.volts for wave in waves], [wave.clipped_samples for wave in waves]
                yield Batch(rows, waves[0].sample_interval, np.array([volts]), np.array([clipped]))


def gathered_arrays(gathered: Gathered, waveforms: ReadAgain) -> RecordArrays:
    """Records as arrays; their samples are read again where some are asked for."""
    columns = gathered.columns
    samples = columns["samples"].astype(np.int64)
    return RecordArrays(
        batches=_AskedFor(waveforms, columns["sample_interval_s"], samples),
        n_channels=1,
        samples=samples,
        level_spacing=columns["level_spacing_v"],
        table_rate=columns["table_rate_dps"],
        azimuth_start=columns["azimuth_start_deg"],
        azimuth_end=columns["azimuth_end_deg"],
        over_lock_in=columns["over_lock_in"],
    )


def evaluate_waveforms(
    waveforms: Sequence[Waveform], names: Sequence[str], method: Method, config: Path | None = None
) -> LockInEvaluation:
    """Evaluate records that come from files: at least one, each with its name; `config` states their bench."""
    nothing: tuple[Waveform, ...] = ()
    arrays = RunArrays(_arrays((waveforms,)), _arrays((nothing,)))
    known = knowledge_of_files((waveform.preamble.wfid for waveform in waveforms), method, config)
    with errors_in_words():
        found = evaluate(arrays, known, method)
    return LockInEvaluation(**vars(found), names=tuple(names), waveforms=tuple(waveforms))


def fast_run_tilt(run: SavedRun, settings: Settings) -> Tilt:
    """Find the tilt from the fast run alone, while the slow records are still to be taken."""
    fast, knowledge = _fast_run(run), run_knowledge(settings)
    try:
        return find_tilt(fast, knowledge)
    except NoTilt as error:
        silent = int((~fast_estimates(fast, knowledge).usable).sum())
        if silent:
            raise NoUsableSignal(
                f"{silent} of {len(fast)} records of the fast run show no steady beat: is the gyro locked for a "
                "part of them? Turn faster (table.fast_rate_dps), or slower where the detector cannot follow"
            ) from None
        raise RunError(_no_tilt(error)) from None


def lock_in_so_far(records: Sequence[SavedRecord], run: SavedRun, settings: Settings) -> PreliminaryLockIn | None:
    """Say what records of a run at one rate say of the lock-in rate; ``None`` if they show no beat."""
    arrays = _arrays(([saved_waveform(record, run.path) for record in records],), records)
    return preliminary_lock_in(arrays, settings.gyro.scale_factor_pulses_per_deg)


@dataclass(frozen=True)
class ChannelPair:
    """What was recorded at one time."""

    name: str  # its number among the acquisitions at the slow rates, from 1
    sine: SavedRecord  # the channel of the measurement
    cosine: SavedRecord | None  # the second photodiode, where there is one

    @property
    def intact(self) -> bool:
        """Whether everything in it is what was once saved."""
        return self.sine.intact and (self.cosine is None or self.cosine.intact)


def acquisitions_of(run: SavedRun) -> list[ChannelPair]:
    """Return the acquisitions at the slow rates of a run in their order; fast ones are left out."""
    found: list[ChannelPair] = []
    for record in run.records:
        if record.purpose == "measure":
            found.append(ChannelPair(str(len(found) + 1), record, None))
        elif record.purpose == "quadrature" and found:
            # saved in one commit with the sine before it
            found[-1] = ChannelPair(found[-1].name, found[-1].sine, record)
    return found


@dataclass(frozen=True)
class _Volts:
    """Volts of many waveforms, made batch by batch: those of a long run together need much memory."""

    channels: Sequence[Sequence[Waveform]]

    def __iter__(self) -> Iterator[Batch]:
        first = self.channels[0]
        intervals = np.array([wave.sample_interval for wave in first])
        for rows in rows_of_batches(intervals, np.array([wave.codes.size for wave in first], dtype=np.int64)):
            picked = [[waves[row] for row in rows] for waves in self.channels]
            volts = np.array([[wave.volts for wave in waves] for waves in picked])
            clipped = np.array([[wave.clipped_samples for wave in waves] for waves in picked])
            yield Batch(rows, first[rows[0]].sample_interval, volts, clipped)


def _arrays(channels: Sequence[Sequence[Waveform]], records: Sequence[SavedRecord] | None = None) -> RecordArrays:
    """Records as arrays, with the conditions under which they were saved where they come from a run."""

    def condition(name: str) -> NDArray[np.float64]:
        if records is None:
            return np.full(len(channels[0]), math.nan)
        values = [record.conditions.get(name) for record in records]
        return np.array([math.nan if value is None else float(value) for value in values], dtype=np.float64)

    return RecordArrays(
        batches=_Volts(channels),
        n_channels=len(channels),
        samples=np.array([wave.codes.size for wave in channels[0]], dtype=np.int64),
        level_spacing=np.array([abs(wave.preamble.ymult) for wave in channels[0]]),
        table_rate=condition("table_rate_dps"),
        azimuth_start=condition("azimuth_start_deg"),
        azimuth_end=condition("azimuth_end_deg"),
        over_lock_in=condition("over_lock_in"),
    )


def _fast_run(run: SavedRun) -> RecordArrays:
    records = run.taken_for("tilt")
    return _arrays(([saved_waveform(record, run.path) for record in records],), records)


def _no_tilt(error: NoTilt) -> str:
    return f"the fast run gives no tilt: {error}"


def _mean_truth(records: Sequence[SavedRecord]) -> dict[str, float] | None:
    truths = [record.conditions["truth"] for record in records if record.conditions.get("truth")]
    if not truths:
        return None
    return {name: fmean(truth[name] for truth in truths) for name in truths[0]}


# --------------------
# The result of a run with the records that it was found from, for everything that shows it


RELATIONS = {
    "exact": "harmonic ratio, exact relation",
    "paper-13": "harmonic ratio, relation (13) of the paper",
    "paper-10": "harmonic ratio, relation (10) of the paper",
}


@dataclass(frozen=True, kw_only=True)
class LockInEvaluation(LockInRun):
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
