"""Scatter between runs, missing words and outliers, the direction of input axes, the static output."""

import numpy as np
import pytest

from analysis.fibre_gyro import (
    drift_in_slope,
    few_values_factor,
    find_run_scatter,
    fit_axis,
    fit_three_axes,
    input_axis_tilt,
    mean_at_rest,
    mean_over_turns,
    odd_even_parts,
    rate_differences,
    static_level,
    table_runs,
)

RATES = np.array([20.0, 20.01, 20.1, 21.0])
BOTH = np.concatenate([RATES, -RATES])
K = 250.0


@pytest.mark.slow
@pytest.mark.parametrize("beyond", [0.0, 20.0])
def test_intervals_hold_whatever_the_scatter_between_the_runs(beyond: float) -> None:
    """300 trials: 92 to 98 % would be missed by chance once in 30; these bounds less than once in a million."""
    rng = np.random.default_rng(4)
    held = []
    for _ in range(300):
        mean = K * BOTH + 3 + 1e-3 * np.hypot(1, beyond) * rng.normal(size=8)
        runs = table_runs(BOTH, mean, 1e-3)
        fit = fit_axis(runs)
        made = rate_differences(odd_even_parts(runs), irreproducibility_ppm=None, runs=runs)
        held.append(
            [
                abs(fit.scale_factor - K) < 1.96 * fit.scale_factor_u,
                *(np.abs(made.number - K * made.delta_dps) < 1.96 * made.number_u),
            ]
        )
    assert np.all(np.mean(held, axis=0) > 0.89)
    # no wider than Student's t of five degrees of freedom asks for
    assert np.mean(made.number_u) < 2.5 * 1e-3 * np.hypot(1, beyond)


def test_runs_that_cannot_show_their_scatter_have_a_bound() -> None:
    fit = fit_axis(table_runs([20.0, -20.0], [20 * K, -20 * K], 1e-4))
    assert fit.scatter_assumed
    assert 1e6 * fit.scale_factor_u / K == pytest.approx(10 / np.sqrt(2), rel=1e-3)
    known = fit_axis(table_runs([20.0, -20.0], [20 * K, -20 * K], 1e-4), irreproducibility_ppm=2.0)
    assert 1e6 * known.scale_factor_u / K == pytest.approx(2 / np.sqrt(2), rel=1e-3)
    many = find_run_scatter(np.ones((400, 1)), np.random.default_rng(1).normal(5, 2, 400), np.full(400, 1.0), 0.0)
    assert many.standard_u(np.full(400, 1 / 400)) == pytest.approx(2 / 20, rel=0.15)
    assert few_values_factor(1) == pytest.approx(12.706 / 1.96, rel=1e-3)


def turning(rate: float, count: int, rng: np.random.Generator, sine: float = 30.0) -> np.ndarray:
    return (
        1000.0 + sine * np.cos(np.deg2rad(rate) * 0.1 * (np.arange(count) + 0.5) + 1) + rng.normal(0, 0.1, count)
    )


def test_missing_words_leave_neither_the_sine_nor_a_gap_in_the_mean() -> None:
    rng = np.random.default_rng(2)
    words = turning(20.0, 1800, rng)
    whole = mean_over_turns(words, 0.1, 20.0, turns=10)
    words[100:160] = np.nan
    words[700] = np.nan
    window = mean_over_turns(words, 0.1, 20.0, turns=10)
    assert abs(window.mean - whole.mean) < 6 * 0.1 / np.sqrt(1800)
    assert abs(float(np.nanmean(words)) - whole.mean) > 0.5  # what a plain mean would be off
    assert (window.missing, window.outliers) == (61, 0)
    with pytest.raises(ValueError, match="output words are missing"):
        mean_over_turns(np.where(np.arange(1800) % 3, words, np.nan), 0.1, 20.0, turns=10)
    assert abs(window.sine) == pytest.approx(30.0, abs=0.1)


def test_a_spike_is_left_out_and_pulses_that_belong_to_the_gyro_are_not() -> None:
    rng = np.random.default_rng(3)
    words = rng.normal(0, 1, 5000)
    clean = mean_at_rest(words, 0.1)
    words[777] += 1e6
    window = mean_at_rest(words, 0.1)
    assert window.outliers == 1 and window.worst == pytest.approx(1e6, rel=1e-3)
    assert abs(window.mean - clean.mean) < 1e-3
    pulses = rng.normal(0, 1, 5000) + 100.0 * (np.arange(5000) % 50 == 0)
    assert mean_at_rest(pulses, 0.1).outliers == 0
    assert mean_at_rest(pulses, 0.1).mean == pytest.approx(2.0, abs=0.1)
    stuck = np.zeros(5000)
    stuck[::700] = 1.0
    assert mean_at_rest(stuck, 0.1, resolution=1.0).outliers == 0


def test_below_eight_turns_slow_noise_counts_too() -> None:
    rng = np.random.default_rng(4)
    found = []
    for _ in range(200):
        noise = np.convolve(rng.normal(0, 1, 739), np.full(20, 1 / 20), "valid")
        found.append(mean_over_turns(noise, 0.1, 20.0, turns=4))
    means, u = (np.array([getattr(one, name) for one in found]) for name in ("mean", "mean_u"))
    assert np.sqrt(np.mean(u**2)) == pytest.approx(np.std(means), rel=0.25)


def test_three_axes_give_their_matrix() -> None:
    rng = np.random.default_rng(5)
    matrix = K * (np.eye(3) + rng.normal(0, 2e-3, (3, 3)))
    vertical, bias = 0.003, np.array([0.1, -0.2, 0.3])
    turned = [axis for axis in "XYZ" for _ in BOTH]
    rates = np.tile(BOTH, 3)
    body = (rates + vertical)[:, np.newaxis] * np.repeat(np.eye(3), BOTH.size, axis=0)
    means = body @ matrix.T + bias + rng.normal(0, 1e-3, (24, 3))
    found = fit_three_axes("XYZ", turned, rates, means, np.full((24, 3), 1e-3), vertical_earth_rate_dps=vertical)
    assert np.all(np.abs(found.matrix - matrix) < 6 * found.matrix_u)
    assert np.all(found.matrix_u < 1e-3)
    assert np.all(np.abs(found.bias - bias) < 6 * found.bias_u)
    truth = 1e3 * matrix / np.diag(matrix)[:, np.newaxis]
    assert found.misalignment_mrad[0, 2] == pytest.approx(truth[0, 2], abs=6 * found.misalignment_u_mrad[0, 2])
    assert np.all(found.scale_factor == pytest.approx(np.linalg.norm(matrix, axis=1), abs=1e-3))
    with pytest.raises(ValueError, match="axis X was turned in one sense only"):
        fit_three_axes("XYZ", ["X", "X"], [20.0, 21.0], np.ones((2, 3)), np.ones((2, 3)))


def test_the_tilt_of_an_input_axis_holds_with_its_interval() -> None:
    rng = np.random.default_rng(6)
    held, hidden = [], []
    for tilt in (2e-3, 0.0):
        for _ in range(300):
            noise = 0.02 * (rng.normal(size=8) + 1j * rng.normal(size=8))
            sines = 10.0 * np.sin(tilt) * np.exp(1j * rng.uniform(0, 2 * np.pi, 8)) + noise
            found = input_axis_tilt(sines, np.full(8, 0.02), 10.0)
            (held if tilt else hidden).append(found.low_95_mrad <= 1e3 * tilt <= found.high_95_mrad)
            assert found.high_95_mrad > 1  # however little chance made the sines: noise of 2 mrad hides some tilt
    assert 0.89 < np.mean(held) < 0.99
    assert np.mean(hidden) > 0.92
    with pytest.raises(ValueError, match="pole"):
        input_axis_tilt([0j], [1.0], 0.0)


def test_the_static_output_is_a_mean_until_it_drifts() -> None:
    quiet = static_level([1.0, 2.0], [0.0, 3.0], [10.0, 10.1], [0.1, 0.1])
    assert quiet.level.tolist() == [10.05, 10.05] and not quiet.modelled
    # what a drift that does not show may be still counts
    assert quiet.unseen_slope_u == pytest.approx(np.hypot(0.1, 0.1 * np.sqrt(2)) / 3)
    drifting = static_level([1.0, 2.0], [0.0, 3.0], [10.0, 13.0], [0.1, 0.1])
    assert drifting.level.tolist() == [11.0, 12.0] and drifting.modelled
    third = static_level([1.0, 3.0], [0.0, 2.0, 4.0], [0.0, 2.0, 0.0], [0.1] * 3)
    assert third.level.tolist() == [1.0, 1.0]
    assert drift_in_slope([1.0, -1.0, 2.0, -2.0], np.ones(4), np.arange(4.0)) == pytest.approx(-0.3)
