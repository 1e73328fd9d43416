import numpy as np
import pytest
from scipy.signal import lsim, lti

from analysis import beat_signal, estimate_lock_in, fit_rates
from analysis.channel import ChannelResponse, correct_response, ratio_factor
from analysis.flags import Flag

K, WL = 2000.0, 0.05
FINE = 400
"""Points a period of the filtered beat; every tenth is a sample."""


def filtered_record(multiple, *, low_pass=None, high_pass=None, noise=0.0, rng=None, n_records=1):
    """A beat through poles at multiples of its frequency, in the time domain; interval, rate and frequency."""
    rate = multiple * WL
    f = K * np.sqrt(rate**2 - WL**2)
    times = np.arange(90 * FINE) / (FINE * f)
    volts = beat_signal(
        times, scale_factor=K, input_rate=rate, lock_in_rate=WL, backscatter_phase=0.7, initial_phase=1.0
    )
    if low_pass is not None:
        pole = 2 * np.pi * f * low_pass
        volts = lsim(lti([pole], [1, pole]), volts, times)[1]
    if high_pass is not None:
        volts = lsim(lti([1, 0], [1, 2 * np.pi * f * high_pass]), volts, times)[1]
    settled = volts[30 * FINE :: 10]
    if noise:
        settled = settled + rng.normal(scale=noise, size=(n_records, settled.size))
    return settled, 10 / (FINE * f), rate, f


@pytest.mark.slow
@pytest.mark.parametrize(("corner", "percent"), [(3, -12.3), (5, -5.35), (10, -1.45), (20, -0.37), (50, -0.06)])
def test_one_pole_weakens_the_ratio_by_the_known_amounts(corner, percent):
    volts, interval, rate, f = filtered_record(20, low_pass=corner)
    measured = estimate_lock_in(volts, interval, scale_factor=K, input_rate=rate)
    error = 100 * (float(measured.lock_in_rate) / WL - 1)
    assert error == pytest.approx(percent, abs=0.1)
    response = ChannelResponse(low_pass_hz=[corner * f])
    assert 100 * (abs(ratio_factor(response, f)) - 1) == pytest.approx(error, abs=0.03)
    corrected = correct_response(measured, response)
    assert float(corrected.lock_in_rate) == pytest.approx(WL, rel=1.5e-4)
    assert float(corrected.backscatter_phase) == pytest.approx(0.7, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("share", "percent"), [(3, 3.97), (5, 1.47), (10, 0.37), (20, 0.09)])
def test_ac_coupling_strengthens_the_ratio_by_the_known_amounts(share, percent):
    volts, interval, rate, f = filtered_record(20, high_pass=1 / share)
    measured = estimate_lock_in(volts, interval, scale_factor=K, input_rate=rate)
    assert 100 * (float(measured.lock_in_rate) / WL - 1) == pytest.approx(percent, abs=0.05)
    corrected = correct_response(measured, ChannelResponse(high_pass_hz=[f / share]))
    assert float(corrected.lock_in_rate) == pytest.approx(WL, rel=1.5e-4)
    assert float(corrected.backscatter_phase) == pytest.approx(0.7, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("multiple", [1.1, 1.5, 3, -3])
def test_close_to_lock_in_the_higher_harmonics_count(multiple):
    volts, interval, rate, f = filtered_record(multiple, low_pass=3, high_pass=0.2)
    measured = estimate_lock_in(volts, interval, scale_factor=K, input_rate=rate)
    response = ChannelResponse(low_pass_hz=[3 * f], high_pass_hz=[0.2 * f])
    corrected = correct_response(measured, response)
    assert abs(float(measured.lock_in_rate) / WL - 1) > 0.05
    # what a filter does to the waveform repeats with the beat: it is no motion of the rate
    assert not int(measured.flags) & int(Flag.RATE_WANDER)
    assert float(measured.beat_frequency) == pytest.approx(f, rel=1e-6)
    assert float(corrected.lock_in_rate) == pytest.approx(WL, rel=2e-4)
    assert float(corrected.backscatter_phase) == pytest.approx(0.7, abs=1e-4)
    # The plain factor at f and 2f would leave a trace.
    if abs(multiple) < 2:
        plain = abs(measured.complex_ratio / ratio_factor(response, f))
        assert abs(plain / np.tan(np.arcsin(1 / abs(multiple)) / 2) - 1) > 0.01


def test_a_measured_table_does_what_the_pole_does():
    volts, interval, rate, f = filtered_record(8, low_pass=4)
    measured = estimate_lock_in(volts, interval, scale_factor=K, input_rate=rate)
    points = f * np.geomspace(0.3, 60, 25)
    gains = 1 / np.sqrt(1 + (points / (4 * f)) ** 2)
    table = ChannelResponse(
        table_hz=points, table_gain=gains, table_phase_rad=-np.arctan(points / (4 * f)), table_gain_u=0.002
    )
    corrected = correct_response(measured, table)
    assert float(corrected.lock_in_rate) == pytest.approx(WL, rel=1e-3)
    # Two gains, each known to 0.2 %.
    assert float(corrected.lock_in_rate_u) / WL == pytest.approx(0.002 * np.sqrt(2), rel=0.02)
    assert "response" in corrected.noise_model


def test_the_uncertainty_of_a_corner_goes_where_the_factor_says():
    """Corner 5 f known to 10 %: d ln factor/d ln corner = x^2/(1+x^2) - 4x^2/(1+4x^2), negative, with x = 1/5."""
    volts, interval, rate, f = filtered_record(20, low_pass=5)
    measured = estimate_lock_in(volts, interval, scale_factor=K, input_rate=rate)
    corrected = correct_response(measured, ChannelResponse(low_pass_hz=[5 * f], low_pass_u_hz=[0.5 * f]))
    by_hand = 0.1 * (4 / 29 - 1 / 26)
    assert float(corrected.lock_in_rate_u) / WL == pytest.approx(by_hand, rel=0.02)


def test_noise_and_corrections_keep_the_coverage():
    rng = np.random.default_rng(1)
    volts, interval, rate, f = filtered_record(8, low_pass=4, noise=0.01, rng=rng, n_records=300)
    measured = estimate_lock_in(volts, interval, scale_factor=K, input_rate=rate)
    e = correct_response(measured, ChannelResponse(low_pass_hz=[4 * f]))
    assert np.std((e.lock_in_rate - WL) / e.lock_in_rate_u) == pytest.approx(1, abs=0.12)
    assert np.mean((e.lock_in_rate_low_95 <= WL) & (e.lock_in_rate_high_95 >= WL)) > 0.92


@pytest.mark.slow
def test_corrected_estimates_fit_over_several_rates():
    rng = np.random.default_rng(2)
    corner = 4 * K * 20 * WL
    made = []
    for multiple in (5, 20, -5, -20):
        f = K * WL * np.sqrt(multiple**2 - 1)
        volts, interval, rate, _ = filtered_record(
            multiple, low_pass=corner / f, noise=0.003, rng=rng, n_records=4
        )
        measured = estimate_lock_in(volts, interval, scale_factor=K, input_rate=rate)
        made.append((measured, correct_response(measured, ChannelResponse(low_pass_hz=[corner]))))
    fit = fit_rates([corrected for _, corrected in made])
    assert abs(fit.lock_in_rate - WL) < 4 * fit.lock_in_rate_u < 0.005 * WL
    raw = fit_rates([measured for measured, _ in made], model="lock-in")
    assert raw.lock_in_rate < fit.lock_in_rate


@pytest.mark.parametrize(
    ("response", "message"),
    [
        ({"low_pass_hz": [0.0]}, "low_pass_hz"),
        ({"high_pass_hz": [np.nan]}, "high_pass_hz"),
        ({"low_pass_hz": [1.0], "low_pass_u_hz": [1.0, 2.0]}, "one uncertainty for each"),
        ({"table_hz": [1.0, 2.0], "table_gain": [1.0, 1.0]}, "same length"),
        ({"table_hz": [2.0, 1.0], "table_gain": [1.0, 1.0], "table_phase_rad": [0.0, 0.0]}, "rising"),
        ({"table_hz": [1.0, 2.0], "table_gain": [1.0, 0.0], "table_phase_rad": [0.0, 0.0]}, "positive"),
        ({"table_gain_u": -1.0}, "must not be negative"),
    ],
)
def test_an_impossible_response_is_named(response, message):
    with pytest.raises(ValueError, match=message):
        ChannelResponse(**response)


def test_a_second_harmonic_outside_the_table_is_refused():
    table = ChannelResponse(table_hz=[100.0, 1500.0], table_gain=[1.0, 0.9], table_phase_rad=[0.0, -0.1])
    assert abs(ratio_factor(table, 500.0)) < 1
    with pytest.raises(ValueError, match="from 100 to 1500 Hz, but 2000 Hz"):
        ratio_factor(table, 1000.0)


def test_records_without_a_beat_stay_without_a_value():
    volts, interval, rate, f = filtered_record(8, low_pass=4)
    stack = np.stack([volts, np.zeros_like(volts)])
    measured = estimate_lock_in(stack, interval, scale_factor=K, input_rate=rate)
    corrected = correct_response(measured, ChannelResponse(low_pass_hz=[4 * f]))
    assert np.isfinite(corrected.lock_in_rate[0]) and np.isnan(corrected.lock_in_rate[1])
    assert list(corrected.usable) == [True, False]
