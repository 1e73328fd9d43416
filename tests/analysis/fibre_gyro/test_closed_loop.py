"""What a closed-loop gyro does, from its simulation at every transit time, against predictions by hand.

Pairs of gyros with the same noise are compared, so that a short run shows ppm.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from analysis.fibre_gyro import ClosedLoop, FibreCoil, LoopDesign

COIL = FibreCoil()
K0 = 246.152866
QUIET = LoopDesign(angle_random_walk_deg_per_sqrt_h=0.0005)


def mean_output(
    design: LoopDesign, rate: float, *, seconds: float = 0.15, step: float = 0.0, coil: FibreCoil = COIL
) -> float:
    """Mean output of a settled gyro."""
    gyro = ClosedLoop(coil, design, seed=1)
    gyro.run(1, output_period_s=2e-3, rate_dps=rate, injected_step=step)
    return float(gyro.run(1, output_period_s=seconds, rate_dps=rate, injected_step=step).counts[0])


def scale(design: LoopDesign, rate: float = 20.0, coil: FibreCoil = COIL) -> float:
    """Scale factor over the nominal one, from both senses."""
    return (mean_output(design, rate, coil=coil) - mean_output(design, -rate, coil=coil)) / (2 * rate * K0)


def test_output_is_the_rate_times_the_nominal_scale() -> None:
    # white noise alone: 0.0005/60/sqrt(0.15) deg/s, 1 ppm of 20 deg/s
    assert scale(QUIET) == pytest.approx(1.0, abs=3e-6)
    assert mean_output(QUIET, 0.5) == pytest.approx(0.5 * K0, abs=4 * 0.0053)


@pytest.mark.parametrize("eps", [1e-4, 1e-3, 5e-3, 1e-2, -5e-3])
def test_two_pi_error_is_in_the_scale_where_falls_are_left_out(eps: float) -> None:
    assert scale(replace(QUIET, two_pi_error=eps)) == pytest.approx(1 / (1 + eps), abs=4e-6)


def test_optical_two_pi_is_the_scale_where_all_samples_are_used() -> None:
    for eps in (1e-3, 1e-2, -5e-3):
        change = scale(replace(QUIET, two_pi_error=eps, gated=False)) / scale(replace(QUIET, gated=False)) - 1
        assert change == pytest.approx(-eps * (2 * np.pi * eps) ** 2 / 6, abs=2e-6)


def test_second_loop_takes_the_two_pi_error_away() -> None:
    design = replace(QUIET, two_pi_error=0.01, two_pi_loop_gain=0.02)
    gyro = ClosedLoop(COIL, design, seed=1)
    gyro.run(1, output_period_s=0.05, rate_dps=20.0)
    assert gyro.two_pi_error[0] == pytest.approx(0.0, abs=1e-4)
    settled = gyro.run(1, output_period_s=0.15, rate_dps=20.0).counts[0]
    assert settled == pytest.approx(20 * K0, rel=4e-5)


@pytest.mark.parametrize(("eps", "gated"), [(0.0, True), (0.01, True), (0.01, False)])
def test_shared_injection_gives_back_the_number_whatever_the_hardware(eps: float, gated: bool) -> None:
    """At rest the converter does not even move. White noise of a mean: 0.0053 codes."""
    design = replace(QUIET, two_pi_error=eps, gated=gated, inl_cubic=4e-3)
    rest = mean_output(design, 0.0)
    for step in (-4923.05, 24.6153, 2.46):
        sent = round(step * 2**14) / 2**14
        assert mean_output(design, 0.0, step=step) - rest == pytest.approx(sent, abs=0.025)
    changed = mean_output(design, 0.0, step=1000.0, coil=COIL.scaled(1.0001))
    assert changed - rest == pytest.approx(1000.0, abs=0.025)  # 100 ppm of the coil would be 0.1


def test_second_electrode_tells_the_ratio_of_both_spans() -> None:
    design = replace(QUIET, two_pi_error=0.003, injection_path="separate", injection_two_pi_error=-0.002)
    slope = (mean_output(design, 0.0, step=1000.0) - mean_output(design, 0.0, step=-1000.0)) / 2000.0
    assert slope == pytest.approx(0.998 / 1.003, abs=2e-5)


def test_two_pi_error_without_gate_is_a_ripple_of_the_output() -> None:
    """At 0.01 deg/s 7.67 falls a second each put 2^16 eps codes into one of a hundred outputs of 10 ms."""
    spread = {}
    for eps in (0.0, 0.01):
        gyro = ClosedLoop(COIL, replace(QUIET, two_pi_error=eps, gated=False), seed=1)
        gyro.run(1, output_period_s=2e-3, rate_dps=0.01)
        spread[eps] = float(gyro.run(400, rate_dps=0.01).counts.std()) / K0 * 3600
    samples, share = 0.01 / COIL.transit_time, 0.0767
    jump = 65536 * 0.01 / samples / K0 * 3600
    assert spread[0.0] == pytest.approx(0.33, abs=0.03)
    expected = np.hypot(spread[0.0], jump * np.sqrt(share * (1 - share)))
    assert spread[0.01] == pytest.approx(expected, rel=0.12)


def test_bow_of_the_converter_is_seen_in_the_gated_mode_only() -> None:
    s_shape = replace(QUIET, inl_cubic=4e-3)
    assert scale(s_shape) - scale(QUIET) == pytest.approx(250e-6, abs=20e-6)
    assert scale(replace(s_shape, gated=False)) == pytest.approx(scale(replace(QUIET, gated=False)), abs=2e-6)
    # an even bow makes the two senses unlike, and leaves the mean scale
    bow = replace(QUIET, inl_quadratic=4e-3)
    assert scale(bow) == pytest.approx(scale(QUIET), abs=1e-5)
    senses = [mean_output(bow, rate) / mean_output(QUIET, rate) - 1 for rate in (20.0, -20.0)]
    assert senses[0] - senses[1] == pytest.approx(220e-6, abs=30e-6)


def test_small_rates_are_lost_without_noise_and_found_with_it() -> None:
    silent = replace(QUIET, angle_random_walk_deg_per_sqrt_h=0.0)
    assert abs(mean_output(silent, 0.001) / (0.001 * K0) - 1) > 0.9
    assert mean_output(replace(silent, adc_offset=0.5), 0.001) == 0.0
    assert mean_output(QUIET, 0.001, seconds=0.5) == pytest.approx(0.001 * K0, abs=4 * 0.0005 / 60 / 0.5**0.5 * K0)


@pytest.mark.slow
def test_feedback_held_does_not_follow_the_rate() -> None:
    gyro = ClosedLoop(COIL, QUIET, seed=1)
    gyro.run(1, rate_dps=2.0)
    held = gyro.run(3, rate_dps=-5.0, closed=False).counts
    assert np.ptp(held) == 0.0
    assert held[0] == pytest.approx(2.0 * K0, rel=0.01)
    gyro.clear_feedback()
    assert gyro.run(1, rate_dps=-5.0, closed=False).counts[0] == 0.0


def test_loop_settles_with_its_time_constant() -> None:
    """What is left falls by 1 - g each sample pair: 1/g pairs of it are missing in the first mean."""
    # all samples used: none of the approach waits for a fall to pass
    block = ClosedLoop(COIL, replace(QUIET, gated=False), seed=1).run(2, output_period_s=1e-3, rate_dps=20.0)
    missing = (20 * K0 - block.counts[0]) * 1e-3 / (2 * COIL.transit_time) / (20 * K0)
    assert missing == pytest.approx(1 / 0.2, rel=0.02)
    assert block.counts[1] == pytest.approx(20 * K0, rel=3e-5)


def test_moving_rate_is_followed() -> None:
    block = ClosedLoop(COIL, QUIET, seed=1).run(
        200, output_period_s=5e-4, rate_dps=lambda t: 10 * np.sin(2 * np.pi * 20 * t)
    )
    middle = block.times_s - 2.5e-4
    phase = 2 * np.pi * 20 * (middle - COIL.transit_time * 2 * 5)
    np.testing.assert_allclose(block.counts[2:] / K0, 10 * np.sin(phase)[2:], atol=0.02)


def test_trace_shows_staircase_bias_and_falls() -> None:
    gyro = ClosedLoop(COIL, replace(QUIET, two_pi_error=0.01), seed=1)
    gyro.run(1, rate_dps=20.0)
    trace = gyro.trace(400, rate_dps=20.0)
    assert np.diff(trace.times_s) == pytest.approx(COIL.transit_time)
    assert trace.times_s[0] == pytest.approx(0.01, abs=3 * COIL.transit_time)
    # a staircase downwards of 4874 codes, with a rise of the full range every 13.4 steps
    steps = np.diff(trace.staircase)
    assert np.median(steps) == pytest.approx(-20 * K0 / 1.01, abs=20)
    np.testing.assert_array_equal(np.flatnonzero(trace.reset[1:]), np.flatnonzero(steps > 30_000))
    assert trace.reset.sum() == pytest.approx(400 * 20 * K0 / 1.01 / 65536, abs=1.01)
    np.testing.assert_array_equal(trace.code - trace.staircase, np.tile([16_384, 0], 200))
    np.testing.assert_allclose(trace.modulator_rad, trace.code / 65536 * 2 * np.pi * 1.01, rtol=1e-12)
    # the beams: Sagnac phase, and modulator now less modulator before
    sagnac = np.radians(20.0) * 1.3521581
    np.testing.assert_allclose(trace.difference_rad[1:] - np.diff(trace.modulator_rad), sagnac, atol=1e-6)
    np.testing.assert_allclose(trace.intensity, (1 + np.cos(trace.difference_rad)) / 2, atol=1e-12)
    assert np.abs(trace.adc - trace.intensity * 16384).max() < 6
    # the gyro goes on from there
    assert gyro.run(1, rate_dps=20.0).counts[0] == pytest.approx(20 * K0 / 1.01, rel=3e-5)
