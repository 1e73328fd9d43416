"""Stretches of output, taken one after the other and saved one by one; what is there is not taken again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from instrument.fibre_gyro import Recording
from station.fibre_gyro.recordings import new_record, segments_of
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.windows import unusable
from station.runs.progress import Progress
from station.runs.store import RunWriter, SavedRun
from station.runs.taking import Session

MARGIN_S = 1.0
"""So much longer than whole turns is a recording: they end within an output word."""


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
    session: Session,
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
    session: Session, paths: Sequence[Path], logs: Sequence[tuple[str, Mapping[str, Any], Recording]]
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
    session: Session, writer: RunWriter, bench: FogBench, plan: Sequence[PlannedSegment], there: set[str]
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
