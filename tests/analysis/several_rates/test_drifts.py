"""A phase that turns and a lock-in rate that drifts over a run: found and removed, or counted."""

import numpy as np
import pytest

from analysis import RatesFlag, beat_signal, estimate_lock_in, fit_rates
from analysis.budget import BenchKnowledge
from analysis.plan import run_order
from benchmarks.several_rates.__main__ import DEFAULT, LOCK_IN, NOISE, drawn

DOWN_AND_UP = tuple(rate for rate, _ in run_order([3, 5.3, 9.5, 17, 30]))
RUNS = {"default": (DEFAULT, 4), "one sense": (DOWN_AND_UP, 4), "one rate": ((8, -8, -8, 8), 5)}


def pulls(run, seed, in_order=True, receiver=None, **drifts):
    """Deviations in standard uncertainties of ten benches with the same drifts, and the fits."""
    rates, records = RUNS[run]
    rng = np.random.default_rng(seed)
    fits = [
        drawn(rates, records, turn, NOISE, rng, in_order=in_order, receiver=receiver, **drifts)
        for turn in rng.uniform(0, 2 * np.pi, 10)
    ]
    return np.array([(fit.lock_in_rate - LOCK_IN) / fit.lock_in_rate_u for fit in fits]), fits


@pytest.mark.slow
@pytest.mark.parametrize(
    ("run", "drifts"),
    [
        pytest.param("default", {"turned": 2.0}, marks=pytest.mark.slow),
        ("default", {"turned": -0.7, "bent": 0.3, "between_senses": 0.3}),
        ("default", {"drift": 0.02}),
        ("one sense", {"drift": -0.02}),
        pytest.param("one sense", {"turned": 0.5}, marks=pytest.mark.slow),
        pytest.param("one rate", {"between_senses": 0.2}, marks=pytest.mark.slow),
        ("one rate", {"between_senses": 1.0}),
        ("one rate", {"turned": 0.5}),
    ],
)
def test_what_drifts_is_found_or_counted(run, drifts):
    found, fits = pulls(run, 4, **drifts)
    assert np.sum(found**2) < 30  # of ten: chance goes beyond in one of a thousand
    assert sum(bool(fit.flags & (RatesFlag.MISFIT | RatesFlag.ONE_RATE_DISAGREES)) for fit in fits) <= 1
    for fit in fits:
        if run == "one sense" and "drift" in drifts:
            assert abs(fit.lock_in_drift - drifts["drift"]) < 5 * fit.lock_in_drift_u < 0.1
        elif run == "default" and "turned" in drifts:
            assert abs(fit.phase_drift - drifts["turned"]) < 5 * fit.phase_drift_u < 1.0


@pytest.mark.slow
def test_a_drift_that_hardly_shows_counts_in_most_runs():
    """A drift of two of its standard uncertainties: where it is left out the runs are too sure."""
    _, fits = pulls("default", 8, drift=0.024)
    assert sum(fit.lock_in_drift_u > 0 for fit in fits) > 5
    for fit in fits:
        assert fit.lock_in_drift_u == 0 or abs(fit.lock_in_drift - 0.024) < 3 * fit.lock_in_drift_u < 0.05


@pytest.mark.slow
def test_the_order_of_a_run_costs_nothing_where_nothing_drifts():
    """The slow rates stand in the middle of the default run: its uncertainty is that of steady lasers."""
    _, drifting = pulls("default", 5)
    steady = BenchKnowledge(third_order_limit=0.01, phase_change_limit=0.0, lock_in_drift_limit=0.0)
    _, known = pulls("default", 5, receiver=steady)
    us = [[fit.lock_in_rate_u for fit in fits] for fits in (drifting, known)]
    assert np.mean(us[0]) < 1.05 * np.mean(us[1])


def test_a_drift_that_only_beats_show_counts_even_where_it_was_stated_away():
    """One sense, from the fastest rate to the slowest only: in the ratios a drift looks like distortion."""
    rng = np.random.default_rng(6)
    rates = (30, 17, 9.5, 5.3, 3)
    counted, ignored = (
        drawn(rates, 8, 1.0, NOISE, rng, in_order=True, receiver=receiver, drift=0.02)
        for receiver in (None, BenchKnowledge(third_order_limit=0.01, lock_in_drift_limit=1e-6))
    )
    assert abs(counted.lock_in_rate - LOCK_IN) < 2.5 * counted.lock_in_rate_u
    assert abs(ignored.lock_in_rate - LOCK_IN) < 2.5 * ignored.lock_in_rate_u
    assert ignored.flags & RatesFlag.MISFIT


@pytest.mark.slow
def test_records_without_an_order_are_asked_for_drifts_only_where_they_do_not_fit():
    """The phase of `fit_rates` and the like: nobody says that an array of records has an order."""
    found, fits = pulls("default", 7, in_order=False, turned=1.0)
    assert all(fit.flags & RatesFlag.MISFIT for fit in fits)  # plain arrays: taken at their word
    assert np.max(np.abs(found)) < 5  # and widened


@pytest.mark.parametrize(("turned", "in_order"), [(1.0, None), (1.0, False), (0.0, None)])
def test_estimates_whose_records_differ_are_asked_for_drifts(turned, in_order):
    """Three rates in both senses, four records each, made as volts; the backscatter turns by so much over them."""
    rng = np.random.default_rng(8)
    rates = np.repeat([12, 6, 3, -3, -6, -12], 4) * 0.01
    each = []
    for rate, phase in zip(rates, np.linspace(0.3, 0.3 + turned, rates.size), strict=True):
        interval = 20.3 / 2500 / (2000 * np.sqrt(rate**2 - 0.01**2))
        beat = beat_signal(
            np.arange(2500) * interval,
            scale_factor=2000,
            input_rate=rate,
            lock_in_rate=0.01,
            backscatter_phase=phase,
            initial_phase=rng.uniform(0, 6),
        )
        volts = beat + 0.01 * rng.normal(size=2500)
        each.append(estimate_lock_in(volts, interval, scale_factor=2000, input_rate=rate))
    fit = fit_rates(each, in_order=in_order)
    assert bool(fit.flags & RatesFlag.MISFIT) == (in_order is False)
    if in_order is None:
        assert abs(fit.lock_in_rate - 0.01) < 4 * fit.lock_in_rate_u < 1e-4
        assert abs(fit.phase_drift - turned) < (5 * fit.phase_drift_u if turned else 1e-9)
