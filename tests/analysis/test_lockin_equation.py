import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from reference import integrated_beat

from analysis import (
    beat_frequency,
    beat_signal,
    harmonic_ratio,
    input_rate_from_beat,
    lock_in_from_beat,
    lock_in_from_rate,
    rate_varying_beat,
)


@pytest.mark.parametrize("rate", [1.0, -1.0, 0.6, -0.51, 0.5, -0.5, 0.49, 0.1, 0.0, -0.3])
@pytest.mark.parametrize(("phi0", "beta", "delta"), [(0.0, 0.0, 0.0), (1.1, 2.3, -0.7), (-3.0, 0.4, 1.5)])
def test_the_closed_form_agrees_with_an_integrator(rate, phi0, beta, delta):
    times = np.linspace(0, 0.02, 801)
    ours = beat_signal(
        times,
        scale_factor=2000,
        input_rate=rate,
        lock_in_rate=0.5,
        amplitude=3.0,
        initial_phase=phi0,
        backscatter_phase=beta,
        readout_phase=delta,
    )
    theirs = integrated_beat(times, 2000, rate, 0.5, amplitude=3.0, phi0=phi0, beta=beta, delta=delta)
    assert np.abs(ours - theirs).max() < 3.0e-8  # 1e-8 of the amplitude


def test_one_hair_from_the_edge_of_lock_in():
    times = np.linspace(0, 0.05, 500)
    for rate in (0.5 * (1 + 1e-9), 0.5, 0.5 * (1 - 1e-9)):
        ours = beat_signal(times, scale_factor=2000, input_rate=rate, lock_in_rate=0.5, initial_phase=0.3)
        theirs = integrated_beat(times, 2000, rate, 0.5, phi0=0.3)
        assert np.abs(ours - theirs).max() < 1e-8


def test_a_locked_gyro_settles_and_stays_finite():
    settled = beat_signal([1e6], scale_factor=2000, input_rate=0.1, lock_in_rate=0.5)
    assert settled[0] == pytest.approx(0.1 / 0.5)


def test_parameters_broadcast_over_leading_axes():
    times = np.linspace(0, 0.01, 50)
    rates = np.array([[0.2], [0.4]])
    phases = np.array([0.1, 0.2, 0.3])
    stack = beat_signal(times, scale_factor=2000, input_rate=rates, lock_in_rate=0.1, initial_phase=phases)
    single = beat_signal(times, scale_factor=2000, input_rate=0.4, lock_in_rate=0.1, initial_phase=0.2)
    assert stack.shape == (2, 3, 50)
    np.testing.assert_array_equal(stack[1, 1], single)


@pytest.mark.parametrize("bad", [{"lock_in_rate": -0.1}, {"scale_factor": 0.0}, {"input_rate": np.nan}])
def test_nonsense_parameters_are_refused(bad):
    good = {"scale_factor": 2000, "input_rate": 0.2, "lock_in_rate": 0.01}
    with pytest.raises(ValueError, match=next(iter(bad))):
        beat_signal([0.0, 1.0], **(good | bad))


def test_harmonics_of_the_integrated_beat_are_one_geometric_series():
    x, k = 0.5, 2000.0
    f = k * np.sqrt(1 - x * x)
    times = np.arange(4096) / (4096 * f)
    c = 2 * np.fft.fft(integrated_beat(times, k, 1.0, x, phi0=0.4, beta=1.0, delta=0.2)) / 4096
    size = np.abs(c)
    assert size[1] == pytest.approx(0.9282032303, abs=1e-8)
    np.testing.assert_allclose(size[2:6] / size[1:5], 0.2679491924, rtol=1e-7)
    assert f == pytest.approx(1732.0508, abs=1e-4)


@pytest.mark.parametrize(
    ("x", "ratio", "high_13", "high_10"),
    [
        (0.01, 0.00500013, -0.0025, 0.0025),
        (0.05, 0.02501564, -0.0624, 0.0626),
        (0.20, 0.10102051, -0.9803, 1.0205),
        (0.50, 0.26794919, -5.5305, 7.1797),
        (0.80, 0.50000000, -11.612, 25.000),
        (0.98, 0.81734950, -12.955, 66.806),
    ],
)
def test_the_bias_of_the_papers_relations(x, ratio, high_13, high_10):
    """Figures found with an eighth-order integrator, not with these formulas."""
    assert float(harmonic_ratio(x)) == pytest.approx(ratio, abs=6e-9)
    for relation, percent in (("paper-13", high_13), ("paper-10", high_10), ("exact", 0.0)):
        bias = 100 * (float(lock_in_from_rate(ratio, 1.0, relation)) / x - 1)
        assert bias == pytest.approx(percent, abs=2e-3 if abs(percent) > 10 else 2e-4)


@given(x=st.floats(1e-6, 0.999), w=st.floats(1e-3, 100.0))
def test_every_inverse_returns_the_rates(x, w):
    ratio, beat_rate = harmonic_ratio(x), beat_frequency(1.0, w, w * x)
    assert float(lock_in_from_rate(ratio, -w)) == pytest.approx(w * x, rel=1e-9)
    assert float(lock_in_from_beat(ratio, beat_rate)) == pytest.approx(w * x, rel=1e-6)
    assert float(input_rate_from_beat(ratio, beat_rate)) == pytest.approx(w, rel=1e-6)


@pytest.mark.slow
@settings(max_examples=settings().max_examples // 10)
@given(ramp=st.floats(-20, 20), phi0=st.floats(-3, 3), beta=st.floats(-3, 3))
@example(ramp=-13.65625, phi0=1.515625, beta=-0.6875)
def test_a_moving_rate_agrees_with_an_integrator(ramp, phi0, beta):
    """Through lock-in and out again. Steps of a moving rate are of second order, so a finer grid is better."""

    def error(n):
        times = np.linspace(0, 0.02, n)
        middle = (times[:-1] + times[1:]) / 2
        ours = rate_varying_beat(
            0.4 + ramp * middle,
            times[1],
            scale_factor=2000,
            lock_in_rate=0.3,
            initial_phase=phi0,
            backscatter_phase=beta,
            readout_phase=0.5,
        )
        return np.abs(ours - theirs(times, phi0)).max()

    def theirs(times, start):
        return integrated_beat(times, 2000, lambda t: 0.4 + ramp * t, 0.3, phi0=start, beta=beta, delta=0.5)

    fine, times = error(4001), np.linspace(0, 0.02, 401)
    # close to the threshold neighbouring phases part: what they part by is no error of the steps
    spread = np.abs(theirs(times, phi0 + 1e-5) - theirs(times, phi0)).max() / 1e-5
    assert fine < 1e-6 * (1 + spread)
    assert fine < error(1001) / 10 + 1e-8


def test_unknown_relation_is_named():
    with pytest.raises(ValueError, match="paper-12"):
        lock_in_from_rate(0.1, 1.0, "paper-12")
