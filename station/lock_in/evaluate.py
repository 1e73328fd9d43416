"""From saved records to the result: read once, as arrays; always computed again, never remembered."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from statistics import fmean
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from analysis import flag_names
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
from station.live.events import Progress
from station.lock_in.beams import beams_of_run
from station.lock_in.columns import Collected, Pairs, read_waveforms, whole_pairs, with_intact_seconds
from station.lock_in.estimate import FAST, Gathered, Piece, described_records, estimate_pieces, pieces_of
from station.lock_in.settings import Settings, run_knowledge
from station.ring_laser.records import saved_waveform
from station.runs.store import SavedRecord, SavedRun
from station.sources.run import source_of
from station.sources.workers import Workers

R = TypeVar("R")
_LOOKED_AT = 200  # records that are read together where only some are looked at


def evaluate_records(
    run: SavedRun, settings: Settings, choices: Mapping[str, Any], workers: Workers, progress: Progress
) -> LockInEvaluation:
    """Evaluate the records that a run took at its slow rate, or at its slow rates; their samples are not held."""
    source = source_of(run)
    stated = {"scale_factor": settings.gyro.scale_factor_pulses_per_deg, "mains_hz": settings.site.mains_hz}
    chosen: dict[str, Any] = {**stated, **choices}
    gathered = None
    if settings.scope.quadrature_channel:
        described = described_records(Piece(source, None, chosen))
        _refuse_unusable(described)
        gathered = whole_pairs(described)
    paired = gathered is not None
    if gathered is None:
        collected, pieces = Collected(run_knowledge(settings).response), pieces_of(source, chosen)
        progress.start("thousands of records", len(pieces))
        for (part,) in workers.map(estimate_pieces, pieces):
            _refuse_unusable(part)
            with errors_in_words():
                collected.add(part)
            progress.advance()
        gathered = with_intact_seconds(collected.gathered())
    if not len(gathered):
        what = "only damaged records" if gathered.taken else "no record at the slow rate"
        raise RunError(f"{source.name}: the run holds {what}")
    numbers, places = gathered.numbers, gathered.places
    waveforms = RowsOnDemand(numbers.size, lambda rows: read_waveforms(source, numbers[rows]))
    slow = gathered_arrays(gathered, waveforms.many)
    if paired:
        slow = replace(slow, batches=Pairs(source, gathered), n_channels=2)
    arrays = RunArrays(slow, _arrays(gathered.fast, run), beams_of_run(source, gathered, settings))
    with errors_in_words(), given_back():
        found = evaluate(arrays, run_knowledge(settings), Method(**chosen), gathered.each)
    rows: slice | NDArray[np.intp] = slice(None)
    if found.several is not None:
        rows = found.several.reference_group.rows
    return LockInEvaluation(
        **vars(found),
        names=RowsOnDemand(places.size, lambda rows: [str(place + 1) for place in places[rows]]),
        waveforms=waveforms,
        damaged=tuple(str(place + 1) for place in gathered.damaged),
        damage=gathered.damage,
        truth={name: fmean(values[rows]) for name, values in gathered.truth.items()} or None,
        without_beat=tuple(run.facts.get("rates_without_beat", ())),
    )


def _refuse_unusable(gathered: Gathered) -> None:
    """RunError for a run that cannot be read, or a record of it that is whole and none of a beat over time."""
    for one in gathered.left_out:
        if not one.damaged:
            raise RunError(str(one))


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


Read = Callable[[NDArray[np.intp]], Sequence[Waveform]]  # some records, whose rows rise, in one pass


@dataclass(frozen=True)
class _AskedFor:
    """Volts of records, read again when something looks at some of them."""

    read: Read
    intervals: NDArray[np.float64]
    samples: NDArray[np.int64]

    def __iter__(self) -> Iterator[Batch]:
        for shape in rows_of_batches(self.intervals, self.samples):
            for first in range(0, shape.size, _LOOKED_AT):
                rows = shape[first : first + _LOOKED_AT]
                waves = self.read(rows)
                volts, clipped = [wave.volts for wave in waves], [wave.clipped_samples for wave in waves]
                yield Batch(rows, waves[0].sample_interval, np.array([volts]), np.array([clipped]))


def gathered_arrays(gathered: Gathered, read: Read) -> RecordArrays:
    """Records as arrays; their samples are read again where some are asked for."""
    columns = gathered.columns
    samples = columns["samples"].astype(np.int64)
    return RecordArrays(
        batches=_AskedFor(read, columns["sample_interval_s"], samples),
        n_channels=1,
        samples=samples,
        level_spacing=columns["level_spacing_v"],
        table_rate=columns["table_rate_dps"],
        azimuth_start=columns["azimuth_start_deg"],
        azimuth_end=columns["azimuth_end_deg"],
        over_lock_in=columns["over_lock_in"],
    )


def fast_run_tilt(run: SavedRun, settings: Settings) -> Tilt:
    """Find the tilt from the fast run alone, while the slow records are still to be taken."""
    fast, knowledge = _arrays(run.taken_for(FAST), run), run_knowledge(settings)
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
    return preliminary_lock_in(_arrays(records, run), settings.gyro.scale_factor_pulses_per_deg)


def _arrays(records: Sequence[SavedRecord], run: SavedRun) -> RecordArrays:
    """A few records of a run as arrays, with the conditions under which they were saved."""
    waveforms = [saved_waveform(record, run.path) for record in records]

    def condition(name: str) -> NDArray[np.float64]:
        values = [record.conditions.get(name) for record in records]
        return np.array([math.nan if value is None else float(value) for value in values], dtype=np.float64)

    samples = np.array([wave.codes.size for wave in waveforms], dtype=np.int64)
    intervals = np.array([wave.sample_interval for wave in waveforms])
    return RecordArrays(
        batches=_AskedFor(lambda rows: [waveforms[row] for row in rows], intervals, samples),
        n_channels=1,
        samples=samples,
        level_spacing=np.array([abs(wave.preamble.ymult) for wave in waveforms]),
        table_rate=condition("table_rate_dps"),
        azimuth_start=condition("azimuth_start_deg"),
        azimuth_end=condition("azimuth_end_deg"),
        over_lock_in=condition("over_lock_in"),
    )


def _no_tilt(error: NoTilt) -> str:
    return f"the fast run gives no tilt: {error}"


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
    damage: tuple[str, ...] = ()  # damaged records of every purpose, one sentence each
    truth: dict[str, float] | None = None  # the true values of a simulated run
    without_beat: tuple[str, ...] = ()  # rates of several that gave no record

    @property
    def method_text(self) -> str:
        """Describe in words how the lock-in rate was found."""
        text = describe_method(self.method)
        if self.quadratures is not None:
            text = f"{text}, sine and cosine channel"
        if self.several is not None and self.several.beams is not None:
            text = f"{text}, single beams"
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


class RowsOnDemand(Sequence[R]):
    """What belongs to each record, made or read when it is asked for."""

    def __init__(self, count: int, many: Callable[[NDArray[np.intp]], list[R]]) -> None:
        self._count, self.many = count, many  # of some rows, which rise, in one pass

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, place: int) -> R: ...
    @overload
    def __getitem__(self, place: slice) -> list[R]: ...
    def __getitem__(self, place: int | slice) -> R | list[R]:
        if isinstance(place, slice):
            return self.many(np.arange(*place.indices(self._count)))
        return self.many(np.array([range(self._count)[place]]))[0]
