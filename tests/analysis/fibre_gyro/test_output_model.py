"""The output-level model against the loop at every transit time: mean, spread, correlation, settling, falls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from analysis.fibre_gyro import ClosedLoop, FibreCoil, LoopDesign, OutputBlock, OutputModel

COIL = FibreCoil()
K0 = 246.152866
PERIOD, OUTPUTS, RUNS = 1e-3, 60, 8
BUILDS = {
    "plain": LoopDesign(),
    "gated": LoopDesign(two_pi_error=0.01),
    "all samples": LoopDesign(two_pi_error=0.01, gated=False),
    "second electrode": LoopDesign(two_pi_error=0.003, injection_path="separate", injection_two_pi_error=-0.002),
    "second electrode, all samples": LoopDesign(
        two_pi_error=0.003, injection_path="separate", injection_two_pi_error=-0.02, gated=False
    ),
    "wide wrap": LoopDesign(wrap_codes=66_000, gated=False),
    "coarse": LoopDesign(dac_bits=14, fractional_bits=0, adc_bits=11, loop_gain=0.5),
    "dim": LoopDesign(contrast=0.8, light_level=0.7, bias_dph=3600.0),
}
DRIVES = {"fast": (20.0, 0.0), "slow": (0.3, 50.0), "backward": (-3.0, -500.0)}


def settled(gyro: ClosedLoop | OutputModel, rate: float, step: float) -> OutputBlock:
    gyro.run(3, output_period_s=PERIOD, rate_dps=rate, injected_step=step)
    return gyro.run(OUTPUTS, output_period_s=PERIOD, rate_dps=rate, injected_step=step)


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("name", BUILDS)
def test_model_has_mean_spread_and_correlation_of_the_loop(name: str, drive: str) -> None:
    rate, step = DRIVES[drive]
    loop = settled(ClosedLoop(COIL, BUILDS[name], seed=1, runs=RUNS), rate, step)
    # the model is cheap: enough of it that only the loop's own statistics count
    model = settled(OutputModel(COIL, BUILDS[name], seed=2, runs=50 * RUNS), rate, step)
    seen, expected = (block.counts for block in (loop, model))
    spread = float(expected.std(axis=1).mean())
    of_means = float(expected.mean(axis=1).std(ddof=1)) / np.sqrt(RUNS)
    assert seen.mean() == pytest.approx(expected.mean(), abs=4 * of_means + 3e-6 * abs(rate) * K0)
    # 480 words: 3.2 %
    assert float(seen.std(axis=1).mean()) == pytest.approx(spread, rel=0.13)
    assert correlation(seen) == pytest.approx(correlation(expected), abs=0.2)
    falls = loop.reset_pairs.sum(axis=1).mean()
    # falls of both electrodes in one pair count once in the loop
    assert falls == pytest.approx(model.reset_pairs.sum(axis=1).mean(), abs=1.5, rel=0.02)


def test_spread_of_short_outputs_and_of_many_falls() -> None:
    """Thirty pairs: the end of the loop's memory counts. At 40 deg/s three of ten pairs hold a fall."""
    spread = {}
    for kind in (ClosedLoop, OutputModel):
        gyro = kind(COIL, LoopDesign(), seed=7, runs=RUNS)
        for rate in (0.5, 40.0):
            gyro.run(3, output_period_s=3e-4, rate_dps=rate)
            words = gyro.run(600, output_period_s=3e-4, rate_dps=rate).counts
            spread[kind, rate] = float(words.std(axis=1).mean())
    for rate in (0.5, 40.0):
        # 4800 words each: 1.5 %
        assert spread[ClosedLoop, rate] == pytest.approx(spread[OutputModel, rate], rel=0.05)
    # where the loop holds its step, pairs are lost
    assert spread[ClosedLoop, 40.0] > 1.1 * spread[ClosedLoop, 0.5]


def correlation(words: np.ndarray) -> float:
    left = words - words.mean(axis=1, keepdims=True)
    return float((left[:, 1:] * left[:, :-1]).sum() / (left**2).sum())


def test_model_settles_like_the_loop() -> None:
    design = LoopDesign(angle_random_walk_deg_per_sqrt_h=1e-4)
    words = []
    for kind in (ClosedLoop, OutputModel):
        gyro = kind(COIL, design, seed=3)
        first = gyro.run(2, output_period_s=PERIOD, rate_dps=1.0)
        words.append(
            [*first.counts, *gyro.run(2, output_period_s=PERIOD, rate_dps=-2.0, injected_step=100.0).counts]
        )
    np.testing.assert_allclose(words[1], words[0], rtol=0.01)
    assert abs(words[0][0] / K0 - 1) > 0.03  # there is something to settle


def test_model_held_gives_the_errors_of_the_held_loop() -> None:
    design = LoopDesign(two_pi_error=0.004, gated=False)
    means = {}
    for kind in (ClosedLoop, OutputModel):
        gyro = kind(COIL, design, seed=4)
        block = gyro.run(40, output_period_s=2e-3, rate_dps=0.003, injected_step=-5001.0, closed=False)
        assert np.all(block.counts == 0.0)
        errors = (block.normal_error, block.reset_error)
        means[kind] = [(float(e.mean()), float(e.std(ddof=1)) / np.sqrt(e.size)) for e in errors]
        assert block.reset_pairs.sum() == pytest.approx(0.08 / COIL.transit_time * 5001 / 65536, rel=0.01)
    for (loop, loop_u), (model, model_u) in zip(means[ClosedLoop], means[OutputModel], strict=True):
        assert loop == pytest.approx(model, abs=4 * np.hypot(loop_u, model_u))
        assert loop_u == pytest.approx(model_u, rel=0.5)
    # the 2 pi error is in the difference of the two: 2 pi 0.004 A of it
    difference = means[ClosedLoop][1][0] - means[ClosedLoop][0][0]
    assert abs(difference) == pytest.approx(2 * np.pi * 0.004 * 8192 * np.cos(2 * np.pi * 5001 / 65536), rel=0.03)


def test_noise_of_a_long_run_is_the_angle_random_walk() -> None:
    """0.005 deg/sqrt(h) over 540 s: 0.005/60/sqrt(540) = 3.59e-6 deg/s."""
    gyro = OutputModel(COIL, LoopDesign(), seed=5, runs=200)
    gyro.run(1)
    means = gyro.run(540, output_period_s=1.0).counts.mean(axis=1) / K0
    assert means.std(ddof=1) == pytest.approx(3.59e-6, rel=0.15)  # of 200: 5 %
    assert means.mean() == pytest.approx(0.0, abs=4 * 3.59e-6 / np.sqrt(200))


def test_rounding_does_not_add_up() -> None:
    design = LoopDesign(fractional_bits=0, adc_bits=24, angle_random_walk_deg_per_sqrt_h=0.0)
    gyro = OutputModel(COIL, design)
    gyro.run(1)
    words = np.concatenate([gyro.run(1, rate_dps=0.01234).counts for _ in range(1000)])
    assert np.ptp(words * 1021) > 0.5  # rounded to a code in a sample pair
    # half a code in each would be 5e-4
    assert words.mean() == pytest.approx(0.01234 * K0, abs=1e-4)


def test_time_can_be_cut_and_runs_have_noise_of_their_own() -> None:
    design = LoopDesign(two_pi_error=0.01, gated=False)
    whole = OutputModel(COIL, design, seed=6).run(30, rate_dps=1.0)
    cut = OutputModel(COIL, design, seed=6, runs=2)
    parts = [cut.run(n, rate_dps=1.0) for n in (7, 1, 22)]
    np.testing.assert_allclose(np.concatenate([p.counts[0] for p in parts]), whole.counts, rtol=0, atol=1e-6)
    np.testing.assert_allclose(np.concatenate([p.times_s for p in parts]), whole.times_s)
    assert np.all(np.concatenate([p.counts[1] for p in parts]) != whole.counts)


def test_moving_rate_is_averaged_over_each_output() -> None:
    quiet = replace(LoopDesign(), angle_random_walk_deg_per_sqrt_h=0.0)
    moving = OutputModel(COIL, quiet).run(50, rate_dps=lambda t: 3.0 + 2.0 * t - t**2)
    edges = np.arange(51) * 0.01
    integral = 3.0 * edges + edges**2 - edges**3 / 3
    np.testing.assert_allclose(moving.counts[1:] / K0, np.diff(integral)[1:] / 0.01, atol=2e-4)


def test_rate_beyond_the_fringe_is_refused() -> None:
    with pytest.raises(ValueError, match=r"within 133.*another fringe"):
        OutputModel(COIL, LoopDesign()).run(3, rate_dps=134.0)
    with pytest.raises(ValueError, match="number of runs"):
        OutputModel(COIL, LoopDesign(), runs=0)
