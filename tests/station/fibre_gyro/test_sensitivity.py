"""`gyrolock fog sensitivity`: what a stimulus does to bias and scale factor; bias and K from six positions."""

import json
from pathlib import Path

import numpy as np
import pytest

from analysis.fibre_gyro import stimulus_response, tumble
from station.cli import main

EARTH_DPS = 15.041067 / 3600
LADDER = np.array([0, 1, 0, 2, 0, -1, 0, -2, 0, 1, 0, -2, 0], dtype=float)


def logs(folder: Path, rows: list[dict[str, object]], outputs: list[np.ndarray], rate_hz: float = 10.0) -> Path:
    """A list and the logs that it names, one behind the other in time."""
    begin, names = 100.0, list(rows[0])
    lines = [",".join(["file", *names])]
    for number, (row, counts) in enumerate(zip(rows, outputs, strict=True)):
        times = begin + np.arange(counts.size) / rate_hz
        text = "".join(f"{time:.2f},{value:.6f}\n" for time, value in zip(times, counts, strict=True))
        (folder / f"{number}.csv").write_text(f"time,counts\n{text}")
        lines.append(",".join([f"{number}.csv", *map(str, row.values())]))
        begin = float(times[-1]) + 5.0
    path = folder / "list.csv"
    path.write_text("\n".join(lines))
    return path


def run(capsys: pytest.CaptureFixture[str], *arguments: object, code: int = 0) -> dict[str, object]:
    assert main(["fog", "sensitivity", *map(str, arguments), "--json", "--no-report"]) == code
    return json.loads(capsys.readouterr().out)


def settings(folder: Path, text: str) -> Path:
    path = folder / "own.toml"
    path.write_text(text)
    return path


def test_a_drift_between_the_references_takes_nothing(tmp_path, monkeypatch, capsys):
    """3 deg/h per G under a drift of 40 deg/h over the run, bent; K by 200 ppm a G."""
    monkeypatch.chdir(tmp_path)
    rng, counts_per_dps = np.random.default_rng(4), 246.152866  # of the shipped coil, docs/fibre_gyro.md
    rows, outputs = [], []
    for number, stimulus in enumerate(LADDER):
        drift = 40 * (number / LADDER.size) ** 2
        for rate in (0.0, 20.0, -20.0):
            rows.append({"stimulus": stimulus, "rate_dps": rate})
            true = (3.0 * stimulus + drift) / 3600 + rate * (1 + 200e-6 * stimulus)
            outputs.append(counts_per_dps * true + rng.normal(0, 0.05, 720))
    own = settings(tmp_path, '[sensitivity]\nunit = "G"\n[limits]\nbias_sensitivity_dph_per_unit = 3.5\n')
    found = run(capsys, logs(tmp_path, rows, outputs), "--config", own)
    assert abs(found["bias_sensitivity_dph_per_unit"] - 3.0) < 4 * found["bias_sensitivity_u_dph_per_unit"]
    assert found["bias_sensitivity_u_dph_per_unit"] < 0.1
    assert abs(found["scale_factor_sensitivity_ppm_per_unit"] - 200) < (
        4 * found["scale_factor_sensitivity_u_ppm_per_unit"]
    )
    levels = {one["stimulus"]: one for one in found["levels"]["bias"]}
    assert set(levels) == {-2.0, -1.0, 1.0, 2.0}
    assert all(abs(one["change"] - 3 * level) < 4 * one["change_u"] for level, one in levels.items())
    assert found["bias_change_dph"] == max((one["change"] for one in levels.values()), key=abs)
    assert (found["standing"], found["verdict"], found["stimulus_unit"]) == ("stands", "PASS", "G")


@pytest.mark.slow
@pytest.mark.parametrize(("of", "slope_scale"), [("slope", 1.0), ("change", 2.0)])
def test_intervals_hold_what_they_say(of, slope_scale):
    """Noise, scatter from visit to visit and a drift of its own; 95 % of 150 within three binomial deviations."""
    rng, hits = np.random.default_rng(9), 0
    for _ in range(150):
        noise, scatter, slope = 0.1, rng.uniform(0, 0.3), rng.normal()
        times = np.cumsum(rng.uniform(90, 110, LADDER.size))
        values = (
            7 + slope * LADDER + rng.normal() * times / 300 + rng.normal(0, np.hypot(noise, scatter), LADDER.size)
        )
        found = stimulus_response(LADDER, values, np.full(LADDER.size, noise), times)
        value, u = (found.slope, found.slope_u) if of == "slope" else (found.change[-1], found.change_u[-1])
        hits += abs(value - slope_scale * slope) < 1.96 * u
    assert 0.95 - 0.055 < hits / 150 <= 1.0


def test_what_is_no_straight_line_and_what_has_no_reference_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(2)
    ladder = [0.0, 1.0, 2.0, 3.0, 4.0, 3.0, 1.0]
    outputs = [0.02 * one**2 + rng.normal(0, 0.05, 600) for one in ladder]
    found = run(capsys, logs(tmp_path, [{"stimulus": one} for one in ladder], outputs))
    said = " ".join(found["flags"])
    assert found["standing"] == "doubtful"
    assert "does not go with the magnetic field on a straight line" in said
    assert "was not seen at 1 mT before and after all others" in said


def test_what_is_seen_once_is_not_known_to_repeat(tmp_path, monkeypatch, capsys):
    """Three visits leave no residual: u would be the noise of the words alone."""
    monkeypatch.chdir(tmp_path)
    rng, once = np.random.default_rng(3), [0.0, 1.0, 0.0]
    for ladder, told in ((once, True), ([*once, 1.0, 0.0], False)):
        listed = logs(tmp_path, [{"stimulus": one} for one in ladder], [rng.normal(0, 1, 600) for _ in ladder])
        found = run(capsys, listed)
        assert any("No visit repeats another" in one for one in found["flags"]) == told
        assert found["standing"] == ("doubtful" if told else "stands")


def axes(rng) -> np.ndarray:
    return np.linalg.qr(rng.normal(size=(3, 3)))[0]


def test_six_positions_give_bias_and_scale_factor_anywhere():
    rng, inside = np.random.default_rng(6), np.zeros(2)
    for _ in range(200):
        earth, bias, k = EARTH_DPS * axes(rng)[0], rng.normal(0, 1), rng.uniform(100, 1000)
        off, u = 2e-3, k * EARTH_DPS * rng.uniform(1e-4, 3e-3)
        means = np.empty((3, 2))
        for row, axis in enumerate(axes(rng)):
            for column, sense in enumerate((1, -1)):
                pointing = sense * axis + rng.uniform(-off, off, 3)
                means[row, column] = bias + k * pointing @ earth / np.linalg.norm(pointing) + rng.normal(0, u)
        found = tumble(means, np.full((3, 2), u), off)
        inside += [
            abs(found.slope - k) < 1.96 * found.slope_u,
            abs(found.intercept - bias) < 1.96 * found.intercept_u,
        ]
    assert np.all((inside / 200 > 0.90) & (inside / 200 < 0.995))


def test_six_positions_on_the_bench_and_from_logs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    own = settings(tmp_path, "[sensitivity]\ntumble = true\nrecord_s = 600.0\n[simulation]\nbias_dph = 0.5\n")
    found = run(capsys, "--config", own)
    assert abs(found["tumble_scale_factor_counts_per_dps"] / 246.152866 - 1) < 5e-3
    assert abs(found["tumble_bias_dph"] - 0.5) < 4 * found["tumble_bias_u_dph"] < 0.1
    assert found["bias_sensitivity_dph_per_unit"] is None
    rng = np.random.default_rng(8)
    rows = [{"position": f"{sense}{axis}"} for axis in "xyz" for sense in "+-"]
    mean = 246.152866 * EARTH_DPS * np.array([0.6, -0.6, 0.0, 0.0, 0.8, -0.8])
    outputs = [one + 0.3 * (number == 1) + rng.normal(0, 0.05, 6000) for number, one in enumerate(mean)]
    found = run(capsys, logs(tmp_path, rows, outputs))
    assert any("three pairs of positions do not give one bias" in one for one in found["flags"])


@pytest.mark.parametrize(
    ("rows", "code", "said"),
    [
        ([{"stimulus": 1.0}] * 4, 4, "three means at two values of the stimulus"),
        ([{"rate_dps": 0.0}] * 3, 2, "list.csv, log 1: give the stimulus, or as position one of +x, -x"),
        ([{"position": "+x"}, {"position": "up"}], 2, "log 2: give the stimulus"),
        ([{"position": "+x"}, {"position": "-x"}], 4, "there is no output of +y, -y, +z, -z"),
    ],
)
def test_what_is_not_enough_is_said(rows, code, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    listed = logs(tmp_path, rows, [np.random.default_rng(1).normal(size=300)] * len(rows))
    assert main(["fog", "sensitivity", str(listed), "--no-report"]) == code
    assert said in capsys.readouterr().err


def test_values_that_are_all_the_same_are_no_plan(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    own = settings(tmp_path, "[sensitivity]\nvalues = [1.0, 1.0, 1.0]\n")
    assert main(["fog", "sensitivity", "--config", str(own)]) == 2
    assert "sensitivity.values: must differ" in capsys.readouterr().err
