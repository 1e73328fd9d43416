"""One rate in both senses says nothing of the gain time: any within its bound counts, and none beyond it."""

import numpy as np
import pytest

from analysis.budget import BenchKnowledge, ResponseCorner, lowest_gain_corner
from analysis.lockin_equation import beat_frequency, harmonic_ratio
from analysis.several_rates import fit_rate_ratios


def test_a_gain_time_within_its_bound_spreads_the_result_as_its_integral_says() -> None:
    k, lock_in, rate = 2000.0, 0.01, np.array([0.08, -0.08])
    frequency, ratio = beat_frequency(k, np.abs(rate), lock_in), float(harmonic_ratio(1 / 8))
    seen = np.array([-ratio * np.exp(0.7j), ratio * np.exp(-0.7j)])
    bench = BenchKnowledge(
        50.0,
        0.0,
        distortion_limit=0.0,
        third_order_limit=0.0,
        bandwidth=ResponseCorner(1e6),
        high_pass=ResponseCorner(0.0),
    )
    noise = np.array([np.eye(2) * 1e-10] * 2)
    fit = fit_rate_ratios(rate, seen, noise, frequency, scale_factor=k, reference="beat", receiver=bench)
    # the ratio is 1/sqrt(1 + (2 pi f T)^2) of what it would be, T anywhere up to the lowest corner
    longest = float(frequency[0]) / lowest_gain_corner(float(frequency[0]))
    possible = np.sqrt(1 + (longest * np.linspace(0, 1, 10_001)) ** 2)
    assert fit.lock_in_rate_u / lock_in == pytest.approx(possible.std(), rel=0.03)
    assert abs(fit.lock_in_rate / lock_in - possible.mean()) < 0.2 * possible.std()
