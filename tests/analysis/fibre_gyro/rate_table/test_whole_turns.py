"""Whole-turn windows, against hand arithmetic and a simulated misaligned gyro."""

import numpy as np
import pytest

from analysis.fibre_gyro import check_whole_turns, mean_at_rest, mean_over_turns, turn_time, whole_turns_in


@pytest.mark.parametrize(
    ("rate", "window"), [(20.0, 540.0), (20.01, 539.7301), (20.1, 537.3134), (-21.0, 514.2857)]
)
def test_thirty_turns_take_a_time_of_their_own_at_each_rate(rate: float, window: float) -> None:
    assert 30 * turn_time(rate) == pytest.approx(window, abs=1e-4)
    assert check_whole_turns(window, rate, tolerance_s=0.01) == 30
    assert whole_turns_in(540.0, 20.0) == 30


@pytest.mark.parametrize("rate", [20.01, 20.1, 21.0])
def test_a_fixed_window_is_refused_with_the_windows_that_would_do(rate: float) -> None:
    with pytest.raises(ValueError, match="not a whole number") as caught:
        check_whole_turns(540.0, rate, tolerance_s=0.01)
    below = int(540 / (360 / rate))
    assert f"{below} turns = {below * 360 / rate:.3f} s" in str(caught.value)
    assert f"{below + 1} turns = {(below + 1) * 360 / rate:.3f} s" in str(caught.value)


def test_less_than_a_turn_and_no_turning() -> None:
    with pytest.raises(ValueError, match="at least 18 s"):
        whole_turns_in(17.0, 20.0)
    with pytest.raises(ValueError, match="1 turns = 18"):
        check_whole_turns(10.0, 20.0, tolerance_s=0.01)
    with pytest.raises(ValueError, match="no turns"):
        turn_time(0.0)
    with pytest.raises(ValueError, match="record longer"):
        mean_over_turns(np.zeros(100), 0.1, 20.0, turns=1)


def earth_on_axis(rate: float, duration: float, interval: float, phase: float) -> np.ndarray:
    """Horizontal earth rate in deg/h on a gyro that lies on the table, sample by sample (mean over the sample)."""
    edges = np.arange(round(duration / interval) + 1) * interval
    angle = np.deg2rad(rate * edges) + phase
    return 15.041067 * np.cos(np.deg2rad(45.78)) * np.diff(np.sin(angle)) / np.deg2rad(rate) / interval


@pytest.mark.parametrize("rate", [20.0, 20.01, 20.1, 21.0])
def test_whole_turns_lose_the_horizontal_earth_rate_and_540_s_does_not(rate: float) -> None:
    interval = 0.01
    phases = np.linspace(0, 2 * np.pi, 25)
    fixed = [abs(earth_on_axis(rate, 540.0, interval, p).mean()) for p in phases]
    # the mean of a cosine over so many turns
    leak = 15.041067 * np.cos(np.deg2rad(45.78)) * abs(np.sinc(540.0 * rate / 360))
    assert max(fixed) == pytest.approx(leak, rel=0.01, abs=1e-6)
    for phase in phases[::6]:
        turns = 30 if rate < 21 else 31
        window = mean_over_turns(earth_on_axis(rate, 540.0, interval, phase), interval, rate, turns=turns)
        # the last sample is cut in proportion, although the sine bends within it: (10 ms)^2/8 of its slope
        assert abs(window.mean) < 1e-7
        assert window.duration_s == pytest.approx(turns * 360 / rate, abs=1e-6)


def test_a_window_ends_within_a_sample() -> None:
    words = np.arange(540.0)
    window = mean_over_turns(words, 1.0, 20.01, turns=30)
    assert window.total == pytest.approx(sum(range(539)) + (10800 / 20.01 - 539) * 539)
    assert window.mean == pytest.approx(window.total / (10800 / 20.01))
    # a record that ends less than one sample early is taken as it is
    assert mean_over_turns(words[:539], 1.0, 20.01, turns=30).duration_s == 539.0
    with pytest.raises(ValueError, match="record longer"):
        mean_over_turns(words[:538], 1.0, 20.01, turns=30)


def test_the_uncertainty_is_the_scatter_of_the_means() -> None:
    rng = np.random.default_rng(4)
    earth = earth_on_axis(20.0, 180.0, 0.1, 0.3)
    windows = [mean_over_turns(50 + earth + rng.normal(0, 2, earth.size), 0.1, 20.0, turns=10) for _ in range(300)]
    means, u = (np.array([getattr(w, name) for w in windows]) for name in ("mean", "mean_u"))
    assert np.std(means) == pytest.approx(2 / np.sqrt(1800), rel=0.15)
    assert np.sqrt(np.mean(u**2)) == pytest.approx(2 / np.sqrt(1800), rel=0.1)
    assert windows[0].total == pytest.approx(windows[0].mean * 1800)


def test_slow_noise_counts_in_the_uncertainty_at_rest() -> None:
    rng = np.random.default_rng(5)
    white = mean_at_rest(rng.normal(0, 1, 4000), 0.01)
    assert white.mean_u == pytest.approx(1 / np.sqrt(4000), rel=0.4)
    wander = mean_at_rest(np.repeat(rng.normal(0, 1, 40), 100), 0.01)
    assert wander.mean_u == pytest.approx(1 / np.sqrt(40), rel=0.4)


def test_a_word_that_does_not_move_is_as_uncertain_as_its_step() -> None:
    assert mean_at_rest(np.full(1000, 7.0), 0.01, resolution=1.0).mean_u == pytest.approx(1 / np.sqrt(12))
    with pytest.raises(ValueError, match="1 of 3 output words are missing"):
        mean_at_rest([1.0, np.nan, 2.0], 0.01)
    with pytest.raises(ValueError, match="at least 2 samples"):
        mean_at_rest([1.0], 0.01)
