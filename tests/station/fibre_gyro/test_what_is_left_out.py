"""Bad input: a point that cannot be used is left out by name, in one clear line, and the others still count."""

import json
import sqlite3
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from instrument.fibre_gyro import Gap, Losses, Recording
from station.errors import NoUsableSignal, RunError, UsageError
from station.fibre_gyro.bench import SimulatedFogBench
from station.fibre_gyro.segments import PlannedSegment, new_record, segments_of
from station.fibre_gyro.table import plan
from station.live.events import Progress
from station.measurements import measurement
from station.runs.store import RunWriter, open_run
from station.shell.finish import Evaluated, evaluate_run, start_run

QUIET = Progress()
ONE_AXIS = {"axes": ["Z"], "turns": 10}


class SpoiltBench(SimulatedFogBench):
    """The simulated bench with one segment that goes wrong."""

    def __init__(
        self, settings: Any, key: str, spoil: Callable[[Recording], Recording], reached: Mapping[str, Any]
    ) -> None:
        super().__init__(settings)
        self._key, self._spoil, self._reached = key, spoil, reached

    def prepare(self, planned: PlannedSegment) -> dict[str, Any]:
        return super().prepare(planned) | (dict(self._reached) if planned.key == self._key else {})

    def record(self, planned: PlannedSegment, progress: Callable[[float], None]) -> Recording:
        recording = super().record(planned, progress)
        return self._spoil(recording) if planned.key == self._key else recording


def with_a_gap(recording: Recording) -> Recording:
    lost = recording.counts.size // 3
    kept = np.r_[0:100, 100 + lost : recording.counts.size]
    gap = Gap(99, recording.times[100], 0.1 * lost, lost, "frames lost")
    return replace(recording, times=recording.times[kept], counts=recording.counts[kept], gaps=(gap,))


def cut_short(recording: Recording) -> Recording:
    return replace(recording, times=recording.times[:50], counts=recording.counts[:50])


@pytest.fixture
def table_result(fog_settings, taken_on):
    def take(spoil=lambda recording: recording, reached=None, **table: Any) -> Evaluated:
        settings = fog_settings(table={**ONE_AXIS, **table})
        bench = SpoiltBench(settings, "Z -20.01", spoil, reached or {})
        return taken_on("table", settings, bench, plan(settings), simulated=True)

    return take


@pytest.mark.parametrize(
    ("spoil", "reached", "reason"),
    [
        (with_a_gap, {}, "outputs missing 10 s after the begin"),
        (cut_short, {}, "is 0.278 of a turn"),
        (lambda r: r, {"table_rate_dps": -20.02}, "the table turned at -20.02 deg/s instead of -20.01"),
    ],
)
def test_a_spoilt_point_and_its_opposite_are_named(table_result, spoil, reached, reason: str) -> None:
    result = table_result(spoil, reached)
    (axis,) = result.document()["axes"]
    left_out = {one["name"]: one["reason"] for one in result.document()["left_out"]}
    assert reason in left_out["Z -20.01"]
    assert left_out["Z +20.01"].startswith("the opposite sense (-20.01 deg/s) is missing")
    assert set(left_out) == {"Z +20.01", "Z -20.01"}
    assert len(axis["points"]) == 6
    assert [one["delta_dps"] for one in axis["differences"]] == [0.1, 1.0]
    assert abs(axis["nominal_difference_ppm"]) < 5 * axis["scale_factor_u_ppm"]
    assert all(len(flag) < 250 for flag in result.result.flags)


def test_a_window_that_is_not_whole_turns_is_refused_with_what_to_do(table_result) -> None:
    result = table_result(window_s=540.0)
    left_out = {one["name"]: one["reason"] for one in result.document()["left_out"]}
    assert set(left_out) == {f"Z {sense}{rate}" for sense in "+-" for rate in ("20.01", "20.1", "21")}
    assert (
        "30.015 turns, not a whole number: use 30 turns = 539.730 s or 31 turns = 557.721 s"
        in left_out["Z +20.01"]
    )
    (axis,) = result.document()["axes"]
    assert [point["name"] for point in axis["points"]] == ["Z +20", "Z -20"]


def test_a_damaged_segment_is_left_out(taken) -> None:
    _, run = taken("table", table=ONE_AXIS)
    with closing(sqlite3.connect(run.path)) as db, db:
        (blob,) = db.execute("SELECT payload FROM record WHERE key = 'Z +21'").fetchone()
        db.execute("UPDATE record SET payload = ? WHERE key = 'Z +21'", (blob[:-3] + b"abc",))
    result = evaluate_run(open_run(run.path))
    assert "checksum" in next(one["reason"] for one in result.document()["left_out"] if one["name"] == "Z +21")
    assert len(result.document()["axes"][0]["points"]) == 6


def test_a_table_that_never_reaches_its_rate_gives_no_result(table_result) -> None:
    with pytest.raises(
        NoUsableSignal, match=r"no axis has runs in both senses: Z -20\.01 is left out: the table turned"
    ):
        table_result(reached={"table_rate_dps": -20.02}, rates_dps=[20.01])


def test_steps_beyond_the_converter_are_named_and_never_injected(taken) -> None:
    result, run = taken("selfcal", selfcal={"rates_dps": [1.0, 20.0, 140.0], "numbers": "nominal", "step_s": 5.0})
    names = [one["name"] for one in result.document()["left_out"]]
    assert names == ["inject +140", "inject -140"]
    reason = result.document()["left_out"][0]["reason"]
    assert reason.startswith("a step of +34461.4 codes is beyond the 16-bit converter, which takes 32767")
    assert len(run.taken_for("selfcal")) == 6


def test_one_static_output_is_enough_and_said_and_none_is_not(taken) -> None:
    _, run = taken("selfcal", selfcal={"step_s": 5.0, "static_s": 5.0})
    with closing(sqlite3.connect(run.path)) as db, db:
        db.execute("DELETE FROM record WHERE key = 'static after'")
    result = evaluate_run(open_run(run.path))
    assert result.document()["static_missing"] == "after"
    assert any("There is no static output after the steps" in flag for flag in result.result.flags)
    with closing(sqlite3.connect(run.path)) as db, db:
        db.execute("DELETE FROM record WHERE key = 'static before'")
    with pytest.raises(NoUsableSignal, match="needs a static output and at least three steps, there are 0 and 8"):
        evaluate_run(open_run(run.path))


def test_a_drifting_bias_is_told(taken) -> None:
    _, run = taken("selfcal", selfcal={"step_s": 5.0})
    with closing(sqlite3.connect(run.path)) as db, db:
        db.execute("DELETE FROM record WHERE key = 'static after'")
    first = segments_of(run, "selfcal")[0]
    later = replace(first.recording, counts=first.recording.counts + 0.1)
    with RunWriter(run.path) as writer:
        writer.save_records([new_record("static after", {**first.conditions, "static": "after"}, later)])
    flags = " ".join(evaluate_run(open_run(run.path)).result.flags)
    assert "the bias drifts" in flags


def test_an_output_without_error_columns_gives_no_two_pi_error(taken) -> None:
    _, run = taken("eps", eps={"record_s": 0.2})
    with closing(sqlite3.connect(run.path)) as db, db:
        db.execute("DELETE FROM record")
    with RunWriter(run.path) as writer:
        for segment in segments_of(run, "eps"):
            bare = replace(segment.recording, extra={})
            writer.save_records([new_record(segment.key, segment.conditions, bare)])
    with pytest.raises(NoUsableSignal, match="the output has no column normal_error"):
        evaluate_run(open_run(run.path))


def test_numbers_need_a_table_run_on_a_real_gyro(fog_settings, tmp_path: Path) -> None:
    settings = fog_settings(link={"port": "/dev/null"})
    with pytest.raises(UsageError, match="name one with --table RUN"):
        start_run(measurement("selfcal"), settings, QUIET)
    assert not list(tmp_path.iterdir())


def test_what_is_no_run_is_said(tmp_path: Path, taken) -> None:
    with pytest.raises(RunError, match="holds no run"):
        open_run(tmp_path)
    other = tmp_path / "other.sqlite"
    with closing(sqlite3.connect(other)) as db, db:
        db.execute("CREATE TABLE t (x)")
    with pytest.raises(RunError, match="is a database, but not a saved run of gyrolock"):
        open_run(other)
    text = tmp_path / "text"
    text.write_text("hello")
    with pytest.raises(RunError, match="is not a saved run"):
        open_run(text)


def test_what_is_saved_comes_back_as_it_was(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    recording = Recording(
        times=np.arange(50) / 10,
        counts=rng.normal(size=50),
        temperature=rng.normal(20, 1, 50),
        status=np.arange(50, dtype=np.int64),
        extra={"normal_error": rng.normal(size=50)},
        gaps=(Gap(3, 0.4, 0.1, 1, "silence"),),
        losses=Losses(good=49, missing=1, damaged=1, reasons={"checksum": 1}),
        interval_s=0.1,
        clock="frames",
    )  # fmt: skip
    record = new_record("one", {"purpose": "table", "rate_dps": 20.0}, recording)
    with RunWriter.create(tmp_path, {"command": "table"}) as writer:
        writer.save_records([record])
        with pytest.raises(RunError, match="UNIQUE"):
            writer.save_records([record])
    (segment,) = segments_of(open_run(writer.path), "table")
    again = segment.recording
    assert segment.intact
    assert np.array_equal(again.counts, recording.counts)
    assert np.array_equal(again.temperature, recording.temperature)
    assert np.array_equal(again.status, recording.status)
    assert again.status.dtype == np.int64
    assert np.array_equal(again.extra["normal_error"], recording.extra["normal_error"])
    assert (again.gaps, again.losses, again.interval_s, again.clock) == (
        recording.gaps, recording.losses, recording.interval_s, recording.clock,
    )  # fmt: skip
    assert json.dumps(segment.conditions)


@pytest.mark.parametrize(("changed", "told"), [(20, True), (0, False)])
def test_digits_that_were_changed_unseen_are_told(table_result, changed: int, told: bool) -> None:
    """20 lines with a character that is none, of text without a checksum: in 12 more a digit became another."""

    def spoil(recording: Recording) -> Recording:
        reasons = {"one character changed": changed, "bad status": 3}
        return replace(recording, losses=replace(recording.losses, damaged=changed, reasons=reasons))

    said = [one for one in table_result(spoil).result.to_watch if "nothing shows which" in one]
    assert [one.startswith("In about 12 of ") for one in said] == [True] * told
