"""Closed normal equations against plain sums over the samples."""

import numpy as np
import pytest

from analysis.waveform.series import (
    UNIFORM_PHASES,
    Series,
    SeriesSums,
    data_sums,
    equations_by_samples,
    equations_of_sums,
    sampled_series,
    uniform_kernels,
)
from analysis.waveform.series_fit import HOPEFUL, Task, levenberg_marquardt, start_of_series


def direct_sums(values, omega, n_harmonics, highest_power):
    n = values.shape[1]
    m = np.arange(n) - (n - 1) / 2
    return np.array(
        [
            [
                [np.sum(v * (2 * m / n) ** p * np.exp(-1j * k * w * m)) for k in range(n_harmonics + 1)]
                for p in range(highest_power + 1)
            ]
            for v, w in zip(values, omega, strict=True)
        ]
    )


@pytest.mark.parametrize("n_samples", [2500, 1003, 64])
def test_sums_are_those_written_out(n_samples):
    rng = np.random.default_rng(60)
    values = rng.normal(size=(6, n_samples))
    omega = rng.uniform(0.01, 3.0, 6)
    expected = direct_sums(values, omega, 5, 2)
    np.testing.assert_allclose(data_sums(values, omega, 5, 2), expected, atol=1e-9 * n_samples)
    single = data_sums(values.astype(np.float32), omega, 5, 2)
    np.testing.assert_allclose(single, expected, atol=1e-6 * n_samples)
    several = data_sums(values, np.stack([omega, omega / 2], axis=-1), 5, 2)
    np.testing.assert_allclose(several[:, 0], expected, atol=1e-9 * n_samples)


@pytest.mark.parametrize("n_samples", [2500, 2501])
def test_kernels_are_sums_of_ones_also_where_harmonics_fold_onto_a_constant(n_samples):
    omega = np.array([0.00503, 0.4, 2 * np.pi / 5, 2 * np.pi / 6, 2 * np.pi / 5 + 1e-5, 2 * np.pi / 6 - 3e-6])
    expected = direct_sums(np.ones((omega.size, n_samples)), omega, 20, 2)
    found = uniform_kernels(omega, n_samples, 20) * UNIFORM_PHASES
    np.testing.assert_allclose(found, expected, atol=1e-7 * n_samples)


def a_record_and_a_trial(rng, n_records, n_samples):
    def phasor(size):
        return size * np.exp(1j * rng.uniform(-np.pi, np.pi, n_records))

    omega = np.exp(rng.uniform(np.log(2.6), np.log(550), n_records)) * 2 * np.pi / n_samples
    omega[:3] = 2 * np.pi / 5, 2 * np.pi / 6, 2 * np.pi / 5 + 1e-5
    truth = Series(rng.normal(size=n_records), phasor(60.0), phasor(rng.uniform(0.01, 0.8, n_records)), omega)
    values = sampled_series(truth, n_samples) + rng.normal(size=(n_records, n_samples))
    trial = Series(truth.offset + 0.1, truth.first * 1.01, truth.ratio * 0.99, omega + 0.01 / n_samples)
    return values, trial


@pytest.mark.parametrize("share_missing", [0.0, 0.2])
def test_normal_equations_in_closed_form_are_those_of_the_samples(share_missing):
    """From 2.6 periods on, and where five samples a period make the harmonics fold onto each other."""
    rng = np.random.default_rng(61)
    values, trial = a_record_and_a_trial(rng, 60, 2500)
    weights = None
    if share_missing:
        weights = (rng.uniform(size=values.shape) > share_missing).astype(float)
        values = values * weights
    power, total = np.sum(values**2, axis=-1), np.sum(values, axis=-1)
    sums = SeriesSums.of(values, weights, trial, float(np.abs(trial.ratio).max()))
    closed = equations_of_sums(trial, sums, power, total)
    plain = equations_by_samples(values, weights, trial)
    size = np.sqrt(np.diagonal(plain.normal, axis1=1, axis2=2))
    both = size[:, :, np.newaxis] * size[:, np.newaxis, :]
    np.testing.assert_allclose(closed.normal / both, plain.normal / both, atol=1e-7)
    np.testing.assert_allclose(closed.gradient / size, plain.gradient / size, atol=1e-5)
    np.testing.assert_allclose(closed.residual_power, plain.residual_power, rtol=1e-5)


def test_a_record_without_a_beat_is_not_searched_to_the_end(monkeypatch):
    """It took forty steps, and most of the time of such records."""
    asked, equations = [], Task.equations
    monkeypatch.setattr(Task, "equations", lambda self, series: asked.append(1) or equations(self, series))
    noise = np.random.default_rng(6).normal(size=(2, 1000)).astype(np.float32)
    levenberg_marquardt(Task.of(noise, None), start_of_series(noise, None))
    assert len(asked) <= HOPEFUL + 2
