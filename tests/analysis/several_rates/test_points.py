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


def test_a_line_in_time_is_found_where_there_are_two_times(gathered):
    points, place_of, data, weights = gathered
    other = weights[::-1]  # so that the means of these weights lie at other times
    value = (0.3 - 0.2j) + (2.0 + 1.0j) * data.when
    found, slope, total = points.lines([(data, other, value)])
    several = np.bincount(place_of) > 1
    assert slope[several] == pytest.approx(2.0 + 1.0j) and not slope[~several].any()
    assert found == pytest.approx((0.3 - 0.2j) + (2.0 + 1.0j) * points.points.when)
    assert total == pytest.approx(np.bincount(place_of, other))
