"""Bias repeatability, transient and warm-up in `gyrolock fog figures`, against the simulation's truth."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from station.fibre_gyro.settings import load_fog_settings
from station.live.events import Progress
from station.measurements import measurement
from station.report.show import render_report
from station.runs.store import open_run
from station.shell.finish import evaluate_run, start_run

FEW = {"runs": 4, "rates_dps": [10.0, 50.0, 100.0], "temperatures_c": [], "turn_on_s": 900.0, "static_s": 120.0}


def test_repeatability_and_warm_up_of_the_bias(taken) -> None:
    simulation = {"seed": 8, "angle_random_walk": 0.002, "switch_on_bias_dph": 0.2, "output_rate_hz": 2.0}
    evaluated, run = taken("figures", figures=FEW, simulation=simulation, limits={"warm_up_s": 100.0})
    found = evaluated.document()
    assert found["bias_repeatability_low_95_dph"] < 0.2 < found["bias_repeatability_high_95_dph"]
    assert found["bias_repeatability_low_95_dph"] < found["bias_repeatability_dph"]
    # 1 deg/h that dies away with 100 s is within 0.1 deg/h after 100 ln 10
    assert found["warm_up_low_95_s"] < 100 * math.log(10) < found["warm_up_high_95_s"] < 400
    assert found["turn_on_transient_dph"] == pytest.approx(1.0, abs=0.2)
    for one in found["runs"]:
        assert one["turn_on"]["exponentials"] == 1
        assert abs(one["turn_on"]["transient_dph"] - 1) < 5 * one["turn_on"]["transient_u_dph"]
    assert [one.passed for one in evaluated.tested] == [False]
    assert sum("since_on_s" in segment.conditions for segment in run.records) == 4
    page = render_report(evaluated)
    assert "Bias from one switching on to the next" in page


def test_a_record_that_is_too_short_says_so(taken) -> None:
    short = {**FEW, "runs": 2, "turn_on_s": 60.0, "warm_up_bound_dph": 0.01}
    simulation = {"angle_random_walk": 0.0005, "output_rate_hz": 4.0, "warm_up_time_s": 200.0}
    evaluated, _ = taken("figures", figures=short, simulation=simulation)
    assert evaluated.document()["warm_up_high_95_s"] is None
    assert any("too short to show that the bias stays within" in one for one in evaluated.result.to_watch)


def test_without_a_record_of_switching_on_there_is_no_warm_up(taken) -> None:
    evaluated, _ = taken(
        "figures", figures={**FEW, "runs": 2, "turn_on_s": 0.0}, simulation={"output_rate_hz": 4.0}
    )
    found = evaluated.document()
    assert found["warm_up_s"] is None
    assert found["runs"][0]["turn_on"] is None
    assert found["bias_repeatability_dph"] is not None


@pytest.mark.slow
def test_warm_up_of_the_scale_factor(taken) -> None:
    """100 ppm that die away with 100 s are within 10 ppm after 100 ln 10."""
    turning = {**FEW, "runs": 2, "turn_on_s": 600.0, "turn_on_rate_dps": 20.0, "warm_up_bound_ppm": 10.0}
    simulation = {"angle_random_walk": 0.002, "output_rate_hz": 2.0, "warm_up_scale_ppm": 100.0}
    evaluated, run = taken(
        "figures", figures=turning, simulation=simulation, limits={"scale_factor_warm_up_s": 100.0}
    )
    found = evaluated.document()
    assert found["scale_factor_transient_low_95_ppm"] < 100 < found["scale_factor_transient_high_95_ppm"]
    low, high = (found[f"scale_factor_warm_up_{end}_95_s"] for end in ("low", "high"))
    assert low < 100 * math.log(10) < high < low + 60
    assert found["turn_on_transient_dph"] == pytest.approx(1.0, abs=0.2)  # of the bias, as without
    assert [one.passed for one in evaluated.tested] == [False]
    assert sum("since_on_s" in segment.conditions for segment in run.records) == 6
    assert "The same of K" in render_report(evaluated)


def logged(folder: Path, dead: np.ndarray, listed: Sequence[tuple[float, float]]) -> dict[str, object]:
    """Figures of logs; those from switching on begin with `dead` words."""
    rng, t = np.random.default_rng(5), np.arange(0, 60, 0.05)
    lines = ["file,rate_dps,since_on_s"]
    for rate in (0.0, 10.0, -10.0, 20.0, -20.0, 30.0, -30.0):
        words = 246.15 * rate + rng.normal(0, 0.5, t.size)
        np.savetxt(folder / f"{rate:g}.csv", np.c_[t, words], "%.9g", ",", header="time,counts", comments="")
        lines.append(f"{rate:g}.csv,{rate:g},")
    for number, (rate, since) in enumerate(listed):
        words = 246.15 * rate * (1 + 3e-3 * np.exp(-t / 5)) + 40 * np.exp(-t / 8) + rng.normal(0, 0.5, t.size)
        words[: dead.size] = dead
        np.savetxt(folder / f"on{number}.csv", np.c_[t, words], "%.9g", ",", header="time,counts", comments="")
        lines.append(f"on{number}.csv,{rate:g},{since:g}")
    (folder / "list.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    overrides = {"output": {"directory": str(folder)}}
    settings, paths = load_fog_settings(overrides=overrides), [folder / "list.csv"]
    started = start_run(measurement("figures"), settings, Progress(), paths=paths)
    return evaluate_run(open_run(started.path)).document()


@pytest.mark.parametrize(
    ("dead", "valid"),
    [
        (np.zeros(0), 2.0),
        (np.zeros(100), 7.0),
        (np.full(37, 8388607.0), 3.85),
        (np.r_[np.random.default_rng(1).normal(0, 3e4, 60), np.zeros(40)], 7.0),
    ],
)
def test_the_output_is_used_from_where_it_is_one(tmp_path: Path, dead: np.ndarray, valid: float) -> None:
    found = logged(tmp_path, dead, [(0.0, 2.0), (20.0, 2.0), (-20.0, 2.0)])
    assert found["output_valid_s"] == pytest.approx(valid, abs=0.06)
    (run,) = found["runs"]
    dph = 3600 * 40 / 246.15 * math.exp(2 / 8)  # where it was switched on, 2 s before the log
    assert abs(run["turn_on"]["transient_dph"] - dph) < max(5 * run["turn_on"]["transient_u_dph"], 0.03 * dph)
    ppm = 3000 * math.exp(2 / 5)
    assert abs(found["scale_factor_transient_ppm"] - ppm) < max(
        5 * found["scale_factor_transient_u_ppm"], 0.03 * ppm
    )


def test_one_sense_gives_no_warm_up_of_k(tmp_path: Path) -> None:
    found = logged(tmp_path, np.zeros(0), [(20.0, 0.0), (0.0, 0.0)])
    assert found["scale_factor_transient_ppm"] is None
    assert "needs the output from switching on in both senses" in str(found["left_out"])
    assert found["turn_on_transient_dph"] is not None
