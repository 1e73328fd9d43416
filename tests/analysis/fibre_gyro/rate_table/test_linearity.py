"""Scale-factor error over a ladder of rates: terms that are there, and no others; nonlinearity freed of noise."""

import numpy as np
import pytest

from analysis.fibre_gyro import TableRuns, scale_linearity, table_runs

SIZES = np.array([5.0, 10.0, 20.0, 40.0, 60.0, 80.0])
RATES = np.tile(np.column_stack([SIZES, -SIZES]).ravel(), 2)
K, NOISE = 250.0, 0.02


def ladder(seed: int, *, cubic: float = 0.0, asymmetry: float = 0.0) -> TableRuns:
    shape = 1 + asymmetry / 2 * np.sign(RATES) + cubic * (RATES / 80.0) ** 2
    mean = K * RATES * shape + 3.0 + np.random.default_rng(seed).normal(0, NOISE, RATES.size)
    return table_runs(RATES, mean, NOISE, at_s=100.0 * np.arange(RATES.size))


def true_rms_ppm(*, cubic: float, asymmetry: float) -> float:
    """By plain least squares on the curve without noise."""
    rate = np.unique(RATES)
    curve = rate * (1 + asymmetry / 2 * np.sign(rate) + cubic * (rate / 80.0) ** 2)
    left = curve - np.polyval(np.polyfit(rate, curve, 1), rate)
    return 1e6 * float(np.sqrt(np.mean(left**2))) / 80.0


@pytest.mark.parametrize(
    ("truth", "terms"), [({}, ()), ({"cubic": 60e-6}, ("quadratic",)), ({"asymmetry": 60e-6}, ("asymmetry",))]
)
def test_the_data_choose_the_terms(truth: dict[str, float], terms: tuple[str, ...]) -> None:
    found = scale_linearity(ladder(1, **truth))
    assert found is not None and found.chosen == terms
    values = {"cubic": "quadratic", "asymmetry": "asymmetry"}
    for name, value in truth.items():
        term = values[name]
        assert found.value[term] == pytest.approx(1e6 * value, abs=5 * found.value_u[term])
        assert found.value_u[term] < 0.2e6 * value
    at = np.searchsorted(found.rate_dps, 80.0)
    if terms:
        assert abs(found.error_ppm[at]) > 5 * found.error_u_ppm[at]
    else:
        assert not found.error_ppm.any()


@pytest.mark.slow
@pytest.mark.parametrize("truth", [{"cubic": 0.0, "asymmetry": 0.0}, {"cubic": 20e-6, "asymmetry": 0.0}])
def test_the_nonlinearity_lies_in_its_interval(truth: dict[str, float]) -> None:
    """40 trials at 95 %: fewer than 29 once in a million."""
    rms, inside, largest = [], 0, 0
    true = true_rms_ppm(**truth)
    for seed in range(40):
        found = scale_linearity(ladder(seed, **truth))
        assert found is not None
        rms.append(found.rms_ppm)
        inside += found.rms_low_95_ppm <= true <= found.rms_high_95_ppm
        largest += found.largest_low_95_ppm <= 2.5 * true and true <= found.largest_high_95_ppm
    assert min(inside, largest) >= 29
    if truth["cubic"]:
        assert np.sqrt(np.mean(np.square(rms))) == pytest.approx(true, rel=0.1)
    else:
        # less than noise alone would show
        assert np.mean(rms) < 0.5 * 1e6 * NOISE / (80.0 * K)


def test_rates_close_to_each_other_are_no_ladder() -> None:
    near = np.array([20.0, -20.0, 20.1, -20.1, 21.0, -21.0])
    assert scale_linearity(table_runs(near, K * near, 0.01)) is None
    two = np.array([20.0, -20.0, 80.0, -80.0])
    assert scale_linearity(table_runs(two, K * two, 0.01)) is None
