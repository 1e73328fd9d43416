"""`gyrolock fog range`: how far the output follows, what it does beyond, how it comes back from an overload."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from analysis.fibre_gyro import input_range, recovery
from station.cli import main

K = 246.152866  # counts per deg/s of the shipped coil, docs/fibre_gyro.md
FRINGE = 266.24  # deg/s of a whole fringe: lambda c/(L D)
RATES = np.array([10.0, 20.0, 40.0, 60.0, 80.0, 100.0, 120.0, 140.0])


def ladder(
    seen: Callable[[np.ndarray], np.ndarray], seed: int = 1, u: float = 0.3, tolerance_ppm: float = 1000.0
):  # fmt: skip
    """The range of a gyro that sees each rate so."""
    rng, rate = np.random.default_rng(seed), np.concatenate([RATES, -RATES])
    mean = K * seen(rate) + 25.0 + u * rng.standard_normal(rate.size)
    return input_range(rate, mean, np.full(rate.size, u), tolerance_ppm=tolerance_ppm, fringe_dps=FRINGE)


@pytest.mark.parametrize("ends", [(99.96, 119.92), (71.0, 81.0), (118.0, 65.0), (100.01, 100.02), (90.0, 75.0)])
def test_an_output_that_stands_still_gives_both_ends(ends: tuple[float, float]) -> None:
    seed, (low, high) = 3, ends  # the first two lie a little below a rate, which is followed yet
    found = ladder(lambda w: np.clip(w, -low, high), seed)
    for end, true in ((found.positive, high), (found.negative, low)):
        assert end.beyond == "stands still"
        assert abs(end.value_dps - true) < (end.high_95_dps - end.low_95_dps) < 0.02
    assert found.least.value_dps == min(found.positive.value_dps, found.negative.value_dps)


def test_what_bends_ends_between_two_rates() -> None:
    exact = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        strength, tolerance = rng.uniform(2e-7, 4e-6), rng.uniform(500, 4000)
        found = ladder(lambda w, s=strength: w * (1 - s * np.abs(w) ** 2), seed, tolerance_ppm=tolerance)
        # the most rates whose straight line leaves no more: both senses are alike
        off = []
        for count in range(2, RATES.size + 1):
            some = RATES[:count]
            k = np.sum(some**2 * (1 - strength * some**2)) / np.sum(some**2)
            off.append(1e6 * np.abs((1 - strength * some**2) / k - 1).max())
        true = max(np.flatnonzero(np.array(off) <= tolerance), default=0) + 2
        for end in (found.positive, found.negative):
            assert abs(np.searchsorted(RATES, end.value_dps) + 1 - true) <= 1
            exact += np.searchsorted(RATES, end.value_dps) + 1 == true
            assert end.beyond == ("" if end.value_dps == RATES[-1] else "bends")
            assert end.low_95_dps <= end.value_dps
            assert not end.high_95_dps <= end.value_dps
    assert exact >= 36  # of 40: one sense is tried before the other


def test_wraps_fringes_and_no_end_are_named() -> None:
    wrapped = ladder(lambda w: ((K * w + 2**14) % 2**15 - 2**14) / K)
    assert (wrapped.positive.beyond, wrapped.positive.detail, wrapped.positive.value_dps) == ("wraps", 15, 60.0)
    fringe = ladder(lambda w: w - FRINGE * (w > 130))
    assert (fringe.positive.beyond, fringe.positive.detail, fringe.positive.value_dps) == (
        "settles on another fringe", 1, 120.0,
    )  # fmt: skip
    assert fringe.negative.beyond == ""
    assert np.isnan(fringe.negative.high_95_dps)
    with pytest.raises(ValueError, match="lie on no line"):
        ladder(lambda w: w + np.abs(w))
    with pytest.raises(ValueError, match="two rates and more in each sense"):
        input_range([1.0, 2.0, -1.0], [1.0, 2.0, -1.0], [0.1] * 3, tolerance_ppm=1, fringe_dps=FRINGE)


FINE = 50


def overload(
    tail: Callable[[np.ndarray], np.ndarray], *, interval_s: float = 0.05, noise_dps: float = 1e-3, seed: int = 1
) -> tuple[np.ndarray, np.ndarray, float]:
    """Rate and error of each output, and when the rate is back at 100: rest, 200 deg/s, a stop in 2 s, rest."""
    t = np.arange(0, 90, interval_s / FINE) + interval_s / FINE / 2
    rate = np.interp(t, [10, 12, 20, 22], [0, 200, 200, 0])
    back = 21.0  # 100 deg/s
    beyond = (t > 11) & (t < back)
    error = np.where(beyond, np.minimum(100 - rate, 0), 1e-3 * rate)  # it lags as the table speeds up
    error = np.where(t >= back, tail(t - back), error)
    rng = np.random.default_rng(seed)
    rate, error = (one.reshape(-1, FINE).mean(axis=1) for one in (rate, error))
    return rate, error + noise_dps * rng.standard_normal(rate.size), back


def test_the_recovery_holds_what_was_drawn() -> None:
    for seed in range(40):
        rng = np.random.default_rng(seed)
        size, time, noise = rng.uniform(1, 80), rng.uniform(0.05, 6), 10 ** rng.uniform(-4, -1.3)
        rate, error, _ = overload(lambda t, a=size, b=time: a * np.exp(-t / b), noise_dps=noise, seed=seed)
        found = recovery(rate, K * (rate + error) + 7, 0.05, (K, 7.0), 100.0, 0.1)
        true = time * np.log(size / 0.1)
        assert found.low_95_s <= true <= found.high_95_s, seed
        assert found.low_95_s <= found.recovery_s <= found.high_95_s
        assert found.high_95_s - found.low_95_s < 0.2 + 3 * (8 * noise / 0.1) ** 2 * 0.05 + 2 * time


def test_what_does_not_come_back_or_changes_is_told() -> None:
    rate, error, _ = overload(lambda t: -FRINGE + 0 * t)
    never = recovery(rate, K * (rate + error), 0.05, (K, 0.0), 100.0, 0.1)
    assert np.isnan(never.high_95_s)
    assert abs(never.left_dps + FRINGE) < 0.01
    rate, error, _ = overload(lambda t: 0.01 + 0 * t)
    moved = recovery(rate, K * (rate + error), 0.05, (K, 0.0), 100.0, 0.1)
    assert abs(moved.bias_change_dps - 0.01) < 4 * moved.bias_change_u_dps < 0.002
    for limit, message in ((250.0, "no overload"), (1e-4, "ends before")):
        with pytest.raises(ValueError, match=message):
            recovery(rate[:430], K * rate[:430], 0.05, (K, 0.0), limit, 0.1)


def write_logs(folder: Path, largest: float, tail: Callable[[np.ndarray], np.ndarray]) -> Path:
    """A list of logs of a gyro that follows so far, and of an overload."""
    rng, lines = np.random.default_rng(3), ["file,rate_dps,overload_dps"]
    for rate in np.concatenate([RATES, -RATES]):
        t = np.arange(0, 40, 0.05)
        words = K * np.clip(rate + 1e-3 * rng.standard_normal(t.size), -largest, largest)
        np.savetxt(folder / f"{rate:g}.csv", np.c_[t, words], "%.8g", ",", header="time,counts", comments="")
        lines.append(f"{rate:g}.csv,{rate:g},")
    rate, error, _ = overload(tail)
    turned = 0.05 * np.cumsum(rate) % 360
    log = np.c_[0.05 * np.arange(rate.size), K * (rate + error), turned]
    np.savetxt(folder / "o.csv", log, "%.8g", ",", header="time,counts,table_deg", comments="")
    (folder / "list.csv").write_text("\n".join([*lines, "o.csv,,200"]) + "\n", encoding="utf-8")
    return folder / "list.csv"


def taken(capsys: pytest.CaptureFixture[str], *arguments: object, code: int = 0) -> dict[str, object]:
    assert main(["fog", "range", *map(str, arguments), "--json", "--no-report"]) == code
    return json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_logs_with_an_overload(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    listed = write_logs(tmp_path, 97.0, lambda t: 5 * np.exp(-t / 2.0))
    found = taken(capsys, listed)
    assert abs(found["input_range_dps"] - 97) < 0.01
    assert found["beyond"] == {"positive": "stands still", "negative": "stands still"}
    assert found["recovery_low_95_s"] < 2 * np.log(5 / 0.097) < found["recovery_high_95_s"]
    assert found["standing"] == "stands", found["standing_reasons"]
    back = taken(capsys, write_logs(tmp_path, 97.0, lambda t: FRINGE + 0 * t))
    assert back["standing"] == "doubtful"
    assert "a fringe" in " ".join(back["flags"])
    moved = taken(capsys, write_logs(tmp_path, 97.0, lambda t: 0.02 + 0 * t))
    assert "behind it the bias is another one" in " ".join(moved["flags"])
    assert abs(moved["bias_change_by_overload_dph"] - 72) < 5 * moved["bias_change_by_overload_u_dph"] < 10


def test_limits_are_the_least_that_may_be(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    listed = write_logs(tmp_path, 97.0, lambda t: 0 * t)
    settings = tmp_path / "own.toml"
    for least, code, verdict in ((96.0, 0, "PASS"), (97.0003, 6, "MARGINAL"), (98.0, 1, "FAIL")):
        settings.write_text(f"[limits]\ninput_range_dps = {least}\nrecovery_s = 1.0\n", encoding="utf-8")
        found = taken(capsys, listed, "--config", settings, code=code)
        assert found["verdict"] == verdict
        assert [one["limit"] for one in found["limits"]] == [least, 1.0]


@pytest.mark.slow
def test_bad_lists_and_the_axis(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    listed = write_logs(tmp_path, 97.0, lambda t: 0 * t)
    text = listed.read_text(encoding="utf-8")
    for wrong, code, message in (
        (text.replace("10.csv,10,", "10.csv,,"), 2, "give the rate that is not 0"),
        (text.replace("o.csv,,200", "20.csv,,200"), 0, "needs the angle of the table"),
        ("\n".join(line for line in text.splitlines() if ",-" not in line), 4, "in each sense"),
        (text.replace("60.csv,60,", "40.csv,60,"), 0, "At +60 deg/s the output is off the line"),
    ):
        listed.write_text(wrong, encoding="utf-8")
        found = taken(capsys, listed, code=code)
        assert message in json.dumps(found)
    axes = "\n".join(f"{line},{'axis' if 'file' in line else 'Q'}" for line in text.splitlines())
    listed.write_text(axes, encoding="utf-8")
    assert "name it as range.axis" in json.dumps(taken(capsys, listed, code=4))


def test_the_simulated_bench(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    own = tmp_path / "own.toml"
    own.write_text("[simulation]\nlargest_rate_dps = 90\nrecovery_time_s = 1.0\n", encoding="utf-8")
    found = taken(capsys, "--config", own)
    assert abs(found["input_range_dps"] - 90) < 0.005
    assert (
        5 < found["recovery_s"] < 8
    )  # the last of what the table's stop of 0.9 s leaves dies away in ln(90/0.09)
    assert found["standing"] == "stands", found["standing_reasons"]
