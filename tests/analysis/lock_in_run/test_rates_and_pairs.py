"""A run at several rates, and one with two photodiodes."""

from dataclasses import replace

import numpy as np
import pytest
from array_bench import (
    KNOWN,
    PHASE,
    WL,
    Gyro,
    K,
    axis_rate,
    interval_at,
    no_records,
    records,
    table_rate_for,
    whole_run,
)

from analysis.arrays import OneRateOnly, OutsideResponse
from analysis.budget import BenchKnowledge, ResponseCorner
from analysis.channel import ChannelResponse
from analysis.lock_in_run import Batch, Method, RunArrays, evaluate
from analysis.lockin_equation import harmonic_ratio, lock_in_from_beat

PLAIN = Method(K)
SENSES = [0.05, 0.05, 0.16, 0.16, -0.05, -0.05, -0.16, -0.16]


def bench(seed=5, **more):
    return Gyro(np.random.default_rng(seed), **{"noise": 0.002, **more})


@pytest.mark.slow
def test_one_fit_frees_the_rates_of_distortion():
    square = 0.004
    found = evaluate(whole_run(bench(square=square), SENSES), KNOWN, PLAIN)
    several = found.several
    assert [group.over_lock_in for group in several.groups] == [16.0, 5.0, 5.0, 16.0]
    assert [group.rows.tolist() for group in several.groups] == [[2, 3], [0, 1], [4, 5], [6, 7]]
    for group in several.groups:
        assert group.input_rate == pytest.approx(axis_rate(group.table_rate), rel=1e-4)
        # -r exp(-+ i phase) and what the receiver adds to it, by hand
        sense = np.sign(group.input_rate)
        seen = abs(-harmonic_ratio(WL / abs(group.input_rate)) * np.exp(-1j * sense * PHASE) * sense + square)
        alone = lock_in_from_beat(seen, np.sqrt(group.input_rate**2 - WL**2))
        assert float(group.combined.lock_in_rate) == pytest.approx(float(alone), rel=0.02)
        assert abs(float(group.combined.lock_in_rate) - WL) > 5 * float(group.combined.lock_in_rate_u)
    assert abs(float(found.combined.lock_in_rate) - WL) < 4 * float(found.combined.lock_in_rate_u)
    assert several.by_beat.distortion == pytest.approx(square, rel=0.05)
    assert several.by_frequency.scale_factor == pytest.approx(K, rel=1e-3)
    assert int(found.combined.records) == 8
    assert found.table_check.beat_over_table == pytest.approx(1.0, abs=1e-3)
    assert several.reference_group is min(
        several.groups, key=lambda g: float(g.combined.lock_in_rate_u / g.combined.lock_in_rate)
    )


@pytest.mark.slow
def test_what_is_common_to_the_rates_goes_through_the_fit_unchanged():
    stated = BenchKnowledge(scale_factor_u_ppm=100.0, distortion_limit=0.01, bandwidth=ResponseCorner(5000.0))
    known = replace(KNOWN, bench=stated)

    def evaluated(k=K):
        return evaluate(whole_run(bench(square=0.004), SENSES), known, Method(k))

    found, step = evaluated(), 1e-4
    lines = {line.name: line for line in found.budget.inputs}
    value = float(found.combined.lock_in_rate)
    by_scale = (float(evaluated(K * (1 + step)).combined.lock_in_rate) - value) / (K * step)
    assert lines["scale_factor"].sensitivity == pytest.approx(by_scale, rel=0.01)
    assert lines["distortion"].contribution == 0
    assert np.hypot(lines["noise"].u, lines["separation"].u) == pytest.approx(
        float(found.combined.lock_in_rate_u), rel=1e-9
    )
    assert "scatter" not in lines and "quantization" not in lines
    assert [one.name for one in found.budget.not_stated] == ["high_pass"]
    assert "gain_corner" in lines


@pytest.mark.slow
def test_a_pole_that_nobody_stated_is_found_and_taken_out():
    """A corner at three times the slowest beat takes 4 % of the ratio there; the fit has it as an unknown."""
    corner = 2000.0
    filtered = whole_run(bench(noise=1e-4, pole_hz=corner), SENSES)
    seen = evaluate(filtered, KNOWN, PLAIN)
    fit = seen.several.by_beat
    assert fit.lock_in_rate == pytest.approx(WL, abs=4 * fit.lock_in_rate_u)
    blind = next(model.lock_in_rate for model in fit.models if model.model == "both")
    assert abs(blind / WL - 1) > 0.001
    line = {line.name: line for line in seen.budget.inputs}["bandwidth"]
    assert line.contribution == 0 and "bandwidth" in fit.counted
    corrected = evaluate(filtered, replace(KNOWN, response=ChannelResponse(low_pass_hz=[corner])), PLAIN)
    assert float(corrected.combined.lock_in_rate) == pytest.approx(WL, rel=2e-3)
    assert "corrected for the response of the channel" in corrected.each.noise_model


@pytest.mark.slow
def test_more_records_at_an_azimuth_do_not_tell_it_better():
    def by_table(count):
        slow = [table_rate_for(rate) for rate in (0.05, 0.16, -0.05, -0.16) for _ in range(count)]
        run = whole_run(bench(noise=1e-4), [0.05])
        around = records(bench(noise=1e-4), slow, azimuths=np.full(4 * count, 90.0), turned=20.0)
        found = evaluate(replace(run, slow=around), KNOWN, PLAIN).several.by_table
        return next(model.lock_in_rate_u for model in found.models if model.model == "both")

    assert by_table(4) == pytest.approx(by_table(1), rel=0.1)


@pytest.mark.slow
def test_a_corner_that_is_stated_tells_the_fit_what_it_need_not_find():
    """The better the corner is known, the smaller the uncertainty of the fit, which holds it."""
    corner = 2000.0
    filtered = whole_run(bench(noise=1e-2, pole_hz=corner), SENSES)
    fast = {"gain": ResponseCorner(np.inf)}  # two rates tell a slow gain from a phase between the senses poorly

    def u(stated):
        known = replace(KNOWN, response=ChannelResponse(low_pass_hz=[corner]))
        found = evaluate(filtered, replace(known, bench=BenchKnowledge(bandwidth=stated, **fast)), PLAIN)
        assert {line.name: line for line in found.budget.inputs}["bandwidth"].contribution == 0
        return found.several.by_beat.lock_in_rate_u

    assert u(ResponseCorner(corner, 10.0, True)) < u(ResponseCorner(corner, 200.0, True)) < u(ResponseCorner())


@pytest.mark.parametrize("method", [Method(K, input_rate=0.05), Method(K, relation="paper-13")])
def test_a_method_for_one_rate_is_refused(method):
    with pytest.raises(OneRateOnly, match="several rates"):
        evaluate(whole_run(bench(), SENSES), KNOWN, method)


def test_one_rate_with_a_beat_and_one_without_are_no_fit():
    run = whole_run(bench(), [0.05, 0.05, 0.16])
    silent = [replace(batch, volts=0 * batch.volts) if 2 in batch.rows else batch for batch in run.slow.batches]
    found = evaluate(replace(run, slow=replace(run.slow, batches=silent)), KNOWN, PLAIN)
    assert len(found.several.groups) == 2
    assert found.several.by_beat is None and found.several.by_frequency is None
    assert "take the other sense" in found.several.problem
    assert not found.usable
    assert found.budget is None


def two_channels(gyro, count):
    """Sine and cosine of one beat (readout phases 0 and 90 deg) at 0.08 deg/s."""
    rate = 0.08
    interval = interval_at(rate, 60.3)
    volts = np.stack([gyro.volts(rate, interval, (0.0, np.pi / 2)) for _ in range(count)], axis=1)
    slow = records(gyro, [table_rate_for(rate)] * count)
    batch = Batch(np.arange(count), interval, volts, np.zeros(volts.shape, dtype=bool))
    return RunArrays(replace(slow, batches=[batch], n_channels=2), no_records())


def test_two_photodiodes_correct_each_other():
    square = 0.004
    run = two_channels(bench(square=square), 6)
    found = evaluate(run, KNOWN, PLAIN)
    pairs = found.quadratures
    assert (pairs.records, pairs.sense, pairs.flags) == (6, 1, ())
    assert pairs.gain_ratio == pytest.approx(1.0, abs=5e-4)
    assert pairs.phase_error == pytest.approx(0.0, abs=5e-4)
    assert pairs.distortion == pytest.approx((square, square), abs=3e-4)
    seen = abs(-harmonic_ratio(WL / 0.08) * np.exp(-1j * PHASE) + square)
    assert pairs.sine_alone == pytest.approx(float(lock_in_from_beat(seen, np.sqrt(0.08**2 - WL**2))), rel=0.01)
    assert abs(float(found.combined.lock_in_rate) - WL) < 4 * float(found.combined.lock_in_rate_u)
    (distortion,) = [line for line in found.budget.inputs if line.name == "distortion"]
    assert distortion.contribution == 0
    alone = evaluate(replace(run, slow=replace(run.slow, n_channels=1)), KNOWN, PLAIN)
    assert alone.quadratures is None
    assert float(alone.combined.lock_in_rate) == pytest.approx(pairs.sine_alone, rel=1e-3)


def test_no_pair_that_can_be_used_is_no_mean():
    run = two_channels(bench(), 2)
    (batch,) = run.slow.batches
    flat = replace(batch, volts=0 * batch.volts)
    found = evaluate(replace(run, slow=replace(run.slow, batches=[flat])), None, PLAIN)
    assert found.quadratures is None and not found.usable


def table_of_pole(corner, low, high):
    points = np.geomspace(low, high, 40)
    response = 1 / (1 + 1j * points / corner)
    return ChannelResponse(table_hz=points, table_gain=np.abs(response), table_phase_rad=np.angle(response))


@pytest.mark.parametrize("channels", [1, 2])
def test_a_second_harmonic_outside_the_measured_response_is_named(channels):
    run = two_channels(bench(), 2)
    run = replace(run, slow=replace(run.slow, n_channels=channels))
    known = replace(KNOWN, response=table_of_pole(1000.0, 20.0, 250.0))
    with pytest.raises(OutsideResponse, match=r"317\.\d+ Hz"):
        evaluate(run, known, PLAIN)


def test_the_channel_is_taken_out_before_the_pairs_are_compared():
    plain, filtered = (two_channels(bench(seed=7, pole_hz=pole), 4) for pole in (np.inf, 400.0))
    uncorrected = evaluate(filtered, KNOWN, PLAIN)
    known = replace(KNOWN, response=table_of_pole(400.0, 20.0, 5000.0))
    corrected = evaluate(filtered, known, PLAIN)
    assert abs(float(uncorrected.combined.lock_in_rate) / WL - 1) > 0.05
    assert float(corrected.combined.lock_in_rate) == pytest.approx(WL, rel=0.01)
    assert "corrected for the response" in corrected.each.noise_model
    assert float(evaluate(plain, KNOWN, PLAIN).combined.lock_in_rate) == pytest.approx(WL, rel=0.01)
