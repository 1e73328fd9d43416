"""The study of the paper against an ODE solver, window theory and hand arithmetic."""

import math

import numpy as np
import pytest
import reference

from analysis.study import (
    Gyros,
    bias_table,
    errors_by_peaks,
    find_causes,
    largest_over_phases,
    lock_in_study,
    peak_ratio,
    peak_readings,
    phase_study,
    rate_study,
    records,
    spectrum,
    waveform_study,
)

# x, r = A2/A1, bias of (13) and (10) in percent: from amplitudes of an eighth-order integration
PUBLISHED = [
    (0.01, "0.00500013", "-0.0025", "+0.0025"),
    (0.02, "0.01000100", "-0.0100", "+0.0100"),
    (0.05, "0.02501564", "-0.0624", "+0.0626"),
    (0.10, "0.05012563", "-0.2488", "+0.2513"),
    (0.15, "0.07542669", "-0.5562", "+0.5689"),
    (0.20, "0.10102051", "-0.9803", "+1.0205"),
    (0.30, "0.15353600", "-2.1520", "+2.3573"),
    (0.40, "0.20871215", "-3.6972", "+4.3561"),
    (0.50, "0.26794919", "-5.5305", "+7.1797"),
    (0.60, "0.33333333", "-7.5500", "+11.111"),
    (0.70, "0.40836737", "-9.6334", "+16.676"),
    (0.80, "0.50000000", "-11.612", "+25.000"),
    (0.90, "0.62678901", "-13.140", "+39.286"),
    (0.95, "0.72394747", "-13.387", "+52.410"),
    (0.98, "0.81734950", "-12.955", "+66.806"),
]


def test_bias_table_to_all_digits() -> None:
    table = bias_table()
    for row, (x, ratio, by_13, by_10) in enumerate(PUBLISHED):
        assert table.rate_ratio[row] == x
        assert f"{table.ratio[row]:.8f}" == ratio
        for value, text in ((table.formula_13[row], by_13), (table.formula_10[row], by_10)):
            digits = len(text.split(".")[1])
            # a last digit of a five may have been rounded either way
            assert 100 * value == pytest.approx(float(text), abs=0.5000001 * 10**-digits + 1e-9)
        assert table.ours[row] < 1e-8


def test_records_are_those_of_the_lock_in_equation() -> None:
    times = np.arange(400) / 20_000
    solved = reference.integrated_beat(times, 2000.0, 0.5, 0.03, phi0=1.3)
    np.testing.assert_allclose(records(Gyros.of(0.5, 0.03, 1.3), 400), solved, atol=1e-9)


def test_spectrum_and_peaks_of_a_tone_in_the_middle_of_a_bin() -> None:
    times = np.arange(60_000) / 20_000
    volts = 0.3 + 0.8 * np.cos(2 * np.pi * 1000 * times) + 0.02 * np.cos(2 * np.pi * 2000 * times + 1)
    for window in ("boxcar", "hann", "flattop"):
        lines = spectrum(volts[np.newaxis], window)
        assert lines[0, 3000] == pytest.approx(0.8, rel=1e-4)
        assert float(peak_ratio(lines)[0]) == pytest.approx(0.025, rel=1e-3)


def test_fig_2_is_that_of_the_paper() -> None:
    wave = waveform_study(0.5)
    assert wave.beat_frequency == pytest.approx(1732.0508, abs=1e-4)
    np.testing.assert_allclose(wave.exact[:3], [0.9282032303, 0.2487113060, 0.0666419930], rtol=1e-6)
    np.testing.assert_allclose(wave.fitted, wave.exact, atol=1e-6)
    assert wave.lock_in_by(wave.fitted)[1] == pytest.approx(0.5, rel=1e-6)
    # 1732.05 Hz lie 0.15 of a bin away from a line of the spectrum, 2f 0.30, with sin(pi d)/(pi d) of their height
    seen = np.sinc([0.15236, 0.30473])
    assert wave.peaks[1] / wave.peaks[0] == pytest.approx(
        math.tan(math.asin(0.5) / 2) * seen[1] / seen[0], rel=1e-3
    )


def test_picket_fence_has_the_size_that_window_theory_gives() -> None:
    found = {reading.window: reading for reading in peak_readings()}
    # the beat half way between two lines and 2f on one: 1/sinc(1/2) and, for Hann, (1 - 1/4)/sinc(1/2)
    assert found["boxcar"].largest == pytest.approx(math.pi / 2 - 1, rel=0.005)
    assert found["hann"].largest == pytest.approx(0.75 * math.pi / 2 - 1, rel=0.005)
    assert found["flattop"].largest < 0.002
    assert 0.04 < found["blackmanharris"].rms < 0.05


@pytest.mark.slow
def test_causes_add_up_to_the_whole() -> None:
    points = ((0.2, 0.01), (1.0, 0.05), (0.5, 0.03), (0.2, 0.15))
    causes = find_causes(points)
    for window, together in causes.together.items():
        product = (1 + causes.formula) * (1 + causes.peak[window]) * (1 + causes.leakage[window]) - 1
        np.testing.assert_allclose(together[:3], product[:3], atol=0.006)
        assert together[3] == pytest.approx(product[3], abs=0.03)  # formula and reading are not small there
    assert causes.formula[1] == pytest.approx(-0.000624, abs=1e-6)
    assert np.all(np.abs(causes.ours) < 1e-8)
    assert np.all(causes.rounding < 0.003)


def test_euler_errs_as_its_difference_equation_says() -> None:
    # to first order in x the phase wobbles by (b h)/(2 sin(w h/2)) instead of b/w
    causes = find_causes(((0.2, 0.01), (1.0, 0.05)), windows=("hann",))
    half = math.pi * 2000 * np.array([0.2, 1.0]) / 20_000
    np.testing.assert_allclose(causes.euler, half / np.sin(half) - 1, rtol=0.01)
    assert np.abs(causes.runge_kutta).max() < 1e-4


def test_error_depends_on_the_phase_by_leakage_alone() -> None:
    study = phase_study(((0.5, 0.01),), points=9)
    spread = {name: np.ptp(found[0]) for name, found in study.by_peaks.items()}
    assert spread["boxcar"] > 0.01
    assert spread["hann"] < 1e-4
    assert np.abs(study.ours).max() < 1e-9


def test_figs_5_and_6_have_the_largest_over_the_phase() -> None:
    rates = np.array([0.2, 1.0])
    fifth, sixth = rate_study((0.05, 0.1), rates), lock_in_study(np.array([0.05, 0.1]))
    np.testing.assert_allclose(fifth.by_peaks["boxcar"][:, 1], sixth.by_peaks["boxcar"][0])
    np.testing.assert_allclose(fifth.formula[:, 1], sixth.formula[0])
    some = errors_by_peaks(Gyros.of(1.0, 0.05, np.linspace(0, 2 * np.pi, 8, endpoint=False)))["boxcar"]
    assert abs(fifth.by_peaks["boxcar"][0, 1]) == pytest.approx(np.abs(some).max())
    assert np.abs(fifth.ours).max() < 1e-7


def test_largest_over_phases_keeps_the_sign() -> None:
    np.testing.assert_array_equal(largest_over_phases(np.array([[0.1, -0.3], [0.2, 0.1]])), [-0.3, 0.2])
