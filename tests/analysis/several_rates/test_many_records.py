"""Records that are read some at a time: nothing depends on how many, and little is held of each."""

import itertools
import tracemalloc

import numpy as np
import pytest
from bench_signals import both_senses, estimates

from analysis import LockInEstimate, fit_rate_ratios, fit_rates
from analysis.flags import Flag
from analysis.lock_in_run import joined
from analysis.several_rates.points import first_of_groups, groups_of

AT_ONCE = "analysis.several_rates.points.AT_ONCE"


@pytest.fixture(scope="module")
def records() -> LockInEstimate:
    """Six rates, one after the other, eight records each; two of them show no beat."""
    parts = estimates(both_senses(3, 8, 20), 8, np.random.default_rng(1), hd2=0.005, noise=0.02)
    ends = itertools.pairwise(range(0, 49, 8))
    whole = joined(parts, [np.arange(*some) for some in ends])
    whole.flags[[5, 40]] |= int(Flag.NO_BEAT)
    return whole


@pytest.mark.parametrize(("given", "reference"), [("one", "rate"), ("several", "beat"), ("arrays", "rate")])
def test_some_at_a_time_say_what_all_say(
    records: LockInEstimate, reference: str, given: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fit():
        if given == "arrays":
            ratios = records.complex_ratio, records.complex_ratio_covariance, records.beat_frequency
            return fit_rate_ratios(
                records.input_rate, *ratios, scale_factor=records.scale_factor, reference=reference
            )
        return fit_rates(records if given == "one" else [records[:11], records[11:]], reference=reference)

    at_once = fit()
    monkeypatch.setattr(AT_ONCE, 5)
    by_fives = fit()
    for name in ("lock_in_rate", "lock_in_rate_u", "lock_in_rate_low_95", "chi_square", "p_value", "distortion"):
        assert getattr(by_fives, name) == pytest.approx(getattr(at_once, name), rel=1e-6)
    assert by_fives.flags == at_once.flags
    assert by_fives.degrees_of_freedom == at_once.degrees_of_freedom
    for name in ("rate", "ratio", "used", "locked"):
        np.testing.assert_array_equal(getattr(by_fives, name), getattr(at_once, name))
    for name in ("residual", "deviation", "rate_mismatch"):
        np.testing.assert_allclose(getattr(by_fives, name), getattr(at_once, name), rtol=1e-5, atol=1e-9)


@pytest.mark.slow
def test_a_fit_holds_little_of_each_record(records: LockInEstimate, monkeypatch: pytest.MonkeyPatch) -> None:
    def traced(some: LockInEstimate) -> tuple[int, int]:
        """Bytes that a fit leaves behind, and takes at most, with the rates of its records."""
        rates = some.input_rate
        tracemalloc.start()
        fit = fit_rates(some, input_rate=rates, in_order=False)
        assert fit.used.sum() == len(some) * 46 // 48
        taken = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return taken

    monkeypatch.setattr(AT_ONCE, 500)
    many = records[np.repeat(np.arange(48), 250)]
    few = many[::4]  # what the fit itself takes is the same
    held_of_few, most_of_few = traced(few)
    held, most = traced(many)
    assert held - held_of_few < 8 * (len(many) - len(few))
    assert most - most_of_few < 40 * (len(many) - len(few))


def test_neighbours_within_a_share_are_one_group_however_they_come() -> None:
    rng = np.random.default_rng(2)
    sizes = np.exp(rng.uniform(0, 3, 300))
    rising = np.sort(sizes)
    # slowly: a value begins a group where the one before it is further away than its share
    first = [b for a, b in zip([0.0, *rising], rising, strict=False) if b - a > 0.01 * b]
    assert 20 < len(first) < 280
    for count in (300, 7, 1):
        parts = [sizes[begin : begin + count] for begin in range(0, 300, count)]
        np.testing.assert_array_equal(first_of_groups(parts, 0.01), first)
    places = groups_of(sizes, np.array(first))
    assert [rising[0], *np.array(first)[1:]] == [sizes[places == place].min() for place in range(len(first))]
