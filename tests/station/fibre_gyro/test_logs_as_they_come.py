"""Lists of logs of a gyro that is made here: axes, ends of the axis, drift, parts of a log, numbers of a table."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.errors import UsageError
from station.fibre_gyro.selfcal import facts_of_table
from station.fibre_gyro.settings import load_fog_settings
from station.live.events import Progress
from station.measurements import measurement
from station.runs.store import open_run
from station.shell.finish import evaluate_run, start_run

K, VERTICAL, SIZE = 246.0, 15.041067 / 3600 * np.sin(np.deg2rad(45.78)), 200
QUIET = Progress()


class Logs:
    """Writes logs and their list; noise of 0.01 counts, 10 words a second."""

    def __init__(self, folder: Path, header: str) -> None:
        self.folder, self.rows, self.rng = folder, [header], np.random.default_rng(8)
        self.now = 0.0

    def add(self, row: str, counts: float, *, size: int = SIZE, drift: float = 0.0) -> None:
        name = f"log{len(self.rows)}.csv"
        times = self.now + np.arange(size) / 10
        self.now += size / 10
        values = counts + drift * times + self.rng.normal(0, 0.01, size)
        np.savetxt(
            self.folder / name, np.column_stack([times, values]), "%.9g", ",", header="time,counts", comments=""
        )
        self.rows.append(f"{name},{row}")

    def evaluate(self, command: str, known: Any = None, **sections: Any) -> dict[str, Any]:
        path = self.folder / "list.csv"
        path.write_text("\n".join(self.rows) + "\n")
        settings = load_fog_settings(overrides={**sections, "output": {"directory": str(self.folder)}})
        done = start_run(measurement(command), settings, QUIET, paths=[path], known=known)
        return {**evaluate_run(open_run(done.path)).document(), "path": done.path}


def figures(logs: Logs, axis: str, scale: float, end: int = 1, drift: float = 0.0) -> None:
    def add(rate: float) -> None:
        logs.add(f"{axis},{rate},{end}", end * scale * (rate + VERTICAL) + 0.5, drift=drift)

    add(0)
    for rate in (40.0, -40.0, 60.0, -60.0, 80.0, -80.0):
        add(rate)
    add(0)


def test_three_axes_in_one_list_are_three_gyros(tmp_path: Path) -> None:
    logs = Logs(tmp_path, "file,axis,rate_dps,end_up")
    for axis, scale in (("X", K), ("Y", 1.002 * K), ("Z", -0.997 * K)):
        figures(logs, axis, scale)
    found = logs.evaluate("figures")
    assert found["scale_factor_counts_per_dps"] is None
    assert [one["axis"] for one in found["axes"]] == ["X", "Y", "Z"]
    scales = [one["scale_factor_counts_per_dps"] for one in found["axes"]]
    assert scales == pytest.approx([K, 1.002 * K, -0.997 * K], rel=3e-6)
    assert found["nonlinearity_ppm"] < 1.0
    assert evaluate_run(open_run(found["path"])).sections()  # an output that falls with the rate can be drawn too


def test_both_ends_of_an_axis_give_one_line(tmp_path: Path) -> None:
    logs = Logs(tmp_path, "file,axis,rate_dps,end_up")
    for end in (1, -1):
        figures(logs, "Z", K, end)
    found = logs.evaluate("figures")
    assert found["scale_factor_counts_per_dps"] == pytest.approx(K, rel=3e-6)
    assert found["nonlinearity_ppm"] < 1.0 and found["left_out"] == []
    # without rest the other way up, the vertical earth rate of that end is not known: left out by name
    logs.rows = [row for row in logs.rows if not row.endswith(",0,-1")]
    found = logs.evaluate("figures")
    assert len(found["left_out"]) == 6
    assert all("no static output with this end of the axis down" in one["reason"] for one in found["left_out"])


def test_a_drift_of_the_bias_is_taken_out_and_every_static_output_counts(tmp_path: Path) -> None:
    logs = Logs(tmp_path, "file,axis,rate_dps,end_up")
    figures(logs, "Z", K, drift=1e-2)
    found = logs.evaluate("figures")
    assert found["nonlinearity_ppm"] < 1.5
    assert any("drifted by" in flag and "interpolated" in flag for flag in found["flags"])
    steps = Logs(tmp_path, "file,stands_for_dps,number")
    for rate in (0.0, -20.0, -10.0, 0.0, 10.0, 20.0, 0.0):
        steps.add(f"{rate},{K * rate}", 3.0 + K * rate, drift=2e-3)
    found = steps.evaluate("selfcal")
    assert abs(found["self_minus_numbers_ppm"]) < 4 * found["self_minus_numbers_u_ppm"] < 20
    assert any("interpolated in time" in flag for flag in found["flags"])


def test_numbers_of_a_table_run_keep_their_uncertainty_in_logs(tmp_path: Path) -> None:
    table = Logs(tmp_path, "file,axis,rate_dps")
    for rate in (20.0, -20.0, 20.01, -20.01, 20.1, -20.1, 21.0, -21.0):
        scale = K * (1 + 10e-6 * table.rng.normal())
        table.add(f"Z,{rate}", scale * (rate + VERTICAL), size=int(3600 / abs(rate)) + 10)
    made = table.evaluate("table", table={"turns": 10})
    facts = facts_of_table(load_fog_settings(), made["path"])
    steps = Logs(tmp_path, "file,stands_for_dps,number")
    steps.add("0,0", 3.0)
    for rate, number in zip(facts["numbers"]["rate_dps"], facts["numbers"]["number"], strict=True):
        steps.add(f"{rate},{number!r}", 3.0 + number)
    steps.add("0,0", 3.0)
    found = steps.evaluate("selfcal", facts)
    difference = next(one for one in made["axes"][0]["differences"] if one["delta_dps"] == 1.0)
    assert found["self_minus_table_u_ppm"] == pytest.approx(difference["relative_u_ppm"], rel=0.1)
    assert abs(found["self_minus_table_ppm"]) < 4 * found["self_minus_table_u_ppm"]
    assert found["self_minus_numbers_u_ppm"] < 0.2 * found["self_minus_table_u_ppm"]


def test_a_part_of_a_log_is_named_by_its_own_times(tmp_path: Path) -> None:
    logs = Logs(tmp_path, "file,axis,rate_dps,start_s,stop_s")
    logs.now = 36_000.0
    for rate in (40.0, -40.0):
        logs.add(f"Z,{rate},{logs.now + 2},{logs.now + 11}", K * (rate + VERTICAL))
    points = logs.evaluate("table")["axes"][0]["points"]
    assert [(point["turns"], point["samples"]) for point in points] == [(1, 90), (1, 90)]
    logs.rows[1] = "log1.csv,Z,40,2,11"
    with pytest.raises(
        UsageError, match=re.escape("log 1: from 2 s to 11 s the log holds no output; its times go from 36000")
    ):
        logs.evaluate("table")
    logs.rows[1] = "log1.csv,Z,40,11,2"
    with pytest.raises(UsageError, match="stop_s: 2 s must be later than start_s, 11 s"):
        logs.evaluate("table")


def test_rates_below_one_turn_are_not_left_out(tmp_path: Path) -> None:
    logs = Logs(tmp_path, "file,axis,rate_dps,end_up")
    figures(logs, "Z", K)
    for rate in (0.01, -0.01):
        logs.add(f"Z,{rate},1", 0.0 + K * VERTICAL + 0.5)  # a dead zone
    logs.add("Z,0,1", K * VERTICAL + 0.5)
    found = logs.evaluate("figures")
    assert found["left_out"] == []
    assert "near zero" in found["runs"][0]["pattern"]


@pytest.mark.parametrize(
    ("head", "gyro", "where"),
    [("counts", {}, "watch"), ("counts", {"counts_per_code": 15.5}, "said"), ("rate [deg/h]", {}, "")],
)
def test_noise_in_counts_says_which_scale_factor_made_degrees_of_it(
    tmp_path: Path, head: str, gyro: dict[str, float], where: str
) -> None:
    """Without a table the scale factor is the one by design; that of the shipped gyro is hardly this one's."""
    words = np.random.default_rng(4).normal(0, 1, 600)
    path = tmp_path / "rest.csv"
    np.savetxt(
        path, np.column_stack([np.arange(600) / 10, words]), "%.6g", ",", header=f"time_s,{head}", comments=""
    )
    settings = load_fog_settings(overrides={"gyro": gyro, "output": {"directory": str(tmp_path)}})
    made = evaluate_run(open_run(start_run(measurement("allan"), settings, QUIET, paths=[path]).path)).result
    told = {"watch": made.to_watch, "said": made.sentences}
    by_design = f"by design, {settings.nominal_scale_factor:.6g} counts per deg/s"
    assert [any(by_design in one for one in told[name]) for name in told] == [name == where for name in told]


def test_the_transient_of_switching_on_is_by_the_measured_scale_factor(tmp_path: Path) -> None:
    """10 deg/h that die away with 20 s, of a gyro of ten times the scale factor by design."""
    logs, scale = Logs(tmp_path, "file,axis,rate_dps,end_up,since_on_s"), 10 * K
    times = np.arange(3000) / 10
    values = scale * (VERTICAL + 10 / 3600 * np.exp(-times / 20)) + logs.rng.normal(0, 0.01, times.size)
    np.savetxt(
        tmp_path / "on.csv", np.column_stack([times, values]), "%.9g", ",", header="time,counts", comments=""
    )
    logs.rows.append("on.csv,Z,0,1,0")
    logs.now = 400.0
    for rate in (0, 40.0, -40.0, 60.0, -60.0, 80.0, -80.0, 0):
        logs.add(f"Z,{rate},1,", scale * (rate + VERTICAL))
    (run,) = logs.evaluate("figures")["runs"]
    assert run["turn_on"]["transient_dph"] == pytest.approx(10, rel=0.05)
