"""Logs of more rows than are held: means of two, of four, .. rows, as a slower gyro would have sent them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from analysis.fibre_gyro import fit_noise
from instrument import FileFormatError
from instrument.fibre_gyro import logs as module, read_log

HERTZ, ROWS = 1000.0, 150_000


@pytest.fixture(autouse=True)
def short_of_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if 20 000 rows were many."""
    monkeypatch.setattr(module, "MOST_ROWS", 20_000)


def written(path: Path, header: str, rows: Sequence[str]) -> Path:
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def noise(seed: int = 1) -> np.ndarray:
    return 5.0 + 0.1 * np.random.default_rng(seed).standard_normal(ROWS)


@pytest.mark.slow
def test_rows_become_means_of_rows(tmp_path: Path) -> None:
    words = noise()
    rows = [
        f"{place / HERTZ:.3f},{word!r},{20 + place / ROWS:.6f}" for place, word in enumerate(map(float, words))
    ]
    log = read_log(written(tmp_path / "log.csv", "time,counts,temperature", rows))
    assert log.each == 8  # 18 750 of them
    size = log.rest.counts.size
    assert 0 <= ROWS // 8 - size <= 1
    means = words[: 8 * size].reshape(-1, 8).mean(axis=1)
    assert np.allclose(log.outputs["counts"], means, rtol=1e-12)
    assert log.rest.interval_s == pytest.approx(8 / HERTZ, rel=1e-9)
    assert not log.rest.gaps and log.rest.losses.missing == 0
    assert log.rest.temperature is not None
    assert log.rest.temperature[0] == pytest.approx(20 + 3.5 / ROWS, abs=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize("stamp", ["fine", "of 10 ms", "counter"])
def test_missing_rows_move_neither_the_clock_nor_the_noise(tmp_path: Path, stamp: str) -> None:
    rng = np.random.default_rng(3)
    kept = rng.random(ROWS) >= (0.0 if stamp == "of 10 ms" else 0.01)
    kept[[0, -1]] = True
    pauses = [] if stamp == "of 10 ms" else [5]
    if pauses:
        kept[70_000:75_000] = False
    places, words = np.flatnonzero(kept), noise(2)
    counted, step = stamp == "counter", 10 if stamp == "of 10 ms" else 1
    stamps = [str(place % 65_536) if counted else f"{place // step * step / HERTZ:.4f}" for place in places]
    rows = [f"{at},{word!r}" for at, word in zip(stamps, map(float, words[kept]), strict=True)]
    file = written(tmp_path / "log.csv", f"{'counter' if counted else 'time'},counts", rows)
    choices = module.LogChoices(interval_s=1 / HERTZ) if counted else None
    log = read_log(file, choices)
    interval = log.rest.interval_s
    assert interval == pytest.approx(log.each / HERTZ, rel=2e-6)
    assert [round(gap.missing * interval) for gap in log.rest.gaps] == pauses
    outside = np.count_nonzero(~kept) - 5000 * len(pauses)
    assert log.rest.losses.missing == pytest.approx(outside, abs=0.01 * outside + 700)
    whole = np.full(round(float(log.rest.times[-1]) / interval) + 1, np.nan)
    whole[np.round(log.rest.times / interval).astype(int)] = log.outputs["counts"]
    fit = fit_noise(whole, interval)
    white = fit.coefficients["angle_random_walk"]
    assert abs(white - 0.1 / HERTZ**0.5) < 3 * fit.coefficients_u["angle_random_walk"]


def test_an_angle_of_each_row_is_one_of_a_row(tmp_path: Path) -> None:
    rows = [f"{place / HERTZ:.3f},{0.02 / HERTZ!r}" for place in range(50_000)]
    log = read_log(written(tmp_path / "log.csv", "time,dtheta [deg]", rows))
    assert log.each > 1
    assert np.allclose(log.recording(counts_per_dps=1000.0).counts, 20.0)


@pytest.mark.slow
def test_a_clock_over_midnight_goes_on(tmp_path: Path) -> None:
    seconds = 86_390.0 + np.arange(40_000) / HERTZ
    clock = [f"{int(at // 3600) % 24:02d}:{int(at // 60) % 60:02d}:{at % 60:06.3f}" for at in seconds]
    rows = [f"{at},{word!r}" for at, word in zip(clock, map(float, noise()[:40_000]), strict=True)]
    log = read_log(written(tmp_path / "log.csv", "time,counts", rows))
    assert log.each > 1 and not log.rest.gaps
    assert log.rest.duration_s == pytest.approx(40.0, abs=0.05)


def test_time_that_goes_back_is_told_by_its_line(tmp_path: Path) -> None:
    rows = [f"{place / HERTZ:.3f},{place % 7}" for place in range(30_000)]
    rows[15_000] = "1.0,3"
    with pytest.raises(FileFormatError, match=r"line 15002: the time goes back"):
        read_log(written(tmp_path / "log.csv", "time,counts", rows))


def test_a_log_mostly_of_pauses_is_refused(tmp_path: Path) -> None:
    rows = [f"{place / HERTZ + 500.0 * (place > 9000):.3f},{place % 7}" for place in range(30_000)]
    with pytest.raises(FileFormatError, match="line 9003"):
        read_log(written(tmp_path / "log.csv", "time,counts", rows))
