"""Logs with the table's own encoder: its rate, its spin-up and its whole turns are read, not believed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.fibre_gyro import turn_by_encoder
from station.errors import NoUsableSignal
from station.fibre_gyro.settings import load_fog_settings
from tests.station.fibre_gyro.test_logs_as_they_come import VERTICAL, Logs

TRUE_K = load_fog_settings().nominal_scale_factor * (1 + 8e-5)
OUTPUTS_HZ, FINE = 20, 50


def encoder_log(
    rng: np.random.Generator, rate: float, *, spin_s: float, turns: float, step_deg: float, ripple: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps, words and angles of a table that spins up, turns with a ripple of one period a turn, and stops."""
    seconds = 2 * spin_s + turns * 360 / abs(rate) + rng.uniform(0, 5)
    fine = np.arange(int(seconds * OUTPUTS_HZ) * FINE) / (OUTPUTS_HZ * FINE)
    share = np.clip(np.minimum(fine / spin_s, (fine[-1] - fine) / spin_s), 0, 1)
    speed = rate * share * (1 + ripple * np.sin(2 * np.pi * rate / 360 * fine + rng.uniform(0, 6)))
    angle = rng.uniform(0, 360) + np.cumsum(speed) / (OUTPUTS_HZ * FINE)
    words = TRUE_K * (speed.reshape(-1, FINE).mean(axis=1) + VERTICAL) + 0.5
    seen = angle.reshape(-1, FINE)[:, -1]
    times = fine.reshape(-1, FINE)[:, -1]
    return times, words + rng.normal(0, 0.3, words.size), np.floor(seen / step_deg) * step_deg % 360


def table(
    folder: Path, rates: Sequence[float], *, off: float = 6.5e-5, header: str = "table_deg", drop: bool = False,
    step_deg: float = 1e-3, ripple: float = 1e-3,
) -> dict[str, Any]:  # fmt: skip
    logs = Logs(folder, "file,axis,rate_dps")
    for number, rate in enumerate(rates):
        times, words, angle = encoder_log(
            logs.rng, rate * (1 + off), spin_s=7.0, turns=4.3, step_deg=step_deg, ripple=ripple
        )
        rows = np.column_stack([logs.now + times, words, angle])
        if drop:
            rows = rows[logs.rng.uniform(size=len(rows)) > 0.01]
        logs.now += float(times[-1]) + 1.0
        np.savetxt(folder / f"{number}.csv", rows, "%.9g", ",", header=f"time,counts,{header}", comments="")
        logs.rows.append(f"{number}.csv,Z,{rate}")
    return logs.evaluate("table")


RATES = (10.0, -10.0, 20.0, -20.0, 40.0, -40.0)


@pytest.mark.parametrize(
    "bench",
    [{}, {"drop": True}, {"header": "Table angle [deg]", "step_deg": 0.05}, {"off": -0.02, "ripple": 1e-4}],
    ids=["as it is", "rows missing", "coarse", "another rate than the list says"],
)
def test_the_scale_factor_is_that_of_the_encoder(tmp_path: Path, bench: dict[str, Any]) -> None:
    found = table(tmp_path, RATES, **bench)
    axis = found["axes"][0]
    value, u = axis["scale_factor_counts_per_dps"], axis["scale_factor_u_counts_per_dps"]
    assert abs(value - TRUE_K) < 3 * u
    assert u < 2e-5 * TRUE_K
    assert not any("changes by" in flag for flag in found["flags"])


def test_without_the_encoder_the_spin_up_is_in_the_scale_factor_and_said(tmp_path: Path) -> None:
    found = table(tmp_path, RATES, header="other")
    assert abs(found["axes"][0]["scale_factor_counts_per_dps"] / TRUE_K - 1) > 1e-3
    assert found["standing"] == "doubtful"


def test_a_table_that_turned_the_other_way_is_told(tmp_path: Path) -> None:
    with pytest.raises(NoUsableSignal, match=r"Z \+10 .* by its encoder the table turned at -10 deg/s"):
        table(tmp_path, RATES, off=-2.0)


@pytest.mark.parametrize("rate", [-37.3, 3.1, 80.0])
@pytest.mark.parametrize("spin_s", [3.0, 20.0])
def test_whole_turns_lie_where_the_table_is_steady(rate: float, spin_s: float) -> None:
    rng = np.random.default_rng([int(100 * abs(rate)), int(spin_s)])
    times, _, angle = encoder_log(rng, rate, spin_s=spin_s, turns=5.4, step_deg=0.01, ripple=0.0)
    turn = turn_by_encoder(times, angle, 1.01 * rate)
    assert abs(turn.rate_dps / rate - 1) < 2e-6
    assert turn.turns in (4, 5, 6)
    assert times[turn.first] > spin_s and times[turn.end - 2] < times[-1] - spin_s


@pytest.mark.parametrize(
    ("times", "angle", "rate", "said"),
    [
        (np.arange(9), np.zeros(9), 20.0, "too few"),
        (np.arange(100) * 1.0, np.arange(100) * 200.0 % 360, 200.0, "half a turn"),
        (np.arange(1000) * 0.1, np.full(1000, np.nan), 20.0, "0 rows of the table's angle are too few"),
        (np.arange(1000) * 0.1, np.zeros(1000), 20.0, "by its encoder: record a whole turn"),
        (np.arange(400) * 0.1, np.arange(400) * 0.4, 4.0, "record a whole turn"),
    ],
    ids=["few rows", "too fast", "no numbers", "stands still", "less than a turn"],
)
def test_an_angle_that_tells_no_rate_is_refused(times: Any, angle: Any, rate: float, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        turn_by_encoder(times, angle, rate)


def test_an_angle_in_another_unit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Exception, match="must be in deg, not in 'rad'"):
        table(tmp_path, RATES[:2], header="table_angle [rad]")


def test_small_rates_need_no_whole_turn_though_the_angle_is_there(tmp_path: Path) -> None:
    logs, now = Logs(tmp_path, "file,rate_dps"), 0.0
    for number, rate in enumerate((0.0, 0.1, -0.1, 0.2, -0.2, 0.0)):
        times = np.arange(200) / 10
        words = TRUE_K * rate + logs.rng.normal(0.0, 0.01, times.size)
        rows = np.column_stack([now + times, words, rate * times % 360])
        np.savetxt(tmp_path / f"{number}.csv", rows, "%.9g", ",", header="time,counts,table_deg", comments="")
        logs.rows.append(f"{number}.csv,{rate}")
        now += 21.0
    found = logs.evaluate("threshold", threshold={"table_axis": "east"})
    assert found["left_out"] == []
    assert [one["input_dps"] for one in found["points"]] == pytest.approx([0.1, -0.1, 0.2, -0.2])


def test_on_the_simulated_bench_the_encoder_takes_out_what_the_table_is_off(taken) -> None:
    """A table that is off by 100 ppm from run to run, without a word on its display."""
    sections = {"table": {"axes": ["Z"], "turns": 2}}
    truth: dict[str, object] = {"table_irreproducibility_ppm": 100.0, "misalignment_mrad": 0.0}
    with_encoder, _ = taken("table", **sections, simulation={**truth, "table_encoder": True})
    (axis,) = with_encoder.document()["axes"]
    assert abs(axis["nominal_difference_ppm"]) < 4 * axis["scale_factor_u_ppm"] < 4
    without, _ = taken("table", **sections, simulation=truth)
    (axis,) = without.document()["axes"]
    assert axis["scale_factor_u_ppm"] > 20
