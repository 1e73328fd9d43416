"""One rate, and a bench with something of which nobody said anything: U95 holds the truth all the same."""

import numpy as np
import pytest

from analysis import Flag
from analysis.lock_in_run import Batch, Method, RecordArrays, RunArrays, RunKnowledge, evaluate
from analysis.ring_laser import Detector, Gyro, Winking, detector_signal

K, WL, SAMPLES, PERIODS = 2000.0, 0.01, 2500, 18.3
BETA = 0.3
KNOWN = RunKnowledge(scale_factor=K, latitude_deg=28.2)


def bench_run(over, *, readout=0.35, records=6, gain_over_beat=0.0, pole_over_beat=0.0, k=K, **detector):
    """A run at `over` lock-in rates with the simulated gyro and its detector, rounded to levels of 1 %."""
    rate = over * WL
    beat = k * np.sqrt(rate**2 - WL**2)
    winking = Winking(k, WL, gain_over_beat * beat) if gain_over_beat else None
    if winking is not None:
        beat *= float(winking.frequency_factor(np.array([rate]))[0])
    gyro = Gyro(k, WL, BETA, 0.0, 0.0, winking=winking)
    seen = Detector(readout, low_pass_hz=pole_over_beat * beat, **detector)
    interval, rng = PERIODS / beat / SAMPLES, np.random.default_rng(7)
    turning = 2 * np.pi * beat * interval * np.arange(SAMPLES)
    starts = rng.uniform(0, 2 * np.pi, records)
    volts = np.array([detector_signal(gyro, seen, np.full(SAMPLES, rate), start + turning) for start in starts])
    volts = np.round((volts + 0.01 * rng.standard_normal(volts.shape)) * 100) / 100
    batch = Batch(np.arange(records), interval, volts[np.newaxis], np.zeros((1, *volts.shape), dtype=bool))
    nothing = [np.full(records, np.nan)] * 4
    slow = RecordArrays([batch], 1, np.full(records, SAMPLES), np.full(records, 0.01), *nothing)
    return RunArrays(slow, RecordArrays([], 1, np.array([], dtype=int), *(np.array([]) for _ in range(5))))


# what nobody stated, and by how much it spoils the lock-in rate
CASES = {
    "distortion raises it by 12 %": ({"second_order": 0.016, "readout": BETA + np.pi}, 0.10),
    "distortion lowers it by 12 %": ({"second_order": 0.016, "readout": BETA}, -0.10),
    "distortion at another phase": ({"second_order": -0.016, "readout": BETA + 1.0}, 0.04),
    "low pass at 5.5 beats": ({"pole_over_beat": 5.5}, -0.04),
    "gain corner at 3.2 beats": ({"gain_over_beat": 3.2}, -0.04),
    "third order": ({"third_order": 0.036, "readout": BETA}, -0.006),
    "scale factor off by 0.8 %": ({"k": 1.008 * K}, 0.005),
}


@pytest.mark.parametrize("case", CASES)
def test_the_truth_lies_inside_u95(case):
    bench, spoiled = CASES[case]
    found = evaluate(bench_run(8.0, **bench), KNOWN, Method(K))
    error = found.lock_in_rate / WL - 1
    # it is what the case says, and noise alone would have missed it, or the records show that something is wrong
    assert error / spoiled > 1
    assert abs(error) * WL > 2.5 * found.noise_u or int(found.combined.flags) & Flag.MISFIT
    low, high = found.interval_95
    assert low < WL < high
    # near zero the interval is no longer even to both sides
    even = found.budget.combined_u < 0.2 * found.lock_in_rate
    assert high - low == pytest.approx(2 * found.budget.expanded_u_95, rel=1e-3 if even else 0.1)


@pytest.mark.slow
@pytest.mark.parametrize("over", [3.0, 8.0, 20.0])
def test_all_of_them_together(over):
    bench = {"second_order": 0.012, "pole_over_beat": 7.0, "gain_over_beat": 5.0, "third_order": 0.02}
    for readout in (BETA, BETA + 1.3, BETA + np.pi):
        found = evaluate(bench_run(over, readout=readout, **bench), KNOWN, Method(K))
        low, high = found.interval_95
        assert low < WL < high


def test_each_record_alone_counts_the_same():
    found = evaluate(bench_run(8.0, **CASES["low pass at 5.5 beats"][0]), KNOWN, Method(K))
    low, high = found.record_intervals_95
    assert np.all((low < WL) & (high > WL))
    # the noise of all is the same; by chance a record may doubt itself for more than that
    assert np.all(found.record_u > 3 * np.median(found.each.lock_in_rate_u))


def test_a_third_harmonic_that_the_records_do_not_show_is_not_there():
    clean, cubic = (evaluate(bench_run(8.0, third_order=k), KNOWN, Method(K)) for k in (0.0, 0.036))
    limits = []
    for found in (clean, cubic):
        (line,) = [one for one in found.budget.inputs if one.name == "third_order"]
        assert line.stated
        limits.append(line.u * np.sqrt(3))
    assert limits[0] < 0.001
    # s + k s^3 has a third harmonic of k/4
    assert limits[1] == pytest.approx(0.009, abs=0.001)
