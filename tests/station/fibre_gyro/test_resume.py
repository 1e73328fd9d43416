"""A run that was cut short goes on where it stopped, and ends with the numbers of one in one go."""

import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from instrument import LinkError
from instrument.fibre_gyro import Gap, Recording
from station.errors import EXIT_INSTRUMENT, RunError, UsageError
from station.fibre_gyro import bench as simulated_bench
from station.fibre_gyro.bench import SimulatedFogBench
from station.fibre_gyro.segments import PlannedSegment
from station.live.events import Progress
from station.measurements import measurement
from station.runs.database import TAKEN
from station.runs.store import open_run
from station.shell.finish import evaluate_run, resume_run, save_outcome, start_run

QUIET = Progress()
TABLE = measurement("table")
GOLDEN = Path(__file__).parents[2] / "golden"


class FailingBench(SimulatedFogBench):
    """Loses the link, or is interrupted, at one segment."""

    at, error = "Z -20.1", LinkError("the cable is out")

    def prepare(self, planned: PlannedSegment) -> dict[str, Any]:
        if planned.key == self.at:
            raise self.error
        return super().prepare(planned)


@pytest.fixture
def cut_short(monkeypatch: pytest.MonkeyPatch, fog_settings):
    """Start a run that ends early."""

    def run(command: str, at: str, error: BaseException, **sections: Any) -> Any:
        monkeypatch.setattr(FailingBench, "at", at)
        monkeypatch.setattr(FailingBench, "error", error)
        with monkeypatch.context() as patched:
            patched.setattr(simulated_bench, "SimulatedFogBench", FailingBench)
            return start_run(measurement(command), fog_settings(**sections), QUIET)

    return run


def points(document: dict[str, Any]) -> Any:
    return next(document[name] for name in ("axes", "points", "runs") if name in document)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "at"),
    [
        ("table", "X -20.1"),
        ("selfcal", "inject -1"),
        ("selfcal", "Z +20.1"),
        ("eps", "open loop -2001"),
        ("figures", "run 2, -50 deg/s"),
    ],
)
def test_resumed_equals_uninterrupted(cut_short, taken, command: str, at: str) -> None:
    sections: dict[str, Any] = {"simulation": {"seed": 9}, "eps": {"record_s": 0.3}}
    sections["figures"] = {"runs": 2, "rates_dps": [10.0, 50.0, 100.0], "temperatures_c": []}
    done = cut_short(command, at, LinkError("the cable is out"), **sections)
    assert done.failure.exit_code == EXIT_INSTRUMENT
    before = open_run(done.path)
    assert before.records
    assert at not in {segment.key for segment in before.records}
    assert before.facts["outcome"]["message"] == "the cable is out"
    resumed = resume_run(done.path.parent, QUIET, kind=measurement(command))
    assert resumed.failure is None
    assert resumed.path == done.path
    after = open_run(resumed.path)
    assert [s.taken_at for s in after.records[: len(before.records)]] == [s.taken_at for s in before.records]
    assert after.facts["outcome"] == TAKEN  # "complete" is for a run with its result
    assert len(after.facts["resumed_at"]) == 1
    whole, _ = taken(command, **sections)
    assert points(evaluate_run(after).document()) == points(whole.document())


def test_an_interrupted_run_keeps_what_it_has(cut_short) -> None:
    done = cut_short("table", "Y +20", KeyboardInterrupt())
    assert done.failure.exit_code == 130
    result = evaluate_run(open_run(done.path))
    assert [axis["axis"] for axis in result.document()["axes"]] == ["X"]


def test_a_complete_run_has_nothing_to_resume(taken) -> None:
    _, run = taken("table", table={"axes": ["Z"], "turns": 2})
    save_outcome(run, None)
    with pytest.raises(UsageError, match="is finished, there is nothing to go on with"):
        resume_run(run.path, QUIET, kind=TABLE)
    with pytest.raises(UsageError, match="is a run of `gyrolock fog table`, not of `gyrolock fog selfcal`"):
        resume_run(run.path, QUIET, kind=measurement("selfcal"))
    again = open_run(run.path)
    assert again.facts.resumed_at == ()
    assert again.records[0].taken_at == run.records[0].taken_at


def test_what_was_left_out_is_taken_again(taken, fog_settings, monkeypatch: pytest.MonkeyPatch) -> None:
    class GappyBench(SimulatedFogBench):
        def record(self, planned: PlannedSegment, progress: Callable[[float], None]) -> Recording:
            recording = super().record(planned, progress)
            gap = Gap(9, 1.0, 100.0, 1000, "frames lost")
            return replace(recording, gaps=(gap,)) if planned.key == "Z +20.1" else recording

    with monkeypatch.context() as patched:
        patched.setattr(simulated_bench, "SimulatedFogBench", GappyBench)
        done = start_run(TABLE, fog_settings(table={"axes": ["Z"], "turns": 8}), QUIET)
    before = evaluate_run(open_run(done.path))
    assert {one["name"] for one in before.document()["left_out"]} == {"Z +20.1", "Z -20.1"}
    assert resume_run(done.path, QUIET, kind=TABLE).failure is None
    run = open_run(done.path)
    assert [s.key for s in run.records if "aside" in s.key] == ["Z +20.1 (set aside 1)"]
    assert all(segment.intact for segment in run.records)
    after = evaluate_run(run)
    assert after.document()["left_out"] == []
    whole, _ = taken("table", table={"axes": ["Z"], "turns": 8})
    assert after.document()["axes"][0]["scale_factor_counts_per_dps"] == pytest.approx(
        whole.document()["axes"][0]["scale_factor_counts_per_dps"], rel=1e-12
    )


def test_a_directory_that_cannot_be_made_is_said(fog_settings, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    settings = fog_settings()
    settings = settings.model_copy(
        update={"output": settings.output.model_copy(update={"directory": str(tmp_path / "file")})}
    )
    with pytest.raises(RunError, match="runs cannot be saved there"):
        start_run(TABLE, settings, QUIET)


def test_only_what_is_not_measured_may_differ(cut_short, tmp_path: Path) -> None:
    done = cut_short("eps", "open loop -2001", KeyboardInterrupt(), eps={"record_s": 0.3})
    given = {"eps": {"record_s": 0.4}, "gyro": {"dac_bits": 14}}
    with pytest.raises(UsageError, match=r"eps\.record_s is 0\.3 in the run, not 0\.4; gyro\.dac_bits is 16"):
        resume_run(done.path, QUIET, kind=measurement("eps"), overrides=given)
    assert open_run(done.path).facts.resumed_at == ()
    config = tmp_path / "same.toml"
    config.write_text("[eps]\nrecord_s = 0.3\n[limits]\ntwo_pi_error_ppm = 5.0\n")
    labels = {"unit": "FG-7"}
    assert resume_run(done.path, QUIET, kind=measurement("eps"), config=config, labels=labels).failure is None
    after = open_run(done.path)
    assert after.facts.labels == labels
    assert [one.limit.at_most for one in evaluate_run(after).tested] == [5.0]


@pytest.mark.parametrize(("name", "table"), [("eps", "segment"), ("witness", "record")])
def test_a_run_of_an_earlier_version_goes_on(tmp_path: Path, name: str, table: str) -> None:
    file = Path(shutil.copy(GOLDEN / f"fog_{name}.sqlite", tmp_path / "run.sqlite"))
    whole = open_run(file).records
    with closing(sqlite3.connect(file)) as db, db:
        db.execute(f"DELETE FROM {table} WHERE number = {whole[-1].number}")
        db.execute("DELETE FROM run WHERE name = 'outcome'")
    assert resume_run(file, QUIET, kind=measurement(name)).failure is None
    after = open_run(file)
    assert [record.intact for record in after.records] == [True] * len(whole)
    assert after.facts["outcome"] == TAKEN
    if name == "eps":  # the noise of a segment is that of its name
        assert after.records[-1].payload == whole[-1].payload
    assert evaluate_run(after).document()["left_out"] == []
