"""Threshold, resolution and dead zone on the simulated bench, through logs, resumed and over a serial line."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from instrument import LinkError
from instrument.fibre_gyro import write_gyro_log
from station.errors import NoUsableSignal, UsageError
from station.fibre_gyro import bench as simulated_bench
from station.fibre_gyro.bench import SimulatedFogBench
from station.fibre_gyro.segments import PlannedSegment, segments_of
from station.fibre_gyro.settings import load_fog_settings
from station.live.events import Progress
from station.measurements import measurement
from station.report.show import render_report
from station.runs.store import open_run
from station.shell.finish import evaluate_run, resume_run, start_run
from tests.station.fibre_gyro.test_logs_as_they_come import Logs

QUIET = Progress()
FEW: dict[str, Any] = {"per_decade": 1, "highest_dps": 0.1, "resolution_at_dps": 0.05}
DEAD: dict[str, Any] = {"dead_zone_dps": 0.004, "seed": 3}


@pytest.fixture
def dead(taken):
    """A gyro without output up to 0.004 deg/s."""
    return taken("threshold", threshold=FEW, simulation=DEAD)


def test_a_dead_zone_is_found_between_the_rungs_about_it(dead) -> None:
    evaluated, run = dead
    found = evaluated.document()
    # ladder 0.001, 0.01, 0.1, then two more in each sense between 0.001 and 0.01: 0.00215, 0.00464
    assert 0.00215 < found["threshold_low_95_dps"] < 0.004 < found["threshold_high_95_dps"] < 0.00465
    assert found["threshold_low_95_dps"] < found["threshold_dps"] < found["threshold_high_95_dps"]
    assert found["dead_zone_low_95_dps"] < 0.008 < found["dead_zone_high_95_dps"]
    # away from it the gyro shows every change
    assert found["resolution_dps"] is None
    assert found["resolution_high_95_dps"] == pytest.approx(0.001)
    assert found["scale_factor_counts_per_dps"] == pytest.approx(246.153, rel=1e-4)
    at_rest = {segment.conditions["rate_dps"] for segment in run.records if segment.conditions["reference"]}
    # the table turns against the vertical earth rate
    assert sorted(at_rest) == pytest.approx([-0.0029943, 0.05 - 0.0029943], rel=1e-3)
    assert found["truth"]["threshold_dps"] == 0.004
    page = render_report(evaluated)
    assert page.count("<svg") == 2
    assert evaluated.result.value in page


def test_a_gyro_without_a_dead_zone_gets_a_bound(taken) -> None:
    evaluated, _ = taken("threshold", threshold={**FEW, "refine": 0}, simulation={"seed": 3})
    found = evaluated.document()
    assert found["threshold_dps"] is None
    assert (found["threshold_low_95_dps"], found["threshold_high_95_dps"]) == (0.0, 0.001)
    assert evaluated.result.value == "Threshold below 0.001 deg/s"
    assert "the result is a bound" in " ".join(evaluated.result.sentences)


def test_a_limit_inside_the_interval_is_not_decided(taken) -> None:
    limits = {"threshold_dps": 0.004, "resolution_dps": 0.002}
    evaluated, _ = taken("threshold", threshold=FEW, simulation=DEAD, limits=limits)
    assert (evaluated.tested[0].verdict, evaluated.verdict) == ("MARGINAL", "MARGINAL")
    assert [one.name for one in evaluated.tested] == ["threshold_dps", "resolution_dps"]
    assert evaluated.tested[1].measured.value < 0.002  # a bound below the limit, of a doubtful run


def test_too_small_an_input_for_the_noise_is_left_out_by_name(taken) -> None:
    loud = {"angle_random_walk": 0.5, "seed": 1}
    evaluated, _ = taken(
        "threshold",
        threshold={**FEW, "angle_random_walk": 0.5, "longest_s": 20.0, "refine": 0, "resolution_at_dps": 0.0},
        simulation=loud,
    )
    (reason,) = [one.sentence for one in evaluated.result.left_out if one.name == "input 0.001"]
    assert "drowns in the noise" in reason
    assert evaluated.document()["threshold_high_95_dps"] >= 0.01


def test_a_run_that_was_cut_short_goes_on_with_the_same_ladder(
    dead, fog_settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    class FailingBench(SimulatedFogBench):
        def prepare(self, planned: PlannedSegment) -> dict[str, Any]:
            if planned.key == "further -0.00464159":
                raise LinkError("the cable is out")
            return super().prepare(planned)

    with monkeypatch.context() as patched:
        patched.setattr(simulated_bench, "SimulatedFogBench", FailingBench)
        done = start_run(measurement("threshold"), fog_settings(threshold=FEW, simulation=DEAD), QUIET)
    assert done.failure is not None
    assert resume_run(done.path, QUIET, kind=measurement("threshold")).failure is None
    after = open_run(done.path)
    assert [one.key for one in after.records] == [one.key for one in dead[1].records]
    assert evaluate_run(after).document()["points"] == dead[0].document()["points"]


def written(run: Any, folder: Path, *, only: str = "") -> Path:
    lines = ["file,rate_dps,base_dps"]
    for number, segment in enumerate(segments_of(run, "threshold")):
        one = segment.conditions
        if one["series"] == "noise" or (only and one["series"] != only):
            continue
        base = 0.05 - 0.00299428875 if one["series"] == "resolution" else ""
        rate = base if base and one["reference"] else one["rate_dps"]
        write_gyro_log(folder / f"log{number}.csv", segment.recording)
        lines.append(f"log{number}.csv,{rate!r},{base!r}" if base else f"log{number}.csv,{rate!r},")
    (folder / "list.csv").write_text("\n".join(lines) + "\n")
    return folder / "list.csv"


def test_logs_give_what_their_run_gave(dead, fog_settings, tmp_path: Path) -> None:
    path = written(dead[1], tmp_path)
    done = start_run(measurement("threshold"), fog_settings(threshold=FEW), QUIET, paths=[path])
    assert done.failure is None, done.failure
    again, before = evaluate_run(open_run(done.path)).document(), dead[0].document()
    for name in ("threshold_dps", "threshold_low_95_dps", "dead_zone_high_95_dps", "resolution_high_95_dps"):
        assert again[name] == pytest.approx(before[name], rel=0.02)


def test_at_rest_on_a_vertical_table_the_earth_rate_is_the_input(fog_settings, tmp_path: Path) -> None:
    """References at rest are at 0.003 deg/s: the threshold takes the gyro as linear there, and that is said."""
    lines = ["file,rate_dps"]
    bench = SimulatedFogBench(fog_settings(simulation={"seed": 1, "misalignment_mrad": 0.0}))
    for number, rate in enumerate([0.0, 0.001, -0.001, -0.004, 0.0, 0.1, -0.1, 0.0]):
        conditions = {"purpose": "threshold", "rate_dps": rate}
        recording = bench.record(PlannedSegment(f"{number}", 20.0, 0.0, conditions), lambda seconds: None)
        write_gyro_log(tmp_path / f"log{number}.csv", recording)
        lines.append(f"log{number}.csv,{rate}")
    (tmp_path / "list.csv").write_text("\n".join(lines))
    done = start_run(measurement("threshold"), fog_settings(), QUIET, paths=[tmp_path / "list.csv"])
    evaluated = evaluate_run(open_run(done.path))
    found = evaluated.document()
    assert found["reference_dps"] == pytest.approx(0.0029943, rel=1e-4)
    inputs = sorted(point["input_dps"] for point in found["points"])
    assert inputs[2] == pytest.approx(0.0029943 - 0.001, rel=1e-3)
    assert all(abs(point["ratio"] - 1) < 5 * point["ratio_u"] for point in found["points"])
    # changes about the earth rate give the resolution
    assert found["resolution_at_dps"] == pytest.approx(0.0029943, rel=1e-4)
    assert found["resolution_high_95_dps"] == pytest.approx(0.001)
    assert any("the gyro is taken to be linear there" in one for one in evaluated.result.to_watch)


def test_bad_lists_are_said(dead, fog_settings, tmp_path: Path) -> None:
    kind, settings = measurement("threshold"), fog_settings(threshold=FEW)
    path = written(dead[1], tmp_path, only="ladder")
    rows = path.read_text().splitlines()
    alone = tmp_path / "alone.csv"
    alone.write_text("\n".join([rows[0], *(row for row in rows[1:] if "-0.00299" not in row)]))
    done = start_run(kind, settings, QUIET, paths=[alone])
    with pytest.raises(NoUsableSignal, match="it has no output at rest: take one before and one after"):
        evaluate_run(open_run(done.path))
    alone.write_text("file\nlog1.csv\n")
    with pytest.raises(UsageError, match="its header has no column rate_dps, which threshold needs"):
        start_run(kind, settings, QUIET, paths=[alone])


RUNGS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)


def small_rates_of(folder: Path, seen: Any, sign: int = 1) -> list[str]:
    """What is said of a gyro that makes the output `seen(rate)` of a rate, on a table that lies to the east."""
    logs, scale = Logs(folder, "file,rate_dps"), load_fog_settings().nominal_scale_factor
    for number, size in enumerate(RUNGS):
        if number % 3 == 0:
            logs.add("0", scale * seen(0.0))
        for rate in (sign * size, -sign * size):
            logs.add(str(rate), scale * seen(rate))
    logs.add("0", scale * seen(0.0))
    flags: list[str] = logs.evaluate("threshold", threshold={"table_axis": "east"})["flags"]
    return flags


def zone(low: float, high: float, *, jumps: bool = False) -> Any:
    """A gyro that stands still between two rates; beyond, its output goes on or jumps to K times the rate."""

    def seen(rate: float) -> float:
        if low <= rate <= high:
            return 0.0 if low <= 0 <= high else low
        if jumps:
            return rate
        return rate - (high if rate > high else low) + (0.0 if low <= 0 <= high else low)

    return seen


@pytest.mark.parametrize("seen", [zone(-0.003, 0.003), zone(-0.003, 0.003, jumps=True), lambda rate: rate])
def test_a_dead_zone_about_zero_is_nothing_to_watch(tmp_path: Path, seen: Any) -> None:
    said = small_rates_of(tmp_path, seen)
    assert not [one for one in said if "of what K gives" in one or "not centred" in one]


def test_the_way_out_of_a_dead_zone_may_be_bent(tmp_path: Path) -> None:
    def seen(rate: float) -> float:
        return float(np.sign(rate) * np.sqrt(max(rate**2 - 0.004**2, 0.0)))

    assert not [one for one in small_rates_of(tmp_path, seen) if "of what K gives" in one]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seen", "named"),
    [
        (zone(0.006, 0.024), r"from \+0.01 to \+0.02 deg/s the output changes by -?0.0"),
        (zone(-0.024, -0.006), "from -0.01 to -0.02 deg/s the output changes by"),
        (lambda rate: rate * (0.6 if abs(rate) < 0.03 else 1.0), r"from \+0.002 to .* changes by 0.(59|60)"),
        (zone(-0.0015, 0.03), "not centred on zero: up to 0.0[23].* in the positive sense"),
    ],
    ids=["beyond zero", "below zero", "gain of 0.6", "to one side"],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_what_is_no_dead_zone_about_zero_is_named(tmp_path: Path, seen: Any, named: str, sign: int) -> None:
    said = small_rates_of(tmp_path, seen, sign)
    assert [one for one in said if re.search(named, one)], said
