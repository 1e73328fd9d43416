"""Time bases and rates that keep a beat's harmonics off those of the mains."""

import math

import numpy as np
import pytest

from analysis import estimate_lock_in
from analysis.lockin_rate import MAINS_HZ
from analysis.plan import CLEAR_OF_MAINS, OscilloscopeSteps, mains_clearance, off_mains

STEPS = OscilloscopeSteps(
    time_bases=tuple(float(f"{m}e{d}") for d in range(-9, 2) for m in (1, 2.5, 5)), vertical_scales=(1.0,)
)
K, WL = 2000.0, 0.01


def beside(frequency: float, duration: float, mains: float, harmonics: tuple[int, ...] = (1, 2, 3)) -> bool:
    """The slow way: whether one of the harmonics lies within three widths of a line of the mains."""
    return any(
        abs(harmonic * frequency - order * mains) < CLEAR_OF_MAINS / duration
        for harmonic in harmonics
        for order in range(1, 7)
    )


def test_clearance_is_what_the_slow_way_says() -> None:
    random = np.random.default_rng(5)
    for frequency, duration in zip(random.uniform(5, 500, 300), random.uniform(0.05, 2, 300), strict=True):
        for mains in MAINS_HZ:
            clear = mains_clearance(frequency, duration, (mains,)) >= CLEAR_OF_MAINS
            assert clear != beside(frequency, duration, mains)
        # nobody said which of the two: the second harmonic keeps off both
        clear = mains_clearance(frequency, duration, MAINS_HZ) >= CLEAR_OF_MAINS
        assert clear != any(beside(frequency, duration, mains, (2,)) for mains in MAINS_HZ)
    assert mains_clearance(50.0, 1.0, ()) == CLEAR_OF_MAINS  # a bench without mains


def test_the_time_base_stays_where_no_mains_are_near_and_is_slower_where_that_helps() -> None:
    assert STEPS.time_base(1234.0, 15, 20, MAINS_HZ) == STEPS.time_base(1234.0, 15, 20)
    # f is 1.75 widths from 50 Hz in a record of half a second, 3.5 in one of a whole one
    assert STEPS.time_base(53.5, 15, 20) == 0.05
    slower = STEPS.time_base(53.5, 15, 20, (50.0,))
    assert slower > 0.05 and not beside(53.5, 10 * slower, 50)
    assert 2500 / (53.5 * 10 * slower) >= 20  # samples in a period


@pytest.mark.parametrize("mains", [(50.0,), (60.0,), MAINS_HZ])
def test_a_rate_moves_off_the_mains_by_little_and_not_without_need(mains: tuple[float, ...]) -> None:
    random = np.random.default_rng(11)
    moved = 0
    for rate in random.uniform(1.5, 30, 200) * WL:
        beat = K * math.sqrt(rate**2 - WL**2)
        duration = 10 * STEPS.time_base(beat, 15, 20, mains)
        found = rate + off_mains(beat, WL, K, duration, mains)
        before, after = (
            mains_clearance(K * math.sqrt(max(one**2 - WL**2, 0)), duration, mains) for one in (rate, found)
        )
        assert 0.9399 <= found / rate <= 1.1601
        assert after >= min(before, CLEAR_OF_MAINS) - 1e-9
        assert found == rate or before < CLEAR_OF_MAINS
        moved += found != rate
    assert 0 < moved < 120


@pytest.mark.slow
def test_weak_hum_does_no_harm_beside_a_moved_rate() -> None:
    # 0.3 % of hum at 50 Hz, half of it at 100 Hz: too little to be seen by itself, 1 % of the second harmonic
    random = np.random.default_rng(3)
    rms = {}
    for name, mains in (("as it came", ()), ("off the mains", (50.0,))):
        duration = 10 * STEPS.time_base(49.9, 15, 20, mains)
        rate = math.hypot(49.9 / K, WL)
        if mains:
            rate += off_mains(49.9, WL, K, duration, mains)
        beat_hz = K * math.sqrt(rate**2 - WL**2)
        times = np.arange(2500) * duration / 2500
        off = []
        for _ in range(30):
            phase, hum = random.uniform(0, 2 * math.pi, 2)
            # dpsi/dt = 2 pi K (W - WL sin psi), solved for tan(psi/2)
            half = (WL + beat_hz / K * np.tan(math.pi * beat_hz * times + phase)) / rate
            beat = 2 * half / (1 + half**2)
            hums = sum(0.003 / n * np.sin(2 * math.pi * 50 * n * times + hum) for n in (1, 2))
            volts = np.round(100 * (beat + hums + 0.01 * random.standard_normal(2500))) / 100
            found = estimate_lock_in(volts, duration / 2500, scale_factor=K, mains_hz=50.0)
            off.append((float(found.lock_in_rate) - WL) / WL)
        rms[name] = math.sqrt(np.mean(np.square(off)))
    assert rms["as it came"] > 0.0035
    assert rms["off the mains"] < 0.0025
