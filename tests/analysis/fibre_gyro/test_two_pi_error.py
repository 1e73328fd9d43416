"""The 2 pi error from open-loop injection into a gyro simulated at every transit time."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.fibre_gyro import ClosedLoop, FibreCoil, LoopDesign, TwoPiError, estimate_two_pi_error

COIL = FibreCoil()
STEPS = np.array([4095.0, -4095.0, 2501.0, -2501.0])


def measured(design: LoopDesign, seed: int, seconds: float = 0.1, rate: float = 0.003) -> TwoPiError:
    """Four segments with the feedback held at zero."""
    gyro = ClosedLoop(COIL, design, seed=seed, runs=4)
    block = gyro.run(25, output_period_s=seconds / 25, rate_dps=rate, injected_step=STEPS[:, None], closed=False)
    means = [getattr(block, name).mean(axis=1) for name in ("normal_error", "reset_error")]
    us = [getattr(block, name).std(axis=1, ddof=1) / 5 for name in ("normal_error", "reset_error")]
    return estimate_two_pi_error(STEPS, *means, *us, dac_bits=design.dac_bits)


@pytest.mark.parametrize("eps", [1e-3, 3e-3, -2e-3, 2e-2, 0.0])
def test_error_of_the_simulated_gyro_is_found(eps: float) -> None:
    result = measured(LoopDesign(two_pi_error=eps), seed=1)
    assert result.two_pi_error == pytest.approx(eps, abs=4 * result.two_pi_error_u)
    assert 1e-6 < result.two_pi_error_u < 1e-5
    assert result.amplitude == pytest.approx(8192 * np.sin(np.pi / 2 * (1 + eps)), abs=4 * result.amplitude_u)
    # the rotation: 0.003 deg/s
    assert result.rest_phase_rad == pytest.approx(np.radians(0.003) * 1.35216, abs=4 * result.rest_phase_u_rad)


def test_light_level_and_contrast_need_not_be_known() -> None:
    result = measured(LoopDesign(two_pi_error=2e-3, light_level=0.6, contrast=0.7), seed=2)
    assert result.two_pi_error == pytest.approx(2e-3, abs=4 * result.two_pi_error_u)


def test_uncertainty_is_the_scatter_of_repeated_measurements() -> None:
    results = [measured(LoopDesign(two_pi_error=2e-3), seed, seconds=0.02) for seed in range(60)]
    errors = np.array([(r.two_pi_error - 2e-3) / r.two_pi_error_u for r in results])
    assert errors.std() == pytest.approx(1.0, abs=0.3)
    assert errors.mean() == pytest.approx(0.0, abs=0.45)


def test_steps_that_do_not_agree_widen_the_uncertainty() -> None:
    phi = 2 * np.pi * 1.002 * STEPS / 2**16
    normal, reset = -2 * np.sin(phi), -np.sin(phi) - np.sin(phi - 0.004 * np.pi * np.sign(STEPS))
    whole = estimate_two_pi_error(STEPS, normal, reset, 1e-6, 1e-6, dac_bits=16)
    assert whole.two_pi_error == pytest.approx(2e-3, abs=1e-9)
    off = np.array([1, -1, -1, 1]) * 2e-5
    bent = estimate_two_pi_error(STEPS, normal, reset + off, 1e-6, 1e-6, dac_bits=16)
    parts = bent.contributions
    assert parts["scatter"] > 5 * np.hypot(parts["normal"], parts["reset"])
    assert np.linalg.norm(list(parts.values())) == pytest.approx(bent.two_pi_error_u)
    # five degrees of freedom: Student's t is a third wider than the normal distribution
    plain = np.hypot(whole.contributions["normal"], whole.contributions["reset"])
    assert bent.two_pi_error_u / plain == pytest.approx(1.31 * np.sqrt(bent.chi_square / 5), rel=0.1)


def test_errors_of_no_open_loop_are_refused() -> None:
    phi = 2 * np.pi * STEPS / 2**16
    normal, reset = -2 * np.sin(phi), -2 * np.sin(phi)
    assert estimate_two_pi_error(STEPS, normal, reset, 1e-6, 1e-6, dac_bits=16).two_pi_error == pytest.approx(0.0)
    for steps, normals, resets, words in (
        (np.abs(STEPS), normal, reset, "both senses"),
        (STEPS * 10, normal, reset, "less than half"),
        (STEPS, -normal, reset, "the loop is closed"),
        (STEPS, normal, np.where(STEPS == -2501, np.nan, reset), "at a step of -2501 codes"),
    ):
        with pytest.raises(ValueError, match=words):
            estimate_two_pi_error(steps, normals, resets, 1e-6, 1e-6, dac_bits=16)
    with pytest.raises(ValueError, match="positive standard uncertainty"):
        estimate_two_pi_error(STEPS, normal, reset, 0.0, 1e-6, dac_bits=16)
