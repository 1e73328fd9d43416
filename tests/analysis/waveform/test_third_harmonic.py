"""A third harmonic that the waveform does not have: the fit goes to the end of its least squares beside it."""

import numpy as np
import pytest
import scipy.optimize

from analysis import estimate_lock_in


def nearest_waveform(record, start):
    """Least squares of all samples for offset, fundamental, ratio and frequency, by another iteration."""
    times = np.arange(record.size) - (record.size - 1) / 2

    def left(parameters):
        circle = np.exp(1j * parameters[5] * times)
        first, ratio = complex(*parameters[1:3]), complex(*parameters[3:5])
        return parameters[0] + (first * circle / (1 - ratio * circle)).real - record

    found = scipy.optimize.least_squares(left, start, x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    return complex(*found[3:5]) * np.exp(-1j * np.angle(complex(*found[1:3])))


@pytest.mark.slow
@pytest.mark.parametrize("third", [0.003, 0.01, -0.02])
@pytest.mark.parametrize("ratio", [0.02, 0.06, 0.17, 0.4])
def test_the_ratio_beside_a_third_harmonic_is_that_of_least_squares(ratio, third):
    rng = np.random.default_rng([int(1000 * ratio), int(1000 * third + 50)])
    count, samples, noise = 12, 2500, 0.01
    omega = 2 * np.pi * rng.uniform(5, 80, count) / samples
    turns = rng.uniform(0, 2 * np.pi, (2, count))
    times = np.arange(samples) - (samples - 1) / 2
    circle = np.exp(1j * (omega[:, np.newaxis] * times + turns[0][:, np.newaxis]))
    own = ratio * np.exp(1j * turns[1])[:, np.newaxis]
    clean = (circle / (1 - own * circle) + third * circle**3).real
    volts = clean + noise * rng.normal(size=clean.shape)
    found = estimate_lock_in(volts, 2e-5, scale_factor=2000.0)
    turned = own[:, 0] * np.exp(1j * turns[0])
    starts = np.stack([0 * omega, np.cos(turns[0]), np.sin(turns[0]), turned.real, turned.imag, omega], axis=-1)
    exact = np.array([nearest_waveform(*each) for each in zip(volts, starts, strict=True)])
    u = noise * np.sqrt(2 / samples)
    assert np.abs(np.abs(found.complex_ratio) - np.abs(exact)).max() < 0.03 * u
    assert np.abs(found.complex_ratio - exact).max() < 0.06 * u


@pytest.mark.slow
def test_a_record_beside_a_third_harmonic_does_not_depend_on_the_others():
    rng = np.random.default_rng(3)
    times, records = np.arange(2500), []
    for number in range(21):
        circle = np.exp(1j * (2 * np.pi * rng.uniform(8, 40) / 2500 * times + rng.uniform(0, 6)))
        own = 0.17 * np.exp(1j * rng.uniform(0, 6))
        volts = (circle / (1 - own * circle) + 0.01 * circle**3).real + 0.01 * rng.normal(size=2500)
        volts = np.round(100 * np.clip(volts, -0.85, 0.85) if number % 3 == 0 else 100 * volts) / 100
        volts[100 : 150 if number % 7 == 1 else 100] = np.nan
        records.append(volts)
    asked = {"scale_factor": 2000.0, "nan_policy": "omit"}
    together = estimate_lock_in(np.array(records), 2e-5, **asked)
    alone = [estimate_lock_in(volts, 2e-5, **asked).complex_ratio for volts in records]
    np.testing.assert_array_equal(together.complex_ratio, alone)
