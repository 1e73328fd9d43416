"""A list of segments, taken one after the other and saved one by one; what is there already is not taken again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from instrument import InstrumentError
from instrument.fibre_gyro import Recording
from station.errors import Failure, RunError, StationError, describe_failure
from station.fibre_gyro.store import FogRun, FogRunWriter, open_fog_run
from station.runs.database import utc_now
from station.runs.progress import Progress


@dataclass(frozen=True)
class PlannedSegment:
    """What shall be recorded.

    Attributes
    ----------
    key : str
        Unique in the run, short enough for a table: ``"Z +20.01"``.
    seconds, settle_s : float
        Of output that is kept, and that is left out before it.
    conditions : mapping
        Plain JSON: ``purpose`` and what the bench has to bring about (axis, rate_dps, number, ...).
    """

    key: str
    seconds: float
    settle_s: float
    conditions: Mapping[str, Any]


class FogBench(Protocol):
    """What a campaign works with: a gyro with its output and its injection, and a table that can be turned."""

    def refuses(self, planned: PlannedSegment) -> str:
        """Why the bench cannot bring the conditions about; empty if it can."""

    def prepare(self, planned: PlannedSegment) -> dict[str, Any]:
        """Bring the conditions about; return those that were really reached, as plain JSON."""

    def record(self, planned: PlannedSegment, progress: Callable[[float], None]) -> Recording:
        """Record; `progress` is called with the seconds that have passed, settling included."""


@dataclass(frozen=True)
class Campaign:
    """How a campaign ended.

    Attributes
    ----------
    path : Path
        The run's SQLite file; it holds every segment that was acknowledged.
    failure : Failure or None
        What stopped it before its time.
    """

    path: Path
    failure: Failure | None


Plan = Callable[[FogRun], Sequence[PlannedSegment]]


def take_segments(writer: FogRunWriter, bench: FogBench, stages: Sequence[Plan], progress: Progress) -> Campaign:
    """Take what is missing of every stage and close the run.

    Parameters
    ----------
    writer : FogRunWriter
        Of a new run or of one that is resumed.
    bench : FogBench
    stages : sequence of callable
        Each makes its plan from the run as it stands when the stage begins: the numbers to inject come from the
        rate-table run before them.
    progress : Progress

    Returns
    -------
    Campaign
        Also when it was interrupted or the link was lost.
    """
    failure: Failure | None = None
    try:
        for stage in stages:
            run = open_fog_run(writer.path)
            _take(writer, bench, stage(run), {segment.key for segment in run.segments}, progress)
        writer.save_facts({"ended_at": utc_now(), "outcome": "complete"})
    except (InstrumentError, StationError, OSError, KeyboardInterrupt) as error:
        failure = describe_failure(error)
        assert failure is not None  # all of these classes are known to it
        with suppress(RunError):  # a full disk takes no more; the segments it took are there
            writer.save_facts({"ended_at": utc_now(), "outcome": failure.as_json()})
    finally:
        progress.close()
        writer.close()
    return Campaign(writer.path, failure)


def _take(
    writer: FogRunWriter, bench: FogBench, plan: Sequence[PlannedSegment], there: set[str], progress: Progress
) -> None:
    left = [planned for planned in plan if planned.key not in there]
    if len(left) < len(plan):
        progress.note(f"{len(plan) - len(left)} of {len(plan)} segments are saved already")
    if not left:
        return
    refused = {planned.key: reason for planned in left if (reason := bench.refuses(planned))}
    if refused:
        _note_refused(writer, refused)
        left = [planned for planned in left if planned.key not in refused]
    progress.start("seconds of output", sum(_whole_seconds(planned) for planned in left))
    for planned in left:
        reached = bench.prepare(planned)
        counted = _Seconds(progress, _whole_seconds(planned))
        recording = bench.record(planned, counted.reach)
        writer.save_segment(planned.key, {**planned.conditions, **reached}, recording)
        counted.finish()


def _note_refused(writer: FogRunWriter, refused: Mapping[str, str]) -> None:
    """Save what the bench cannot do, so that the result names it."""
    noted = {one["name"]: one for one in open_fog_run(writer.path).facts.get("left_out_of_plan", [])}
    noted |= {key: {"name": key, "reason": reason} for key, reason in refused.items()}
    writer.save_facts({"left_out_of_plan": list(noted.values())})


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
