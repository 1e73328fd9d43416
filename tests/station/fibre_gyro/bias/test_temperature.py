"""Scale factor and bias over a temperature ramp: simulated bench, logs, resumed; the compensation table."""

from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from instrument import LinkError
from station.errors import NoUsableSignal
from station.fibre_gyro import bench as simulated_bench
from station.fibre_gyro.bench import SimulatedFogBench
from station.fibre_gyro.segments import PlannedSegment
from station.fibre_gyro.settings import load_fog_settings
from station.fibre_gyro.temperature import plan
from station.live.events import Progress
from station.measurements import measurement
from station.report.show import render_report
from station.runs.store import open_run
from station.shell.finish import evaluate_run, resume_run, start_run

QUIET = Progress()
RAMP: dict[str, Any] = {"ramp_c_per_min": 4.0, "rest_s": 60.0, "window_s": 60.0, "settle_s": 1.0}
TRUTH: dict[str, Any] = {
    "seed": 4,
    "output_rate_hz": 2.0,
    "temperature_coefficient_ppm": -3.0,
    "scale_curvature_ppm_per_k2": 0.05,
    "bias_dph": 0.4,
    "bias_dph_per_k": 0.03,
    "bias_dph_per_k2": -4e-4,
    "bias_dph_per_k_per_min": 0.2,
}


@pytest.fixture(scope="module")
def quick() -> dict[str, Any]:
    return {"temperature": RAMP, "simulation": TRUTH}


@pytest.mark.slow
def test_a_ramp_gives_the_models_that_it_was_made_with(taken, quick) -> None:
    evaluated, run = taken("temperature", **quick)
    found = evaluated.document()
    k, bias = found["scale_factor"], found["bias"]
    assert k["order"] >= 2
    assert np.all(
        np.abs(np.array(k["coefficients_ppm"][:3]) - [0, -3, 0.05]) < 5 * np.array(k["coefficients_u_ppm"][:3])
    )
    assert k["coefficients_u_ppm"][1] < 0.1
    assert bias["with_rate"]
    assert abs(bias["dph_per_k_per_min"] - 0.2) < 5 * bias["dph_u_per_k_per_min"] < 0.1
    table = found["compensation"]
    assert table["temperature_c"][0] >= -20
    assert table["temperature_c"][-1] <= 60
    warm = np.array(table["temperature_c"]) - 20
    off = np.array(table["bias_dph"], dtype=float) - (0.4 + 0.03 * warm - 4e-4 * warm**2)
    known = np.isfinite(off)
    assert known.sum() > 10
    assert np.all(np.abs(off[known]) < 5 * np.array(table["bias_u_dph"], dtype=float)[known])
    # nothing is given where nothing was measured
    inside = (np.array(table["temperature_c"]) >= bias["lowest_c"]) & (
        np.array(table["temperature_c"]) <= bias["highest_c"]
    )
    assert np.array_equal(inside, known)
    assert "has the least AICc of" in evaluated.result.sentences[0]
    assert len(run.records) > 30
    page = render_report(evaluated)
    assert page.count("<svg") == 3
    assert "Compensation table, axis Z" in page


def test_rest_alone_gives_the_bias_and_says_what_it_rests_on(taken, quick) -> None:
    alone = {**quick, "temperature": {**RAMP, "rate_dps": 0.0}}
    evaluated, _ = taken("temperature", **alone)
    found = evaluated.document()
    assert found["scale_factor"] is None
    assert found["scale_factor_over_temperature_ppm"] is None
    assert found["bias"]["order"] >= 1
    assert any("no scale factor was measured" in one for one in evaluated.result.to_watch)
    assert all(one is None for one in found["compensation"]["scale_factor_counts_per_dps"])


def log_of_a_ramp(path: Path, *, minutes: float = 30.0, up_and_down: bool = True) -> None:
    """A log at rest with the temperature in a column, by hand: 10 deg/h, 0.05 deg/h per K, 0.3 deg/h per K/min."""
    rng = np.random.default_rng(7)
    at = np.arange(0, 60 * minutes, 1.0)
    half = 30 * minutes
    warm = np.where(at < half, at / 60, (2 * half - at) / 60 if up_and_down else at / 60)
    change = np.where(at < half, 1.0, -1.0 if up_and_down else 1.0)
    dph = 10.7794 + 10 + 0.05 * warm + 0.3 * change + rng.normal(0, 0.05, at.size)
    dph[100] += 1e5
    rows = np.column_stack([at, dph, np.round(warm + rng.normal(0, 0.01, at.size), 2)])
    rows = np.delete(rows, np.arange(700, 740), axis=0)
    np.savetxt(path, rows, "%.6f", ",", header="time_s,output [deg/h],temperature", comments="")


def test_a_whole_log_at_rest(fog_settings, tmp_path: Path) -> None:
    log_of_a_ramp(tmp_path / "ramp.csv")
    kind, settings = measurement("temperature"), fog_settings(figures={"reference_temperature_c": 0.0})
    done = start_run(kind, settings, QUIET, paths=[tmp_path / "ramp.csv"])
    assert done.failure is None, done.failure
    evaluated = evaluate_run(open_run(done.path))
    watched = " ".join(evaluated.result.to_watch)
    assert "40 output words are missing." in watched
    assert "1 output word is far from all others and left out." in watched
    bias = evaluated.document()["bias"]
    assert bias["with_rate"]
    assert abs(bias["dph_per_k_per_min"] - 0.3) < 5 * bias["dph_u_per_k_per_min"] < 0.1
    assert abs(bias["coefficients_dph"][0] - 10) < 5 * bias["coefficients_u_dph"][0]
    assert abs(bias["coefficients_dph"][1] - 0.05) < 5 * bias["coefficients_u_dph"][1]


def test_one_way_alone_says_that_it_cannot_tell(fog_settings, tmp_path: Path) -> None:
    log_of_a_ramp(tmp_path / "ramp.csv", up_and_down=False)
    done = start_run(measurement("temperature"), fog_settings(), QUIET, paths=[tmp_path / "ramp.csv"])
    evaluated = evaluate_run(open_run(done.path))
    assert not evaluated.document()["bias"]["rate_known"]
    assert any("let the temperature go up and down again" in one for one in evaluated.result.to_watch)


def test_without_a_temperature_it_is_said(fog_settings, tmp_path: Path) -> None:
    at = np.arange(0, 300.0)
    np.savetxt(tmp_path / "cold.csv", np.column_stack([at, at]), "%.6f", ",", header="time_s,counts", comments="")
    done = start_run(measurement("temperature"), fog_settings(), QUIET, paths=[tmp_path / "cold.csv"])
    with pytest.raises(NoUsableSignal, match="nobody gives a temperature: the output needs a column temperature"):
        evaluate_run(open_run(done.path))


@pytest.mark.slow
def test_a_ramp_that_was_cut_short_goes_on(quick, taken, fog_settings, monkeypatch: pytest.MonkeyPatch) -> None:
    class FailingBench(SimulatedFogBench):
        def prepare(self, planned: PlannedSegment) -> dict[str, Any]:
            if planned.key == "down 3, rest":
                raise LinkError("the cable is out")
            return super().prepare(planned)

    kind = measurement("temperature")
    with monkeypatch.context() as patched:
        patched.setattr(simulated_bench, "SimulatedFogBench", FailingBench)
        done = start_run(kind, fog_settings(**quick), QUIET)
    assert done.failure is not None
    assert resume_run(done.path, QUIET, kind=kind).failure is None
    whole, _ = taken("temperature", **quick)
    assert evaluate_run(open_run(done.path)).document()["bias"] == whole.document()["bias"]


def ramp_with(
    folder: Path,
    *,
    play_c: float = 0.0,
    by_rate: float = 0.0,
    slope: float = 0.02,
    bend: float = 0.0,
    late_s: float = 0.0,
    stated_s: float = 0.0,
) -> Any:
    """A log at rest over one ramp up and down at 1 K/min; the temperature of the bias lags by a play."""
    rng, seconds = np.random.default_rng(0), np.arange(0.0, 9600.0, 0.5)
    temperature = 60.0 - np.abs(seconds - 4800.0) / 60.0
    felt = temperature.copy()
    for place in range(1, felt.size):
        low, high = temperature[place] - play_c / 2, temperature[place] + play_c / 2
        felt[place] = min(max(felt[place - 1], low), high)
    bias = 0.4 + slope * (felt - 20.0) + by_rate * np.gradient(temperature, seconds) * 60.0
    bias += bend * (felt - 20.0) ** 2
    temperature = np.interp(seconds - late_s, seconds, temperature)  # as the thermometer says it
    earth = 15.041067 * np.sin(np.deg2rad(load_fog_settings().site.latitude_deg))
    words = earth + bias + rng.normal(0.0, 0.4, seconds.size)
    header = "time_s,gyro z [deg/h],temperature"
    np.savetxt(
        folder / "ramp.csv",
        np.column_stack([seconds, words, temperature]),
        "%.9g",
        ",",
        header=header,
        comments="",
    )
    stated = {"thermometer_lag_s": stated_s}
    settings = load_fog_settings(overrides={"output": {"directory": str(folder)}, "temperature": stated})
    done = start_run(measurement("temperature"), settings, QUIET, paths=[folder / "ramp.csv"])
    return evaluate_run(open_run(done.path))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "truth"),
    [({}, 0.0), ({"by_rate": 0.1}, 0.2), ({"play_c": 10.0}, -0.2), ({"play_c": 6.0, "slope": -0.04}, 0.24)],
)
def test_going_up_less_going_down_is_given_with_what_it_may_be(tmp_path: Path, how: Any, truth: float) -> None:
    evaluated = ramp_with(tmp_path, **how)
    found = evaluated.document()
    assert abs(found["bias_hysteresis_dph"] - truth) < max(3 * found["bias_hysteresis_u_dph"], 0.02)
    assert found["bias_hysteresis_u_dph"] < 0.15
    if truth:  # it is seen
        assert abs(found["bias_hysteresis_dph"]) > 1.5 * found["bias_hysteresis_u_dph"]
    assert "cannot tell hysteresis, a drift and an effect of dT/dt apart" in evaluated.result.sentences[-1]


@pytest.mark.slow
@pytest.mark.parametrize("late_s", [0.0, 120.0, -200.0])
def test_a_thermometer_that_is_late_is_told_and_can_be_stated(tmp_path: Path, late_s: float) -> None:
    """A parabola: beside a late thermometer the other senses of the ramp make two of it."""
    found = ramp_with(tmp_path, bend=2e-4, late_s=late_s).document()
    said = [one for one in found["flags"] if "thermometer_lag_s" in one]
    assert bool(said) == bool(late_s)
    if late_s:
        assert ("it is late" in said[0]) == (late_s > 0)
        stated = ramp_with(tmp_path, bend=2e-4, late_s=late_s, stated_s=late_s).document()
        assert not [one for one in stated["flags"] if "thermometer_lag_s" in one]
        assert stated["axes"][0]["bias"]["order"] == 2
        square, u = (stated["axes"][0]["bias"][f"coefficients{end}_dph"][2] for end in ("", "_u"))
        assert abs(square - 2e-4) < 3 * u


def test_several_times_up_and_down_with_a_stay_at_each_end() -> None:
    """Nothing is there twice, the chamber goes on from where it was, and slow noise is averaged over the ramps."""
    short = {"coldest_c": 10.0, "hottest_c": 40.0, "ramp_c_per_min": 2.0, "cycles": 3, "hold_s": 400.0}
    settings = load_fog_settings(overrides={"temperature": short})
    planned = plan(settings)
    assert len({one.key for one in planned}) == len(planned)
    begins = [one.conditions["planned_begin_s"] for one in planned]
    assert begins == sorted(begins) and begins[-1] > 3 * 2 * (900 + 400) - 200
    temperatures = np.array([one.conditions["planned_temperature_c"] for one in planned])
    assert np.abs(np.diff(temperatures)).max() < 6.0 and temperatures.max() < 42.0 and temperatures.min() > 8.0
    held = [one for one in planned if not one.conditions["ramp_c_per_min"]]
    assert {one.conditions["by_hand"] for one in held} == {
        "Hold the chamber at 40 deg C.",
        "Hold the chamber at 10 deg C.",
    }
    ramps = [one.conditions["ramp_c_per_min"] for one in planned]
    assert [ramp for ramp, _ in groupby(ramps)] == [2.0, 0.0, -2.0, 0.0] * 3


def test_hysteresis_of_the_scale_factor(tmp_path: Path) -> None:
    short = {"coldest_c": 10.0, "hottest_c": 40.0, "ramp_c_per_min": 2.0, "cycles": 2, "hold_s": 300.0}
    settings = load_fog_settings(overrides={"temperature": short, "output": {"directory": str(tmp_path)}})
    found = evaluate_run(open_run(start_run(measurement("temperature"), settings, QUIET).path)).document()
    assert abs(found["scale_factor_hysteresis_ppm"]) < 4 * found["scale_factor_hysteresis_u_ppm"] < 40
    # 0.1 deg/h per K/min of the shipped gyro, at 2 K a minute up and down
    assert abs(found["bias_hysteresis_dph"] - 0.4) < 4 * found["bias_hysteresis_u_dph"]
