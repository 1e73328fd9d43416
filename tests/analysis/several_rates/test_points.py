"""What the means of records of one setting keep of when they were taken, against sums over the records."""

import numpy as np
import pytest

from analysis.several_rates.points import UsedRecords, gather, records_of_arrays

RATES = np.repeat([3.0, 7.0, 11.0, -7.0], [1, 2, 6, 3])


@pytest.fixture(scope="module")
def gathered():
    """Records of unequal weight: their points, and of each record its point, time and weight."""
    weights = np.random.default_rng(5).uniform(0.5, 2.0, RATES.size)
    covariance = np.eye(2) / weights[:, np.newaxis, np.newaxis]
    records = records_of_arrays(
        RATES, np.full(RATES.size, 0.1j), covariance, 2000 * np.abs(RATES), scale_factor=2000.0, in_order=True
    )
    points = gather(UsedRecords(records, np.ones(RATES.size, dtype=bool), np.zeros(RATES.size), "rate"))
    ((_, data, _),) = points.records.data()
    return points, points.places[data], data, weights


def test_two_times_stand_for_all(gathered):
    points, place_of, data, weights = gathered
    for place in range(len(points.places)):
        here = place_of == place
        mean = np.average(data.when[here], weights=weights[here])
        assert points.points.when[place] == pytest.approx(mean)
        for power in range(4):
            wanted = np.average((data.when[here] - mean) ** power, weights=weights[here])
            told = points.beside_weights[:, place] @ points.beside[:, place] ** power
            assert told == pytest.approx(wanted, abs=1e-9)


def test_a_curve_in_time_is_found_where_there_are_times_for_it(gathered):
    points, place_of, data, weights = gathered
    other = weights[::-1]  # so that the means of these weights lie at other times
    value = (0.3 - 0.2j) + (2.0 + 1.0j) * data.when + (-0.7 + 3.0j) * data.when**2
    curve, total, numbers = points.curves([(data, other, value)])
    several = np.bincount(place_of) > 2
    assert points.on_curves(curve, data)[several[place_of]] == pytest.approx(value[several[place_of]])
    assert total == pytest.approx(np.bincount(place_of, other))
    assert numbers == np.minimum(np.bincount(place_of), 3).sum() == np.count_nonzero(curve)
    # the mean over the times of all records is that of two times
    whole = np.sum(points.beside_weights * (points.points.when + points.beside) ** 2, axis=0)
    mean = (0.3 - 0.2j) + (2.0 + 1.0j) * points.points.when + (-0.7 + 3.0j) * whole
    assert several.any() and (curve[:, 0] + curve[:, 2])[several] == pytest.approx(mean[several], abs=0.01)


@pytest.mark.parametrize("noise", [1.0, 2.0])
@pytest.mark.parametrize("step", [0.0, 0.03])
def test_what_turns_is_no_scatter(noise, step):
    rng, rate, u = np.random.default_rng(7), np.repeat([3.0, 7.0, 11.0, 20.0, -7.0], 24), 3e-4
    scattered = noise * u * (rng.standard_normal(rate.size) + 1j * rng.standard_normal(rate.size))
    turning = np.exp(1j * step * np.arange(rate.size) * (1 + 0.01 * np.arange(rate.size)))
    records = records_of_arrays(
        rate, 0.1 * turning + scattered, u**2 * np.eye(2), 2000 * np.abs(rate), scale_factor=2000.0, in_order=True
    )
    points = gather(UsedRecords(records, np.ones(rate.size, dtype=bool), np.zeros(rate.size), "rate"))
    steady = np.zeros((1, 10))
    (found, degrees), (about_means, more) = points.scatter(steady, turning=True), points.scatter(steady)
    assert 0 < degrees < more
    assert found / degrees == pytest.approx(noise**2, abs=4 * noise**2 * np.sqrt(2 / degrees))
    assert (about_means > 100 * more) == (step > 0)
