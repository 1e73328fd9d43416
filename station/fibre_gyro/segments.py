"""Stretches of output: planned, taken, saved one by one, read again, and cut into windows."""

from __future__ import annotations

import itertools
import json
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import (
    WindowMean,
    check_whole_turns,
    horizontal_earth_rate_dps,
    mean_at_rest,
    mean_over_turns,
    turn_by_encoder,
    whole_turns_in,
)
from instrument.fibre_gyro import TABLE_ANGLE, Gap, HostClock, Losses, Recording
from station.errors import RunError
from station.fibre_gyro.settings import FogSettings
from station.live.events import Progress
from station.runs.acquisition import Acquisition
from station.runs.store import NewRecord, RunWriter, SavedRecord, SavedRun

BY_ENCODER = "by_encoder_s"
"""Condition of a segment whose rate the table's encoder gave: seconds of the log beside its steady whole turns."""

OVERLOAD = "overload_dps"
"""Condition of a segment in which the table turns faster than the gyro follows, and stops."""

_OF_ENCODER_PPM = 5e4  # by which the rate of a list may be off where the encoder gives the rate
MARGIN_S = 1.0  # so much longer than whole turns is a recording: they end within an output word


@dataclass(frozen=True)
class PlannedSegment:
    """What shall be recorded."""

    key: str  # unique in the run, short enough for a table: ``"Z +20.01"``
    seconds: float  # of output that is kept, and that is left out before it
    settle_s: float
    # plain JSON: ``purpose`` and what the bench has to bring about (axis, rate_dps, number, ...)
    conditions: Mapping[str, Any]


class FogBench(Protocol):
    """What segments are taken with: a gyro with its output and its injection, and a table that can be turned."""

    def refuses(self, planned: PlannedSegment) -> str:
        """Why the bench cannot bring the conditions about; empty if it can."""

    def prepare(self, planned: PlannedSegment) -> dict[str, Any]:
        """Bring the conditions about; return those that were really reached, as plain JSON."""

    def record(self, planned: PlannedSegment, progress: Callable[[float], None]) -> Recording:
        """Record; `progress` is called with the seconds that have passed, settling included."""


Plan = Callable[[SavedRun], Sequence[PlannedSegment]]
"""Makes its plan from the run as it stands: the numbers to inject come from the rate-table run before them."""


def take_segments(
    settings: FogSettings,
    session: Acquisition,
    bench: AbstractContextManager[FogBench],
    stages: Sequence[Plan],
    facts: Mapping[str, object],
    left_out: Mapping[str, str] | None = None,
) -> None:
    """Begin the run or go on with it, and take what is missing of every stage."""
    opened = session.open(bench)
    writer = session.begin(facts)
    session.progress.note(f"{settings.gyro.name} ({settings.link.port or 'simulated'}), run {writer.path}")
    if left_out:
        session.note_left_out(left_out)
    for stage in stages:
        run = session.so_far()
        _take(session, writer, opened, stage(run), {record.key for record in run.records})


def take_logs(
    session: Acquisition, paths: Sequence[Path], logs: Sequence[tuple[str, Mapping[str, Any], Recording]]
) -> None:
    """Make a run of what was read from saved logs: key, conditions and recording of each."""
    writer = session.begin({"logs": [str(path) for path in paths]})
    session.progress.start("logs", len(logs))
    for key, conditions, recording in logs:
        writer.save_records([new_record(key, conditions, recording)])
        session.progress.advance()


def seconds_of(planned: Sequence[PlannedSegment]) -> float:
    """Return how long segments take, settling included."""
    return sum(one.seconds + one.settle_s for one in planned)


def unusable_segments(run: SavedRun, settings: FogSettings, purposes: Sequence[str]) -> dict[str, str]:
    """Return the keys of segments that would be left out for what happened while they were taken, and why."""
    found = {}
    for purpose in purposes:
        for segment in segments_of(run, purpose):
            if reason := unusable(segment, settings.table.rate_tolerance_ppm):
                found[segment.key] = reason
    return found


def _take(
    session: Acquisition, writer: RunWriter, bench: FogBench, plan: Sequence[PlannedSegment], there: set[str]
) -> None:
    progress = session.progress
    left = [planned for planned in plan if planned.key not in there]
    if len(left) < len(plan):
        progress.note(f"{len(plan) - len(left)} of {len(plan)} segments are saved already")
    if refused := {planned.key: reason for planned in left if (reason := bench.refuses(planned))}:
        session.note_left_out(refused)
        left = [planned for planned in left if planned.key not in refused]
    if not left:
        return
    progress.start("seconds of output", sum(_whole_seconds(planned) for planned in left))
    for planned in left:
        reached = bench.prepare(planned)
        counted = _Seconds(progress, _whole_seconds(planned))
        recording = bench.record(planned, counted.reach)
        writer.save_records([new_record(planned.key, {**planned.conditions, **reached}, recording)])
        counted.finish()


def _whole_seconds(planned: PlannedSegment) -> int:
    return max(1, round(planned.seconds + planned.settle_s))


class _Seconds:
    """Counts the seconds of one segment on the progress, no more and no less than were promised."""

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def reach(self, seconds: float) -> None:
        # the last second is counted when the segment is on the disk
        while self._done < min(int(seconds), self._total - 1):
            self._done += 1
            self._progress.advance()

    def finish(self) -> None:
        while self._done < self._total:
            self._done += 1
            self._progress.advance()


# --------------------
# From a saved segment to its mean; one that cannot be used raises ValueError with the reason


Floats = NDArray[np.float64]

_OVERLAP_S = 2.0
"""By so much a log may begin before the one before has ended: stamps are rounded, or tell the end of a word."""
_APPROXIMATE = ("counter jump", "silence")
"""Causes of gaps whose length nobody knows exactly: the turn of the table is not known behind them."""


def window_over_turns(
    segment: Segment, *, turns: int, window_s: float, resolution: float, column: str = ""
) -> WindowMean:
    """Mean over whole turns."""
    recording, rate = checked(segment), float(segment.conditions["rate_dps"])
    turning = float(segment.conditions.get("table_rate_dps", rate))
    interval = recording.interval_s
    words = words_of(recording, column)
    chosen = float(segment.conditions.get("window_s", window_s))
    if chosen > 0:
        turns = check_whole_turns(chosen, turning, tolerance_s=interval)
    else:
        turns = min(turns, whole_turns_in(words.size * interval, turning, tolerance_s=interval))
    return mean_over_turns(words, interval, turning, turns=turns, resolution=resolution)


def window_at_rest(segment: Segment, *, resolution: float) -> WindowMean:
    """Mean of a segment without rotation; ValueError as in :func:`window_over_turns`."""
    recording = checked(segment)
    return mean_at_rest(words_of(recording), recording.interval_s, resolution=resolution)


def window_of_any_length(
    segment: Segment, settings: FogSettings, *, turns: int, tilt_mrad: float | None = None
) -> WindowMean:
    """Mean over whole turns, or where the record is shorter than one turn, of all of it."""
    # Without whole turns a part of the horizontal earth rate stays in: what the input axis, tilted by `tilt_mrad`
    # (``figures.misalignment_mrad`` if not given), can see of it counts in the uncertainty. Errors as
    # :func:`window_over_turns`.
    recording, rate = checked(segment), float(segment.conditions["rate_dps"])
    resolution = settings.gyro.output_resolution
    turning = abs(float(segment.conditions.get("table_rate_dps", rate)))
    words = words_of(recording)
    if (words.size + 1) * recording.interval_s * turning >= 360.0:
        return window_over_turns(segment, turns=turns, window_s=0.0, resolution=resolution)
    mean = mean_at_rest(words, recording.interval_s, resolution=resolution)
    tilt = 1e-3 * (settings.figures.misalignment_mrad if tilt_mrad is None else tilt_mrad)
    seen = settings.nominal_scale_factor * tilt * horizontal_earth_rate_dps(settings.site.latitude_deg)
    return replace(mean, mean_u=math.hypot(mean.mean_u, seen))


def begins_of(segments: Sequence[Segment]) -> list[float]:
    """When each segment began, s: by the logs' own clock, by when it was saved, else one right after the other."""
    # A clock counts if by it no segment begins before the one before has ended.
    lengths = [one.recording.duration_s for one in segments]
    of_logs = [one.conditions.get("begin_s") for one in segments]
    if all(begin is not None for begin in of_logs) and _one_after_another(begins := np.array(of_logs), lengths):
        return [float(one) for one in begins]
    saved = [_seconds(one.taken_at) for one in segments]
    if _one_after_another(begins := np.array(saved) - lengths, lengths):
        return [float(one) for one in begins]
    return [float(one) for one in np.cumsum(lengths) - lengths]


def _one_after_another(begins: Floats, lengths: Sequence[float]) -> bool:
    if not np.all(np.isfinite(begins)):
        return False
    order = np.argsort(begins)
    ends = (begins + lengths)[order]
    return bool(np.all(begins[order][1:] >= ends[:-1] - _OVERLAP_S))


def _seconds(iso: str) -> float:
    try:
        return datetime.fromisoformat(iso).timestamp()
    except ValueError:
        return math.nan


def words_of(recording: Recording, column: str = "") -> Floats:
    """Output words at equal intervals, nan where one is missing, of the longest stretch whose time is exact."""
    values = recording.extra[column] if column else recording.counts
    if not recording.gaps:
        return values
    edges = [0, *(gap.after + 1 for gap in recording.gaps if gap.cause in _APPROXIMATE), recording.counts.size]
    first, last = max(itertools.pairwise(edges), key=lambda pair: pair[1] - pair[0])
    places = np.round(recording.times[first:last] / recording.interval_s).astype(np.intp)
    places -= places[0]
    words = np.full(int(places[-1]) + 1, np.nan)
    words[places] = values[first:last]
    return words


def remarks_on(segment: Segment, window: WindowMean) -> list[str]:
    """Say what was missing in a window, and what was left out of it; sentences."""
    said, gaps = [], segment.recording.gaps
    cut = [gap for gap in gaps if gap.cause in _APPROXIMATE]
    if cut:
        said.append(f"{segment.key}: {cut[0].describe()}; only the longest stretch without such a gap is used.")
    if window.missing:
        words = "1 output word is" if window.missing == 1 else f"{window.missing} output words are"
        inside = f", the first {gaps[0].start_s:.6g} s after the begin" if gaps and not cut else ""
        said.append(
            f"{segment.key}: {words} missing of {window.samples}{inside}; the mean is fitted to the others."
        )
    if window.outliers:
        words = "1 output word lies" if window.outliers == 1 else f"{window.outliers} output words lie"
        said.append(
            f"{segment.key}: {words} up to {window.worst:.3g} counts off the mean, far from all others: left out."
        )
    return said + [f"{segment.key}: {one}" for one in _not_steady(segment, window)]


_BLOCKS, _FEWEST_IN_BLOCK = 20, 5  # of a window whose output should be steady, and words in each
_JUMP = 12.0  # times by which one change from block to block exceeds the usual one, and no noise does
_STUCK = 50, 0.1  # words in a row that are the same, and their share of the window, that no live output has


def stuck_words(words: Floats, interval_s: float) -> list[str]:
    """A sentence where an output stands still for a part of its words; none where it does not."""
    same = np.diff(np.flatnonzero(np.diff(words, prepend=np.nan, append=np.nan)))
    longest = int(same.max(initial=0))
    others = np.sort(same)[-2] if same.size > 1 else longest
    if longest < max(_STUCK[0], _STUCK[1] * words.size) or longest == words.size or longest <= 4 * others:
        return []
    place = int(np.cumsum(same)[same.argmax()] - longest)
    return [
        f"the output stands still for {longest} words from {place * interval_s:.4g} s on: stuck, or not sent. "
        "What is computed of it is wrong; take it again."
    ]


def _not_steady(segment: Segment, window: WindowMean) -> list[str]:
    """What an output does that is not that of a gyro at a steady rate; sentences."""
    words = words_of(segment.recording)
    words = words[np.isfinite(words)]
    said, size = stuck_words(words, segment.recording.interval_s), words.size // _BLOCKS
    if size < _FEWEST_IN_BLOCK:
        return said
    blocks = words[: _BLOCKS * size].reshape(_BLOCKS, size)
    means = np.median(blocks, axis=1) if window.outliers else blocks.mean(axis=1)
    changes = np.diff(means)
    white = float(np.median(np.abs(np.diff(words)))) / 0.95  # of two words' difference, over sqrt 2 their noise
    usual_change = max(
        1.48 * float(np.median(np.abs(changes))), white * math.sqrt(2 / size), 1e-12 * abs(means[0])
    )
    largest = int(np.abs(changes).argmax())
    if abs(changes[largest]) > _JUMP * usual_change:
        at = (largest + 1) * size * segment.recording.interval_s
        said.append(
            f"the output changes by {changes[largest]:+.4g} counts about {at:.4g} s after the begin, "
            f"{abs(changes[largest]) / usual_change:.0f} times what it does elsewhere: the rate or the step was "
            "not there all the time. The mean is wrong; wait longer before the log begins, and take it again."
        )
    return said


def checked(segment: Segment) -> Recording:
    """Return the recording of a segment that can be used."""
    recording = segment.recording
    if not segment.intact:
        raise ValueError("what is saved is not what was once saved (its checksum is wrong)")
    if segment.fault:
        raise ValueError(segment.fault)
    if recording.counts.size < 2 or not np.all(np.isfinite(recording.counts)):
        raise ValueError("the recording holds no usable output")
    lost = sum(gap.missing for gap in recording.gaps)
    if lost > 0.2 * (lost + recording.counts.size):
        gaps = recording.gaps
        more = f", and {len(gaps) - 1} more gaps" if len(gaps) > 1 else ""
        raise ValueError(
            f"{gaps[0].describe()}{more}: {lost} of {lost + recording.counts.size} outputs are missing"
        )
    return recording


def unusable(segment: Segment, tolerance_ppm: float) -> str:
    """Why a segment would be left out for what happened while it was taken; empty if for nothing."""
    try:
        rate = float(segment.conditions.get("rate_dps") or 0.0)
        if rate:
            check_table_rate(segment.conditions, tolerance_ppm)
        recording = checked(segment)
        if any(gap.cause in _APPROXIMATE for gap in recording.gaps) and rate:
            whole_turns_in(words_of(recording).size * recording.interval_s, rate, tolerance_s=recording.interval_s)
    except ValueError as error:
        return str(error)
    return ""


def check_table_rate(conditions: dict[str, Any], tolerance_ppm: float) -> None:
    """Refuse a table rate that is not the one that was asked for; ValueError as above."""
    wanted = float(conditions["rate_dps"])
    reached = float(conditions.get("table_rate_dps", wanted))
    off_ppm = 1e6 * (reached / wanted - 1)
    if BY_ENCODER in conditions:
        if abs(off_ppm) > _OF_ENCODER_PPM:
            raise ValueError(
                f"by its encoder the table turned at {reached:+.6g} deg/s: is {wanted:+.6g} the rate of this log?"
            )
    elif abs(off_ppm) > tolerance_ppm:
        raise ValueError(
            f"the table turned at {reached:+.6g} deg/s instead of {wanted:+.6g}, {off_ppm:+.0f} ppm off "
            f"(table.rate_tolerance_ppm = {tolerance_ppm:g})"
        )


# --------------------
# A stretch of a fibre gyro's output as a record of a run: packed columns, and a header that describes them


_EXTRA = "extra "
_EMPTY = Recording(np.empty(0), np.empty(0), None, None, {}, (), Losses(), 1.0, "counter")


@dataclass(frozen=True)
class Segment:
    """One stretch of output under constant conditions: a table rate, an injected step, rest."""

    key: str  # what it is, unique in its run: ``"Z +20"``
    conditions: dict[str, Any]  # plain JSON: rates, injected step, axis, ..
    recording: Recording  # empty where it is not intact
    intact: bool  # whether it still is what was once saved
    taken_at: str = ""  # when it was saved, UTC, ISO 8601
    fault: str = ""  # why it cannot be used


def segments_of(run: SavedRun, purpose: str) -> tuple[Segment, ...]:
    """Return the stretches of one purpose that are not set aside, in the order in which they were taken."""
    return tuple(_segment(record, run) for record in run.taken_for(purpose))


def new_record(key: str, conditions: Mapping[str, Any], recording: Recording) -> NewRecord:
    """Return a record to be saved; the conditions hold its ``purpose``."""
    columns = {"times": recording.times, "counts": recording.counts}
    if recording.temperature is not None:
        columns["temperature"] = recording.temperature
    if recording.status is not None:
        columns["status"] = recording.status.astype(np.float64)
    columns = columns | {f"{_EXTRA}{name}": values for name, values in recording.extra.items()}
    payload = zlib.compress(np.stack(list(columns.values())).astype("<f8").tobytes(), 1)
    header = {
        "columns": list(columns),
        "interval_s": recording.interval_s,
        "clock": recording.clock,
        "gaps": [asdict(gap) for gap in recording.gaps],
        "losses": asdict(recording.losses),
        "host_clock": None if recording.host_clock is None else asdict(recording.host_clock),
        "doubts": recording.doubts,
    }
    return NewRecord(key, conditions["purpose"], json.dumps(header), payload, conditions)


def recording_of(record: NewRecord) -> Recording:
    """Return the stretch of output that a record holds which was just saved."""
    return _recording_from(json.loads(record.header), record.payload)


def _segment(record: SavedRecord, run: SavedRun) -> Segment:
    recording = _EMPTY
    if record.intact:
        try:
            recording = _recording_from(json.loads(record.header), record.payload)
        except (zlib.error, ValueError, KeyError, TypeError) as error:
            raise RunError(f"{run.path}: {record.key}: is damaged and cannot be read ({error})") from None
    segment = Segment(record.key, record.conditions, recording, record.intact, record.taken_at)
    # what is shorter than a turn, as small rates are, has no whole turns
    whole = abs(float(record.conditions.get("rate_dps") or 0.0)) * recording.duration_s >= 360.0
    by_encoder = whole and TABLE_ANGLE in recording.extra and "since_on_s" not in record.conditions
    return _by_encoder(segment) if by_encoder else segment


def _by_encoder(segment: Segment) -> Segment:
    """Whole turns at a steady rate, and that rate, where a column holds the angle of the table."""
    recording, conditions = segment.recording, dict(segment.conditions)
    try:
        turn = turn_by_encoder(recording.times, recording.extra[TABLE_ANGLE], float(conditions["rate_dps"]))
    except ValueError as error:
        return replace(segment, fault=str(error))
    part = recording.part(turn.first, turn.end)
    conditions.pop("window_s", None)  # which made whole turns of a rate that was believed
    conditions |= {"table_rate_dps": turn.rate_dps, BY_ENCODER: recording.duration_s - part.duration_s}
    if "begin_s" in conditions:
        conditions["begin_s"] += float(recording.times[turn.first] - recording.times[0])
    return replace(segment, conditions=conditions, recording=part)


def _recording_from(described: dict[str, Any], payload: bytes) -> Recording:
    table = np.frombuffer(zlib.decompress(payload), dtype="<f8").reshape(len(described["columns"]), -1)
    columns = dict(zip(described["columns"], table.astype(np.float64), strict=True))
    status, host_clock = columns.get("status"), described.get("host_clock")
    return Recording(
        times=columns["times"],
        counts=columns["counts"],
        temperature=columns.get("temperature"),
        status=None if status is None else status.astype(np.int64),
        extra={name[len(_EXTRA) :]: values for name, values in columns.items() if name.startswith(_EXTRA)},
        gaps=tuple(Gap(**gap) for gap in described["gaps"]),
        losses=Losses(**described["losses"]),
        interval_s=described["interval_s"],
        clock=described["clock"],
        host_clock=None if host_clock is None else HostClock(**host_clock),
        doubts=tuple(described.get("doubts", ())),
    )
