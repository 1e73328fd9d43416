import numpy as np
import pytest
from scipy.optimize import curve_fit

from analysis import fit_harmonics


def synthetic(rng, frequency, amplitudes, n=500, interval=0.01, noise=0.0, offset=1.5):
    times = np.arange(n) * interval
    volts = np.full(n, offset)
    for order, c in enumerate(amplitudes, start=1):
        volts = volts + np.real(c * np.exp(2j * np.pi * order * frequency * times))
    return volts + rng.normal(scale=noise, size=n)


@pytest.mark.parametrize("periods", [1.3, 2.5, 7.77, 60.2, 149.6])
def test_noise_free_harmonics_are_recovered(periods):
    rng = np.random.default_rng(1)
    frequency = periods / 5.0
    truth = np.array([2.0 * np.exp(0.7j), 0.3 * np.exp(-2j), 0.05j])
    fit = fit_harmonics(synthetic(rng, frequency, truth), 0.01)
    assert float(fit.frequency) == pytest.approx(frequency, rel=1e-9)
    np.testing.assert_allclose(fit.amplitudes, truth, atol=1e-8)
    assert float(fit.offset) == pytest.approx(1.5, abs=1e-8)


def test_a_stack_gives_what_each_record_gives_alone():
    rng = np.random.default_rng(2)
    stack = np.array([synthetic(rng, f, [1, 0.1, 0.01], noise=0.05) for f in (1.1, 3.0, 12.3, 8.8)])
    together = fit_harmonics(stack.reshape(2, 2, -1), 0.01)
    assert together.frequency.shape == (2, 2)
    assert together.amplitudes.shape == (2, 2, 3)
    alone = [float(fit_harmonics(row, 0.01).frequency) for row in stack]
    np.testing.assert_allclose(together.frequency.ravel(), alone, rtol=1e-9)


def test_values_and_uncertainties_agree_with_a_general_optimiser():
    rng = np.random.default_rng(3)
    volts = synthetic(rng, 0.87, [1.0, 0.2j], noise=0.1)
    times = np.arange(500) * 0.01

    def model(t, offset, a1, b1, a2, b2, f):
        turn = 2 * np.pi * f * t
        return offset + a1 * np.cos(turn) - b1 * np.sin(turn) + a2 * np.cos(2 * turn) - b2 * np.sin(2 * turn)

    values, covariance = curve_fit(model, times, volts, p0=[1.5, 1, 0, 0, 0.2, 0.87])
    fit = fit_harmonics(volts, 0.01, harmonics=2)
    assert float(fit.frequency) == pytest.approx(values[5], rel=1e-6)
    assert float(fit.frequency_u) == pytest.approx(np.sqrt(covariance[5, 5]), rel=1e-3)
    assert complex(fit.amplitudes[1]) == pytest.approx(values[3] + 1j * values[4], abs=1e-5)
    rms = np.sqrt((covariance[3, 3] + covariance[4, 4]) / 2)
    # Our phases count from the middle of the record inside, where amplitude and frequency are uncorrelated.
    assert float(fit.amplitudes_u[1]) == pytest.approx(rms, rel=0.15)
    assert float(fit.noise_rms) == pytest.approx(0.1, rel=0.1)


def test_missing_samples_are_left_out():
    rng = np.random.default_rng(4)
    volts = synthetic(rng, 3.3, [1.0, 0.2])
    volts[100:150] = np.nan
    fit = fit_harmonics(volts, 0.01, harmonics=2, nan_policy="omit")
    assert float(fit.frequency) == pytest.approx(3.3, rel=1e-9)
    assert abs(complex(fit.amplitudes[1])) == pytest.approx(0.2, abs=1e-8)


def test_a_constant_record_has_no_frequency():
    fit = fit_harmonics(np.full(100, 0.3), 1e-3)
    assert np.isnan(fit.frequency)


@pytest.mark.parametrize(
    ("volts", "interval", "harmonics", "word"),
    [
        (np.zeros(7), 1.0, 1, "8 samples"),
        (np.zeros(100), -1.0, 1, "sample_interval"),
        (np.zeros(100), np.nan, 1, "sample_interval"),
        (np.full(100, np.inf), 1.0, 1, "infinite"),
        (np.full(100, np.nan), 1.0, 1, "nan"),
        (np.zeros(100), 1.0, 0, "harmonics"),
        (np.zeros(100, complex), 1.0, 1, "real"),
    ],
)
def test_bad_input_is_named(volts, interval, harmonics, word):
    with pytest.raises(ValueError, match=word):
        fit_harmonics(volts, interval, harmonics=harmonics)
