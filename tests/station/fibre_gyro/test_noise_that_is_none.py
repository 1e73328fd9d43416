"""Outputs at rest whose noise is not that of the five terms: each is told, and one that is, is not."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from analysis.fibre_gyro import fit_noise
from station.errors import NoUsableSignal
from tests.station.fibre_gyro.test_logs_as_they_come import Logs

RATE, SECONDS, SIGMA = 100.0, 1200, 8e-4  # Hz, s, deg/s
SIZE = int(RATE * SECONDS)
TIME = np.arange(SIZE) / RATE

Noise = Callable[[np.random.Generator, np.ndarray], np.ndarray]

SLOW = pytest.mark.slow  # beside one of its kind


def said(folder: Path, noise: Noise, seed: int = 3, filter_hz: float = 0.0) -> str:
    """All that an evaluation says of an output at rest."""
    rng = np.random.default_rng(seed)
    words = noise(rng, SIGMA * rng.standard_normal(SIZE))
    logs = Logs(folder, "file")
    np.savetxt(
        folder / "rest.csv", np.column_stack([TIME, words]), "%.9g", ",", header="time,gyro (deg/s)", comments=""
    )
    logs.rows.append("rest.csv")
    try:
        found = logs.evaluate("allan", allan={"output_filter_hz": filter_hz})
    except NoUsableSignal as error:
        return str(error)
    return " ".join([*found["flags"], *(one["reason"] for one in found["left_out"])])


def low_pass(hertz: float) -> Noise:
    keep = np.exp(-2 * np.pi * hertz / RATE)
    return lambda rng, white: np.asarray(lfilter([1 - keep], [1, -keep], white))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_white_noise_says_nothing(tmp_path: Path, seed: int) -> None:
    assert not said(tmp_path, lambda rng, white: white, seed)


@pytest.mark.slow
def test_noise_of_all_slow_terms_says_nothing(tmp_path: Path) -> None:
    assert not said(tmp_path, lambda rng, white: white + 2e-6 * np.cumsum(rng.standard_normal(SIZE)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("noise", "named"),
    [
        (low_pass(30.0), "filtered"),
        pytest.param(low_pass(10.0), "filtered", marks=SLOW),
        (lambda rng, white: np.convolve(white, np.ones(10) / 10)[:SIZE], "filtered"),
        pytest.param(lambda rng, white: np.convolve(white, np.ones(2) / 2)[:SIZE], "filtered", marks=SLOW),
        pytest.param(lambda rng, white: np.asarray(lfilter(*butter(2, 0.4), white)), "filtered", marks=SLOW),
        (lambda rng, white: white + 0.5 * SIGMA * np.sin(20 * np.sin(TIME / 20) + 3 * TIME), "a line stands"),
        (lambda rng, white: white + 0.4 * SIGMA * np.sin(2 * np.pi * 13.3 * TIME) * (TIME < 700), "13.3"),
        (low_pass(0.01), "behind a filter of 0.0"),
        (lambda rng, white: white + np.where(abs(TIME - 300) < 10, 5 * white, 0), "not the same all the time"),
        (lambda rng, white: np.where(TIME < SECONDS / 2, white, 2e-3), "stands still"),
        (lambda rng, white: white + 3 * SIGMA * (TIME > 400), "not the same all the time"),
        (lambda rng, white: white + 1.0, "was turning"),
        (lambda rng, white: 4 * SIGMA * np.round(white / (4 * SIGMA) + 0.3), "more digits"),
    ],
    ids=[
        "30 Hz", "10 Hz", "mean of 10", "mean of 2", "second order", "line that wanders", "line that ends",
        "0.01 Hz", "touched", "stuck", "jump", "turning", "coarse",
    ],
)  # fmt: skip
def test_what_is_no_noise_of_the_model_is_named(tmp_path: Path, noise: Noise, named: str) -> None:
    assert named in said(tmp_path, noise)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("noise", "corner"),
    [
        pytest.param(low_pass(30.0), 30.0, marks=pytest.mark.slow),
        pytest.param(low_pass(5.0), 5.0, marks=SLOW),
        (lambda rng, white: np.convolve(white, np.ones(10) / 10)[:SIZE], 0.443 * RATE / 10),
        pytest.param(
            lambda rng, white: np.convolve(white, np.ones(2) / 2)[:SIZE], 0.443 * RATE / 2, marks=pytest.mark.slow
        ),
        (lambda rng, white: np.asarray(lfilter(*butter(2, 0.4), white)), 20.0),
    ],
    ids=["30 Hz", "5 Hz", "mean of 10", "mean of 2", "second order"],
)
def test_a_filter_that_is_stated_is_taken_out(noise: Noise, corner: float) -> None:
    """The white noise before the filter, whatever its form, with a hundredth of the words missing."""
    pulls = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        words = noise(rng, SIGMA * rng.standard_normal(SIZE))
        words[rng.random(SIZE) < 0.01] = np.nan
        fit = fit_noise(words, 1 / RATE, filter_hz=corner)
        walk, u = fit.coefficients["angle_random_walk"], fit.coefficients_u["angle_random_walk"]
        pulls.append((walk - SIGMA / np.sqrt(RATE)) / u)
        assert fit.low_95["angle_random_walk"] < walk < fit.high_95["angle_random_walk"]
        assert not (fit.bands or fit.lines_hz or np.isfinite([fit.loudness, fit.slow_loudness]).any())
    assert np.sqrt(np.mean(np.square(pulls))) < 1.6 and abs(np.mean(pulls)) < 0.8, pulls


@pytest.mark.slow
@pytest.mark.parametrize(
    ("true", "stated", "named"), [(3.0, 30.0, "the power of the model"), (30.0, 1e-3, "so slowly")]
)
def test_a_filter_that_is_stated_wrong_is_named(tmp_path: Path, true: float, stated: float, named: str) -> None:
    assert named in said(tmp_path, low_pass(true), filter_hz=stated)
