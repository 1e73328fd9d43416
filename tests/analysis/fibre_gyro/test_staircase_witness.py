"""The witness of the modulator staircase against records made by counter arithmetic, with the truth known."""

import numpy as np
import pytest
from scipy import stats

from analysis.fibre_gyro import describe_witness_flag, two_pi_error_of_drive, witness_staircase
from analysis.fibre_gyro.staircase import converter_spacing

SPAN = 8.0  # V for all codes of the converter
DT = 0.2e-6


def staircase(
    rng,
    *,
    samples_per_step=24.48,
    steps_per_ramp=23.7,
    levels=200,
    noise=0.5,
    bias=None,
    pole=0.0,
    ringing=0.0,
    falling=False,
    n=2500,
):
    """Volts (n,) of a modulo counter behind a converter of 16 bits, seen with eight bits, and the truth.

    The scope's levels number `levels` over the counter's span; `noise` is in these levels; `bias` is None, "added"
    or "wrapped"; `pole` and `ringing` (rad per sample) make the step response.
    """
    codes = 2**16
    step = round(codes / steps_per_ramp)
    k = np.arange(-3, int(n / samples_per_step) + 3)
    counter = step * k + int(rng.integers(codes))
    square = codes // 4 * (k % 2) if bias else 0 * k
    heights = np.mod(counter + square, codes) if bias == "wrapped" else np.mod(counter, codes) + square
    volts = (-1.0 if falling else 1.0) * heights * SPAN / codes
    since = np.arange(n)[:, np.newaxis] - (rng.uniform(0, samples_per_step) + samples_per_step * k)
    answer = np.where(since >= 0, 1.0, 0.0)
    if pole:
        late = np.maximum(since, 0)
        answer -= np.where(since >= 0, np.exp(-late / pole) * np.cos(ringing * late), 0.0)
    record = volts[0] + answer[:, 1:] @ np.diff(volts)
    level = SPAN / levels
    record = record + noise * level * rng.standard_normal(n)
    shift = rng.uniform(0, level)
    truth = {
        "step_height": (-1 if falling else 1) * step * SPAN / codes,
        "step_time": samples_per_step * DT,
        "two_pi_voltage": SPAN,
        "reset_height": SPAN - step * SPAN / codes,
        "bias_height": SPAN / 4 if bias else 0.0,
    }
    return np.round((record - shift) / level) * level + shift, truth


def vary(rng, options):
    """The same case with other fractions, so that no coincidence of the grid is tested again and again."""
    steps = options.get("steps_per_ramp", 23.7) * rng.uniform(0.95, 1.05)
    samples = options.get("samples_per_step", 24.48) * rng.uniform(0.98, 1.02)
    return options | {"steps_per_ramp": steps, "samples_per_step": samples}


CASES = {
    "plain": {},
    "no noise": {"noise": 0.0},
    "little noise": {"noise": 0.15},
    "much noise": {"noise": 2.0},
    "few samples": {"samples_per_step": 5.3, "steps_per_ramp": 60.0},
    "long steps": {"samples_per_step": 150.0, "steps_per_ramp": 6.4},
    "bias": {"bias": "added", "levels": 160},
    "bias wrapped, no noise": {"bias": "wrapped", "noise": 0.05},
    "settling": {"pole": 2.0},
    "ringing": {"pole": 2.0, "ringing": 1.5},
    "falling": {"falling": True},
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_intervals_cover_the_truth(case):
    rng = np.random.default_rng(list(CASES).index(case))
    runs = 8
    inside = dict.fromkeys(("step_height", "step_time", "two_pi_voltage", "reset_height", "bias_height"), 0)
    for _ in range(runs):
        volts, truth = staircase(rng, **vary(rng, CASES[case]))
        found = witness_staircase(volts, DT)
        for name in inside:
            error = abs(getattr(found, name) - truth[name])
            # Far outside is never right: a wrong period or a miscounted reset would be.
            assert error <= 6 * getattr(found, name + "_u") + 1e-12, name
            inside[name] += error <= 1.96 * getattr(found, name + "_u") + 1e-12
    least = stats.binom.ppf(1e-4, runs, 0.95)
    assert all(count >= least for count in inside.values()), inside


@pytest.mark.slow
def test_uncertainty_is_not_too_large():
    rng = np.random.default_rng(1)
    pulls, relative = [], []
    for _ in range(16):
        volts, _ = staircase(rng, **vary(rng, {}))
        found = witness_staircase(volts, DT)
        pulls.append((found.two_pi_voltage - SPAN) / found.two_pi_voltage_u)
        relative.append(found.two_pi_voltage_u / SPAN)
    assert 0.7 < np.sqrt(np.mean(np.square(pulls))) < 1.35
    # 200 levels over the span, 103 levels of 23 samples: a good part in ten thousand.
    assert np.median(relative) < 3e-4


@pytest.mark.slow
def test_settling_leaves_no_common_error():
    rng = np.random.default_rng(14)
    pulls = []
    for _ in range(16):
        volts, _ = staircase(rng, **vary(rng, {"pole": 2.0}))
        found = witness_staircase(volts, DT)
        pulls.append((found.two_pi_voltage - SPAN) / found.two_pi_voltage_u)
    # Sixteen scatter about their mean by a quarter; a tail cut off where it is no longer seen makes it -0.9.
    assert abs(np.mean(pulls)) < 0.6


@pytest.mark.slow
@pytest.mark.parametrize("samples", [25.0, 25.02])
@pytest.mark.parametrize("steps", [20.0, 20.05, 25.0])
def test_even_numbers_without_noise_are_not_trusted_too_much(samples, steps):
    """Every ramp is rounded the same way, so that averages gain nothing."""
    rng = np.random.default_rng(5)
    for _ in range(4):
        volts, truth = staircase(rng, samples_per_step=samples, steps_per_ramp=steps, noise=0.05)
        found = witness_staircase(volts, DT)
        for name in ("step_height", "step_time", "two_pi_voltage"):
            assert abs(getattr(found, name) - truth[name]) < 3 * getattr(found, name + "_u"), name


def test_what_is_told_beside_the_numbers():
    rng = np.random.default_rng(7)
    volts, truth = staircase(rng)
    found = witness_staircase(volts, DT)
    assert found.flags == () and found.bias_height == 0.0
    assert found.steps == pytest.approx(2500 / 24.48, abs=2)
    assert found.resets == pytest.approx(2500 / 24.48 / 23.7, abs=1)
    assert found.noise_rms == pytest.approx(0.5 * SPAN / 200, rel=0.2)
    assert found.two_pi_voltage == pytest.approx(found.reset_height + found.step_height)
    assert found.levels.shape == found.model.shape == found.times.shape
    assert np.abs(found.levels - found.model).max() < 0.03
    assert np.diff(found.times) == pytest.approx(truth["step_time"], rel=1e-3)
    settled = witness_staircase(staircase(rng, pole=2.0)[0], DT)
    assert 8 <= settled.settling_samples <= 16  # exp(-8 / 2) is two per cent


def test_gain_and_time_base_enter():
    volts, _ = staircase(np.random.default_rng(8))
    plain = witness_staircase(volts, DT)
    found = witness_staircase(volts, DT, gain_u=0.017, time_base_u=5e-5)
    assert found.two_pi_voltage_u == pytest.approx(np.hypot(0.017 * 8.0, plain.two_pi_voltage_u), rel=1e-3)
    assert found.step_time_u == pytest.approx(np.hypot(5e-5 * found.step_time, plain.step_time_u), rel=1e-3)
    assert found.reset_height_u > 0.017 * found.reset_height


def test_missing_samples_spikes_and_a_bent_converter():
    rng = np.random.default_rng(9)
    volts, _ = staircase(rng)
    holes = volts.copy()
    holes[400:520] = np.nan
    holes[rng.integers(0, 2500, 50)] = np.nan
    found = witness_staircase(holes, DT)
    assert abs(found.two_pi_voltage - SPAN) < 4 * found.two_pi_voltage_u
    spiked = volts.copy()
    spiked[[300, 900, 1500]] = SPAN
    found = witness_staircase(spiked, DT)
    assert abs(found.two_pi_voltage - SPAN) < 4 * found.two_pi_voltage_u
    bent = volts + 0.03 * np.sin(2 * np.pi * volts / SPAN)
    assert "misfit" in witness_staircase(bent, DT).flags


def test_flags():
    rng = np.random.default_rng(10)
    none = witness_staircase(staircase(rng, steps_per_ramp=2000.0, samples_per_step=60.0, levels=8000)[0], DT)
    if none.resets:  # the ramp may begin just below the end
        none = witness_staircase(staircase(rng, steps_per_ramp=2000.0, samples_per_step=60.0, levels=8000)[0], DT)
    assert none.flags == ("no_reset",)
    assert np.isnan(none.two_pi_voltage) and np.isnan(none.reset_height_u)
    assert abs(none.step_height - SPAN / 2000) < 4 * none.step_height_u + SPAN / 2**17
    assert "few_resets" in witness_staircase(staircase(rng, steps_per_ramp=70.0)[0], DT).flags
    assert "few_samples_per_step" in witness_staircase(staircase(rng, samples_per_step=4.4)[0], DT).flags
    slow = witness_staircase(staircase(rng, samples_per_step=40.0, steps_per_ramp=12.0, pole=5.0)[0], DT)
    assert "not_settled" in slow.flags
    for name in ("no_reset", "few_resets", "few_samples_per_step", "not_settled", "misfit"):
        assert describe_witness_flag(name).endswith(".")


def test_known_step_time_finds_steps_in_the_noise():
    rng = np.random.default_rng(11)
    for _ in range(5):
        volts, truth = staircase(rng, steps_per_ramp=60.0, noise=2.0)
        found = witness_staircase(volts, DT, step_time=truth["step_time"] * 1.01)
        assert abs(found.step_height - truth["step_height"]) < 4 * found.step_height_u
        assert abs(found.step_time - truth["step_time"]) < 4 * found.step_time_u


N = np.arange(2500)
NOISE = np.random.default_rng(12).standard_normal(2500)


@pytest.mark.parametrize(
    ("volts", "said"),
    [
        (np.round(3 * NOISE), "no steps stand out of the noise"),
        (np.zeros(2500), "all samples are equal"),
        (np.full(2500, np.nan), "valid samples"),
        (np.zeros((2, 2500)), "one dimension"),
        (np.where(N == 5, np.inf, N % 7), "infinite"),
        (np.round(np.mod(0.013 * N, 8) / 0.04) * 0.04, "moves on between the edges, like a ramp"),
        (np.where(N % 48 < 24, 0.0, 2.0) + 0.02 * NOISE, "neither rise nor fall"),
        (np.round(75 * np.sin(0.05 * N)), "."),
        (staircase(np.random.default_rng(1), steps_per_ramp=3.3)[0], "fewer than five steps lie between"),
        (staircase(np.random.default_rng(1), steps_per_ramp=2.3)[0], "fewer than five steps lie between"),
        (
            staircase(np.random.default_rng(1), samples_per_step=600.0)[0],
            "use fewer volts per division or a slower",
        ),
        (np.minimum(staircase(np.random.default_rng(2))[0], 6.0), "look at the signal and at the range"),
    ],
)
def test_what_is_no_staircase_is_refused(volts, said):
    with pytest.raises(ValueError, match=said) as caught:
        witness_staircase(volts, DT)
    assert "\n" not in str(caught.value)


def test_bad_arguments():
    volts, _ = staircase(np.random.default_rng(1))
    with pytest.raises(ValueError, match="sample_interval must be a positive"):
        witness_staircase(volts, 0.0)
    with pytest.raises(ValueError, match="lasts only 1 samples"):
        witness_staircase(volts, DT, step_time=DT)
    with pytest.raises(ValueError, match=r"holds only 2\.5 steps"):
        witness_staircase(volts, DT, step_time=1000 * DT)
    with pytest.raises(ValueError, match="half-wave voltage must be positive"):
        two_pi_error_of_drive(8.0, 0.1, 0.0)


def test_two_pi_error_by_hand():
    error, error_u = two_pi_error_of_drive(7.92, 0.0792, 4.0, 0.04)
    assert error == pytest.approx(-0.01)
    assert error_u == pytest.approx(0.99 * np.sqrt(2) * 0.01)


def test_spacing_of_a_converter():
    rng = np.random.default_rng(13)
    codes = np.array([3, 9, 24, 39, 3, 54])  # no two neighbours, greatest common divisor of the differences is 3
    assert converter_spacing(0.04 * codes + 0.0123) == pytest.approx(0.12)
    assert converter_spacing(0.04 * rng.integers(0, 250, 500)) == pytest.approx(0.04)
    assert converter_spacing(rng.standard_normal(500)) == 0.0
    assert converter_spacing(np.array([1.0, np.nan, 2.0])) == 0.0
