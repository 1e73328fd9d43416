"""`gyrolock fog response`: bandwidth and delay by injected steps, by a sine of the table, over a serial line."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, lfilter, lfilter_zi

from analysis.fibre_gyro import StepTrain, step_response
from station.cli import main

FINE = 64  # parts of an output in which the truth is computed
K = 246.152866  # counts per deg/s of the shipped coil, docs/fibre_gyro.md
FORMS = {"first": "low-pass of first order", "second": "low-pass of second order", "mean": "sliding mean"}


def filtered(form: str, corner_hz: float, x: np.ndarray, step_s: float) -> np.ndarray:
    """A filter with its half power at some frequency, by other means than those of the product."""
    if form == "mean":
        width = round(0.44295 / corner_hz / step_s)
        total = np.cumsum(np.concatenate([np.full(width, x[0]), x]))
        return (total[width:] - total[:-width]) / width
    order = {"first": 1, "second": 2, "fifth": 5}[form]
    b, a = butter(order, 2 * corner_hz * step_s)
    return lfilter(b, a, x, zi=lfilter_zi(b, a) * x[0])[0]


def steps(
    form: str, corner_hz: float, delay_s: float, *, seed: int, half_s: float = 0.503, noise: float = 0.01,
    jitter_s: float = 0.0, exact: bool = True, count: int = 30, interval_s: float = 0.01,
) -> tuple[np.ndarray, StepTrain]:  # fmt: skip
    """Output words behind steps of 2, and the steps."""
    rng, fine = np.random.default_rng(seed), interval_s / FINE
    x = -np.ones(int((count + 1) * half_s / interval_s) * FINE)
    at = half_s * np.arange(1, count + 1)
    for number, time in enumerate(at):
        x[round((time + delay_s + jitter_s * rng.random()) / fine) :] = 1 - 2 * (number % 2)
    words = filtered(form, corner_hz, x, fine).reshape(-1, FINE).mean(axis=1)
    height = 2.0 * (-1.0) ** np.arange(count)
    return words + noise * rng.standard_normal(words.size), StepTrain(at, height, exact)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("corner", "delay"),
    [
        (9.0, 0.0),
        pytest.param(25.0, 0.017, marks=pytest.mark.slow),
        pytest.param(3.0, 0.004, marks=pytest.mark.slow),
    ],
)
def test_steps_give_form_bandwidth_and_delay(form: str, corner: float, delay: float) -> None:
    words, train = steps(form, corner, delay, seed=2)
    words[[40, 41, 300]] = np.nan
    found = step_response(words, 0.01, train)
    assert found.form.name == FORMS[form]
    assert abs(found.bandwidth_hz - corner) < 4 * found.bandwidth_u_hz + 2e-3 * corner < 0.1 * corner
    of_form = {"first": 1 / (2 * np.pi), "second": np.sqrt(2) / (2 * np.pi), "mean": 0.44295 / 2}[form] / corner
    assert abs(found.delay_s - delay - of_form) < 4 * found.delay_u_s + 2e-4
    assert abs(found.gain - 1) < 4 * found.gain_u
    assert not np.isfinite(found.misfit) and found.settled


@pytest.mark.slow
def test_commands_that_take_their_way_do_not_widen_the_step() -> None:
    words, train = steps("first", 8.0, 0.05, seed=3, jitter_s=0.03, exact=False)
    found = step_response(words, 0.01, train)
    assert abs(found.bandwidth_hz - 8.0) < 4 * found.bandwidth_u_hz < 1.0
    assert np.isnan(found.delay_s)
    assert 0.005 < found.jitter_s < 0.013  # 30 ms / sqrt(12)


@pytest.mark.slow
def test_another_filter_and_steps_too_fast_are_told() -> None:
    assert step_response(*with_interval("fifth", 10.0)).misfit > 1.5
    slow, train = steps("first", 1.0, 0.0, seed=1, half_s=0.3)
    assert not step_response(slow, 0.01, train).settled


@pytest.mark.slow
def test_a_step_that_did_not_come_is_told_and_noise_is_no_response() -> None:
    words, train = steps("first", 20.0, 0.0, seed=6)
    assert np.isnan(step_response(words, 0.01, train).odd_step_s)
    first, last = (int(at / 0.01) for at in train.at_s[7:9])
    words[first:last] = words[first - 20 : first].mean()
    assert step_response(words, 0.01, train).odd_step_s == train.at_s[7]
    with pytest.raises(ValueError, match="does not follow"):
        step_response(np.random.default_rng(1).normal(size=words.size), 0.01, train)
    with pytest.raises(ValueError, match="there are not 8 outputs"):
        step_response(words, 0.01, StepTrain(train.at_s / 20, train.height, exact=True))


@pytest.mark.slow
def test_many_words_to_a_step_are_no_reason_to_lose_steps() -> None:
    words, train = steps("first", 2.0, 0.0, seed=7, half_s=4.0, count=2, interval_s=0.0004)
    found = step_response(words, 0.0004, train)
    assert found.form.name == FORMS["first"]
    assert abs(found.bandwidth_hz - 2.0) < 4 * found.bandwidth_u_hz + 2e-3 < 0.1


def with_interval(form: str, corner: float) -> tuple[np.ndarray, float, StepTrain]:
    words, train = steps(form, corner, 0.0, seed=5)
    return words, 0.01, train


@pytest.mark.slow
def test_intervals_hold() -> None:
    """Of 10 draws with much noise; the form is told in nearly all."""
    off, named = [], 0
    for seed in range(10):
        words, train = steps("first", 6.0, 0.003, seed=seed, noise=0.1)
        found = step_response(words, 0.01, train)
        named += found.form.name == FORMS["first"]
        off.append([(found.bandwidth_hz - 6.0) / found.bandwidth_u_hz, (found.gain - 1) / found.gain_u])
    assert named >= 8
    inside = np.abs(off) < 1.96
    assert inside.mean(axis=0).min() > 0.7


def write(path: Path, header: str, *columns: np.ndarray) -> Path:
    np.savetxt(path, np.column_stack(columns), "%.10g", ",", header=header, comments="")
    return path


def respond(capsys: pytest.CaptureFixture[str], *arguments: object, code: int = 0) -> dict[str, object]:
    assert main(["fog", "response", *map(str, arguments), "--json", "--no-report"]) == code
    return json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_a_log_with_the_injected_step_beside_the_output(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    words, train = steps("first", 10.0, 0.0, seed=4, half_s=0.5)
    at = np.arange(words.size) * 0.01
    injected = -1000.0 + np.sum(
        [by * 1000 * (at >= when - 1e-9) for when, by in zip(train.at_s, train.height, strict=True)], axis=0
    )
    log = write(tmp_path / "steps.csv", "time,counts,injected", at, 1000 * words, injected)
    found = respond(capsys, log)
    assert found["form"] == FORMS["first"] and found["flags"] == []
    assert abs(found["bandwidth_hz"] - 10.0) < 4 * found["bandwidth_u_hz"] < 1.0
    assert found["points"][0]["magnitude"] > 0.99


@pytest.mark.parametrize("sense", [1, -1])
def test_a_table_that_swings(tmp_path, monkeypatch, capsys, sense: int) -> None:
    """Sines of six frequencies; the delay of 4 ms and that of the filter add up."""
    monkeypatch.chdir(tmp_path)
    rng, names, h, corner = np.random.default_rng(8), [], 0.005, 12.0
    ends = h * np.arange(1, 6001)
    for number, f in enumerate([0.5, 2.0, 5.0, 10.0, 20.0, 35.0]):
        angle = 3.0 / (2 * np.pi * f) * np.sin(2 * np.pi * f * ends)  # of a rate of 3 deg/s
        passed = np.exp(-2j * np.pi * f * 0.004) / (1 + 1j * f / corner)
        turned = (3.0 / (2 * np.pi * f) * passed * np.exp(2j * np.pi * f * np.concatenate([[0.0], ends]))).imag
        words = sense * K * np.diff(turned) / h + rng.normal(0, 1.0, ends.size)
        names.append(write(tmp_path / f"{number}.csv", "time,counts,table_deg", ends, words, angle + 90.0))
    found = respond(capsys, *names)
    assert found["form"] == FORMS["first"] and found["flags"] == []
    assert found["gain"] == pytest.approx(sense, abs=0.01)
    assert abs(found["bandwidth_hz"] - corner) < 4 * found["bandwidth_u_hz"] < 0.5
    assert abs(found["delay_s"] - 0.004 - 1 / (2 * np.pi * corner)) < 4 * found["delay_u_s"] < 1e-3
    assert [round(one["response_frequency_hz"], 3) for one in found["points"]] == [0.5, 2.0, 5.0, 10.0, 20.0, 35.0]
    assert respond(capsys, *names[:3], code=4)["error"]["message"].count("four frequencies")


@pytest.mark.slow
def test_the_simulated_gyro_with_a_filter_and_a_limit(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    own = tmp_path / "own.toml"
    own.write_text("[simulation]\noutput_filter_hz = 3.0\noutput_rate_hz = 50.0\n[limits]\ndelay_s = 0.05\n")
    found = respond(capsys, "--config", own, code=1)
    assert abs(found["bandwidth_hz"] - 3.0) < 2e-3
    assert abs(found["delay_s"] - 1 / (2 * np.pi * 3.0)) < 2e-4
    assert abs(found["gain"] - 1) < 1e-4


@pytest.mark.slow
def test_of_a_log_of_three_axes_the_one_that_is_named_is_used(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    words, train = steps("first", 10.0, 0.0, seed=4, half_s=0.5)
    at = np.arange(words.size) * 0.01
    injected = -1000.0 + sum(
        by * 1000 * (at >= when - 1e-9) for when, by in zip(train.at_s, train.height, strict=True)
    )
    noise = np.random.default_rng(1).normal(size=(2, words.size))
    columns = (at, noise[0], noise[1], 1000 * words, injected)
    log = write(tmp_path / "steps.csv", "time,counts_x,counts_y,counts_z,injected", *columns)
    assert respond(capsys, log)["form"] == FORMS["first"]
    own = tmp_path / "own.toml"
    own.write_text('[response]\naxis = "A"\n')
    assert "none of the axis A" in respond(capsys, log, "--config", own, code=4)["error"]["message"]


@pytest.mark.slow
def test_no_filter_is_a_lower_bound(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["fog", "response", "--no-report"]) == 0
    said = capsys.readouterr().out
    assert "Bandwidth above" in said and "No filter is seen" in said


def test_a_step_beyond_the_converter_and_one_too_short_are_told(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    own = tmp_path / "own.toml"
    own.write_text("[response]\nrate_dps = 5000.0\n")
    assert "beyond the 16-bit converter" in respond(capsys, "--config", own, code=4)["error"]["message"]
    own.write_text("[response]\nhalf_period_s = 0.2\n")
    said = respond(capsys, "--config", own, code=4)["error"]["message"]
    assert "there are not 8 outputs" in said and "sine" not in said


def test_what_holds_no_input_is_told(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    log = write(tmp_path / "rest.csv", "time,counts", np.arange(600) * 0.01, np.arange(600) % 7)
    said = respond(capsys, log, code=4)["error"]["message"]
    assert "neither a column injected nor a column table_deg" in said
    flat = write(
        tmp_path / "flat.csv", "time,counts,injected", np.arange(600) * 0.01, np.arange(600) % 7, np.zeros(600)
    )
    assert "two steps of the input are needed" in respond(capsys, flat, code=4)["error"]["message"]
