"""Beat and single beams of lasers that are integrated in time, by equations of the fields."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from laser_fields import integrated_fields

from analysis import estimate_lock_in, fit_rates
from analysis.arrays import NoFit
from analysis.beam_swings import BeamModulation, BeamsFlag, beam_modulation
from analysis.budget import RecordShape
from analysis.harmonics import fit_harmonics
from analysis.plan import expected_lasers_u
from analysis.ring_laser import TwoModeLaser, steady_beat
from analysis.several_rates.laser_fit import search
from analysis.single_beams import BeamsKnowledge, fit_beams
from analysis.two_mode_laser import NUMBERS, periodic_states, states_beside
from benchmarks import beams

K, WL, SAMPLES, PERIODS = 2000.0, 0.01, 2500, 20
LEVELS = (1.3, 0.7)
BOTH = (0.03, 0.06, 0.15, 0.3, -0.3, -0.15, -0.06, -0.03)


@dataclass(frozen=True)
class Bench:
    """What stands behind the laser: readout, contrast, distortion, crosstalk and the scope."""

    laser: TwoModeLaser
    readout: float = 0.9
    pedestal: float = 1.2
    curved: float = 0.003
    cubic: float = 0.0
    crosstalk: tuple[float, float] = (0.004, -0.006)
    noise: float = 0.6  # of a level, and how many of them the signal reaches
    levels: float = 90

    def channels(self, rate: float) -> tuple[np.ndarray, float]:
        """One period of beat, beam 1 and beam 2 in volts (3, n), evenly in time, and the beat in Hz."""
        volts, frequency = _period(self.laser, rate)
        field, first, second = volts
        weights = 1 + self.laser.beam_imbalance * np.array([1, -1])
        light = np.average([first.real, second.real], axis=0, weights=weights)
        beat = (field * np.exp(1j * self.readout)).imag + self.pedestal * (light - 1)
        beat = beat + 2 * self.curved * beat**2 + 4 * self.cubic * beat**3
        beams = [dc * one.real for dc, one in zip(LEVELS, (first, second), strict=True)]
        return np.array([beat, *(one + k * beat for one, k in zip(beams, self.crosstalk, strict=True))]), frequency

    def records(
        self, rate: float, count: int, rng: np.random.Generator, moves: tuple[float, float] = (0.0, 0.0)
    ) -> tuple[np.ndarray, float]:
        """Volts (3, count, SAMPLES) as an AC-coupled scope of eight bits gives them, and the sample interval.

        The beat's phase moves by so many rad, so many times in a record.
        """
        period, frequency = self.channels(rate)
        lines = np.fft.rfft(period) * (2 / period.shape[1])
        lines[:, 0] = 0
        interval = PERIODS / frequency / SAMPLES
        phase = np.arange(SAMPLES) * (PERIODS / SAMPLES) + rng.uniform(0, 1, (count, 1))
        if any(moves):
            motion = np.arange(SAMPLES) * (moves[1] / SAMPLES) + rng.uniform(0, 1, (count, 1))
            phase = phase + moves[0] / (2 * np.pi) * np.sin(2 * np.pi * motion)
        orders = np.flatnonzero(np.abs(lines).max(axis=0) > 1e-7)
        volts = np.array([sum((line[n] * np.exp(2j * np.pi * n * phase)).real for n in orders) for line in lines])
        level = np.abs(volts).max(axis=-1, keepdims=True) / self.levels
        return np.round(volts / level + self.noise * rng.standard_normal(volts.shape)) * level, interval


@cache
def _period(laser: TwoModeLaser, rate: float, points: int = 512) -> tuple[np.ndarray, float]:
    """Field of the fringes, I1 and I2 over one period (3, points), by time integration, and the beat in Hz."""
    first = 2 * np.pi * K * np.sqrt(rate**2 - WL**2)
    duration = 12.3 * 2 * np.pi / first
    one, two = integrated_fields(laser, rate, duration, 3000)
    signals = np.stack([one * np.conj(two), np.abs(one) ** 2, np.abs(two) ** 2])
    real = np.concatenate([signals.real, signals.imag[:1]])
    fit = fit_harmonics(real, duration / 3000, harmonics=24)
    frequency = float(fit.frequency[0])
    phases = np.arange(points) / points
    waves = np.exp(2j * np.pi * np.outer(np.arange(1, 25), phases))
    made = [offset + (line @ waves).real for offset, line in zip(fit.offset, fit.amplitudes, strict=True)]
    return np.stack([made[0] + 1j * made[3], made[1], made[2]]), frequency


def laser(
    ratio: float = 1.4, phase_sum: float = 1.2, corner_over_beat: float = 2.0, saturation: float = 0.6
) -> TwoModeLaser:
    """A laser that locks at WL, its gain corner over the beat at three times that."""
    together = abs(np.exp(-0.5j * phase_sum) + ratio * np.exp(0.5j * phase_sum))
    first = float(2 * np.pi * K * WL / together)
    corner = corner_over_beat * 2 * np.pi * K * WL * np.sqrt(8)
    return TwoModeLaser(K, (first, ratio * first), phase_sum, corner, saturation)


def measured(
    bench: Bench,
    rates=BOTH,
    *,
    seed=1,
    level_error=(0.006, -0.008),
    beams=(1, 2),
    count=3,
    constant=0.0,
    scale=1.0,
    model="auto",
):
    """The fit of the beat alone, and the modulation of the beams, of some records at each rate."""
    rng, estimates, parts, axis = np.random.default_rng(seed), [], [], []
    known = np.array(LEVELS) * np.exp(level_error)
    for rate in rates:
        volts, interval = bench.records(rate, count, rng)
        each = estimate_lock_in(volts[0], interval, scale_factor=K)
        level = [known[beam - 1] for beam in beams]
        parts.append(
            beam_modulation(
                volts[0], volts[list(beams)], interval, beat_frequency=each.beat_frequency, level=level
            )
        )
        estimates.append(each)
        axis += [scale * rate + constant] * count
    columns = [
        np.concatenate([getattr(p, name) for p in parts])
        for name in BeamModulation.__annotations__
        if name != "flags"
    ]
    swing = BeamModulation(*columns, int(np.bitwise_or.reduce([p.flags for p in parts])))
    return fit_rates(estimates, input_rate=axis, reference="beat", in_order=True, model=model), swing


KNOWN = BeamsKnowledge(level_u=0.01, imbalance_limit=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ratio", "phase_sum", "corner"),
    [
        (1.4, 1.2, 2.0),
        (0.4, 2.2, 2.5),
        (0.7, 2.9, 4.0),
        pytest.param(1.0, 0.0, 30.0, marks=pytest.mark.slow),  # a stiff equation
        pytest.param(2.8, 0.4, 8.0, marks=pytest.mark.slow),
    ],
)
def test_the_lock_in_rate_of_any_coupling(ratio, phase_sum, corner):
    bench = Bench(laser(ratio, phase_sum, corner))
    if phase_sum > 2.8:  # nearly no coupling that locks: farther above it the gyro turns as smoothly
        alone, swing = measured(bench, tuple(3 * rate for rate in BOTH))
    else:
        alone, swing = measured(bench)
    fit = fit_beams(alone, swing, KNOWN)
    assert abs(fit.lock_in_rate - WL) < 3.3 * fit.lock_in_rate_u
    assert fit.lock_in_rate_u < 1.02 * alone.lock_in_rate_u
    assert not fit.flags & BeamsFlag.MISFIT
    first, second = bench.laser.backscatter
    assert abs(fit.backscatter_1 - first) < 3.5 * fit.backscatter_1_u
    assert abs(fit.backscatter_2 - second) < 3.5 * fit.backscatter_2_u
    turned = np.angle(np.exp(1j * (fit.phase_sum - phase_sum)))
    assert abs(turned) < 3.5 * fit.phase_sum_u
    assert fit.gain_rate_low_95 / 1.02 < bench.laser.gain_rate < 1.02 * fit.gain_rate_high_95
    # the beat without backscatter is that of the rate
    off = fit.corrected_frequency - K * fit.rate
    assert np.all(np.abs(off) < 4 * fit.corrected_frequency_u + 1e-4)


@pytest.mark.parametrize(
    ("unequal", "dispersion", "rates"),
    [
        (0.045, -0.02, (0.03, 0.1, 0.3, -0.1)),
        pytest.param(-0.035, 0.03, BOTH, marks=pytest.mark.slow),
        pytest.param(0.05, 0.0, (0.08, -0.08), marks=pytest.mark.slow),
        pytest.param(0.02, 0.03, (0.03, 0.3), marks=pytest.mark.slow),
    ],
)
def test_unequal_beams_and_a_gain_off_the_centre_of_its_line(unequal, dispersion, rates):
    made = replace(laser(1.2, 0.9, 1.5), beam_imbalance=unequal, gain_dispersion=dispersion)
    share = WL / made.lock_in_rate
    bench = Bench(replace(made, backscatter=tuple(share * one for one in made.backscatter)))
    alone, swing = measured(bench, rates)
    fit = fit_beams(alone, swing, BeamsKnowledge(level_u=0.01))
    assert abs(fit.lock_in_rate - WL) < 3.3 * fit.lock_in_rate_u < 0.06 * WL
    assert not fit.flags & BeamsFlag.MISFIT
    assert abs(fit.phase_sum - 0.9) < 3.3 * fit.phase_sum_u
    if len(rates) > 2:  # a statement that is wrong shows
        assert fit_beams(alone, swing, KNOWN).flags & BeamsFlag.MISFIT


def test_the_beat_has_more_light_of_the_stronger_beam():
    made = replace(laser(1.2, 0.9, 1.5), beam_imbalance=0.4)
    share = WL / made.lock_in_rate
    bench = Bench(replace(made, backscatter=tuple(share * one for one in made.backscatter)), pedestal=2.0)
    fit = fit_beams(*measured(bench, (0.03, 0.1, 0.3, -0.1)), replace(KNOWN, imbalance_limit=0.5))
    assert abs(fit.lock_in_rate - WL) < 3.3 * fit.lock_in_rate_u < 0.02 * WL
    assert not fit.flags & BeamsFlag.MISFIT


@pytest.mark.slow
@pytest.mark.parametrize("rates", [(0.03, 0.3), (0.08, -0.08), (0.03, 0.1, 0.3)])
def test_beams_settle_what_few_rates_leave_open(rates):
    bench = Bench(laser(1.2, 0.6, 1.5))
    alone, swing = measured(bench, rates)
    fit = fit_beams(alone, swing, KNOWN)
    width = fit.lock_in_rate_high_95 - fit.lock_in_rate_low_95
    assert width < 0.5 * (alone.lock_in_rate_high_95 - alone.lock_in_rate_low_95)
    assert abs(fit.lock_in_rate - WL) < 3.3 * fit.lock_in_rate_u


@pytest.mark.slow
def test_a_plan_promises_what_such_lasers_give():
    # 24 lasers are drawn; this bench has one of them, with what it knows
    rates = (0.03, 0.1, 0.3)
    fit = fit_beams(*measured(Bench(laser(1.2, 0.6, 1.5)), rates, count=4), KNOWN)
    shapes = [
        RecordShape(SAMPLES, PERIODS / (K * np.sqrt(rate**2 - WL**2)) / SAMPLES, 90.0, 0.6, 1.0, 4)
        for rate in rates
    ]
    us = expected_lasers_u(shapes, rates, WL, K, knowledge=KNOWN)
    assert np.all(np.diff(us) >= 0)
    assert us[0] / 1.2 < fit.lock_in_rate_u < 1.2 * us[-1]
    half, of_one = np.median(us), np.median(expected_lasers_u(shapes, rates, WL, K, beams=1, knowledge=KNOWN))
    assert 0.4 < half / fit.lock_in_rate_u < 2.5
    assert half < of_one  # one beam alone tells less
    many = [replace(shape, records=400) for shape in shapes]
    assert 0.1 < np.median(expected_lasers_u(many, rates, WL, K, knowledge=KNOWN)) / half < 0.9


@pytest.mark.slow
def test_one_beam_is_worth_something_and_a_level_is_needed_for_its_size():
    bench = Bench(laser())
    alone, swing = measured(bench, beams=(2,))
    one = fit_beams(alone, swing, KNOWN)
    assert abs(one.lock_in_rate - WL) < 3.3 * one.lock_in_rate_u < 3.3 * alone.lock_in_rate_u
    alone, swing = measured(bench, level_error=(np.nan, np.nan))
    assert swing.flags & BeamsFlag.NO_LEVEL
    unknown = fit_beams(alone, swing, KNOWN)
    assert abs(unknown.lock_in_rate - WL) < 3.3 * unknown.lock_in_rate_u < 3.3 * alone.lock_in_rate_u


@pytest.mark.slow
def test_the_conservative_part_pushes_the_beat_up():
    # equation (2.11) and its example: 120 degrees, w = g, xi = 0.6; Adler's equation says the other sign
    each = float(np.pi * K * WL / np.cos(np.radians(60)))
    rate = 0.4
    fast = 2 * np.pi * K * rate
    pushed = Bench(TwoModeLaser(K, (each, each), np.radians(120), fast, 0.6))
    rates = tuple(sense * share * rate for sense in (1, -1) for share in (0.25, 1.0, 2.0))
    alone, swing = measured(pushed, rates)
    fit = fit_beams(alone, swing, KNOWN)
    place = int(np.argmin(np.abs(fit.rate - rate)))
    g_d = fast * 0.4 / 1.6
    b_c, b_s = 2 * each * np.cos(np.radians(60)), 2 * each * np.sin(np.radians(60))
    expected = -(b_c**2 - b_s**2 * fast**2 / (fast**2 + g_d**2)) / (2 * fast**2)
    seen = fit.beat_frequency[place] / abs(fit.corrected_frequency[place]) - 1
    assert expected > 0
    assert seen == pytest.approx(expected, rel=0.02)
    # what the difference of the beams does is told from what locks
    assert fit.push[place] == pytest.approx(expected + b_c**2 / (2 * fast**2), rel=0.02)


def test_routes_are_told_apart():
    by_frequencies = []
    for scale in (1.0, 1.006):  # the table may turn more slowly than it says
        alone, swing = measured(Bench(laser(1.4, 1.2, 0.7)), (0.03, 0.1, -0.03, -0.1), scale=scale)
        fit = fit_beams(alone, swing, KNOWN)
        assert not fit.flags & BeamsFlag.ROUTES_DIFFER
        assert [route.name for route in fit.routes] == ["harmonics", "beams", "frequencies"]
        for route in fit.routes[1:]:
            assert abs(route.lock_in_rate - WL) < 3.5 * route.lock_in_rate_u
            assert route.lock_in_rate_low_95 < route.lock_in_rate < route.lock_in_rate_high_95
        assert fit.routes[0].lock_in_rate == alone.lock_in_rate
        by_frequencies.append(fit.routes[2].lock_in_rate)
    # for the scale factor as given, whatever the table says
    assert by_frequencies[1] == pytest.approx(by_frequencies[0], rel=1e-3)


def test_distortion_is_of_the_light_that_there_is():
    """Backscatter makes the fringes weaker in one sense than in the other, and third order goes by the square."""
    bench = Bench(laser(0.95, 1.95, 0.8, 0.3), cubic=0.009, levels=900)
    fit = fit_beams(*measured(bench, (0.04, 0.08, -0.08, -0.04), count=2, model="distortion"), KNOWN)
    assert not fit.flags & BeamsFlag.MISFIT
    assert abs(fit.lock_in_rate - WL) < 3 * fit.lock_in_rate_u < 0.003 * WL


@pytest.mark.slow
def test_frequencies_of_one_sense_count_a_constant_of_the_table():
    """The earth rate, as far as it points along the table's axis."""
    alone, swing = measured(Bench(laser(1.4, 1.2, 0.7)), BOTH[:4], constant=0.003)
    fit = fit_beams(alone, swing, KNOWN)
    assert abs(fit.lock_in_rate - WL) < 3.5 * fit.lock_in_rate_u and not fit.flags & BeamsFlag.ROUTES_DIFFER
    for route in fit.routes:
        assert abs(route.lock_in_rate - WL) < 3.5 * route.lock_in_rate_u


def test_what_a_beam_may_not_be():
    bench, rng = Bench(laser()), np.random.default_rng(3)
    volts, interval = bench.records(0.1, 4, rng)
    frequency = estimate_lock_in(volts[0], interval, scale_factor=K).beat_frequency
    plain = {"beat_frequency": frequency, "level": LEVELS}

    def flags(beams, **more):
        return beam_modulation(volts[0], beams, interval, **{**plain, **more}).flags

    assert flags(volts[1:]) == 0
    clipped = np.zeros(volts[1:].shape, dtype=bool)
    clipped[0, :3, 7] = True
    assert flags(volts[1:], clipped=clipped) == BeamsFlag.CLIPPED
    dark = volts[1:].copy()
    dark[1] = rng.standard_normal(dark[1].shape) * 1e-3
    assert flags(dark) == BeamsFlag.DARK
    assert flags(volts[1:], level=(0.0, 0.7)) == BeamsFlag.DARK
    assert flags(volts[[1, 0]]) == BeamsFlag.SHOWS_THE_BEAT
    assert flags(volts[1:], level=(np.nan, 0.7)) == BeamsFlag.NO_LEVEL
    with pytest.raises(ValueError, match="shape"):
        flags(volts[1:, :, :-1])
    with pytest.raises(ValueError, match="shape"):
        flags(np.repeat(volts[1:], 2, axis=0))
    # a beat whose rate runs away within the record has no line to compare with
    chirp = np.sin(2 * np.pi * (50 * np.linspace(0, 1, SAMPLES) + 40 * np.linspace(0, 1, SAMPLES) ** 2))
    moved = beam_modulation(chirp[np.newaxis], volts[1:, :1], 1 / SAMPLES, beat_frequency=[90.0], level=LEVELS)
    assert moved.flags & BeamsFlag.RECORDS_LEFT_OUT
    assert np.isnan(moved.modulation).all()
    assert np.isnan(
        beam_modulation(volts[0], volts[1:], interval, beat_frequency=[np.nan] * 4, level=LEVELS).modulation
    ).all()


@pytest.mark.slow
def test_the_modulation_is_known_as_well_as_it_says():
    bench, rng = Bench(laser(), crosstalk=(0.0, 0.0)), np.random.default_rng(5)
    period, frequency = bench.channels(0.06)
    lines = np.fft.rfft(period)
    true = 2 * lines[1:, 1] / period.shape[1] / np.array(LEVELS) * np.abs(lines[0, 1]) / lines[0, 1]
    volts, interval = bench.records(0.06, 200, rng)
    each = estimate_lock_in(volts[0], interval, scale_factor=K)
    made = beam_modulation(volts[0], volts[1:], interval, beat_frequency=each.beat_frequency, level=LEVELS)
    assert each.beat_frequency == pytest.approx(frequency, rel=1e-4)
    off = (made.modulation - true) * np.exp(-1j * np.angle(true))
    assert np.mean((off.real / made.modulation_u) ** 2) == pytest.approx(1.0, rel=0.2)
    across_u = np.hypot(made.modulation_u, np.abs(true) * made.phase_u[:, np.newaxis])
    assert np.mean((off.imag / across_u) ** 2) == pytest.approx(1.0, rel=0.2)
    # an AC coupling in front of the beams, taken out
    ac = 1 / (1 - 10j / frequency)
    shifted = volts[1:].copy()
    times = np.arange(SAMPLES) * interval
    fit = fit_harmonics(shifted, interval, harmonics=6)
    for order in range(1, 7):
        gain = 1 / (1 - 10j / (order * fit.frequency)) - 1
        turns = np.exp(2j * np.pi * order * fit.frequency[..., np.newaxis] * times)
        shifted += ((fit.amplitudes[..., order - 1] * gain)[..., np.newaxis] * turns).real
    again = beam_modulation(
        volts[0], shifted, interval, beat_frequency=each.beat_frequency, level=LEVELS, ac_corner_hz=10.0
    )
    assert abs(ac) < 0.999
    assert np.max(np.abs(again.modulation - made.modulation)) < 2e-3 * np.max(np.abs(made.modulation))


@pytest.mark.parametrize("moves", [(0.0, 0.0), (0.04, 2.2), (0.4, 1.7), (1.5, 0.6)])
def test_a_moving_rate_changes_neither_the_size_of_a_swing_nor_what_is_known_of_it(moves):
    bench, rng = Bench(laser(), crosstalk=(0.0, 0.0)), np.random.default_rng(6)
    period, frequency = bench.channels(0.06)
    lines = np.fft.rfft(period)
    true = 2 * lines[1:, 1] / period.shape[1] / np.array(LEVELS) * np.abs(lines[0, 1]) / lines[0, 1]
    volts, interval = bench.records(0.06, 40, rng, moves)
    made = beam_modulation(volts[0], volts[1:], interval, beat_frequency=np.full(40, frequency), level=LEVELS)
    off = (made.modulation - true) * np.exp(-1j * np.angle(true)) / made.modulation_u
    assert np.sqrt(np.mean(off.real**2)) == pytest.approx(1.1, abs=0.3)
    assert np.all(np.abs(off.real.mean(axis=0)) < 0.6)
    # across it, the phase of the beat is in both
    shared = np.abs(true) * made.phase_u[:, np.newaxis]
    assert np.sqrt(np.mean(off.imag**2 / (1 + (shared / made.modulation_u) ** 2))) == pytest.approx(1.1, abs=0.3)
    assert np.mean(off.imag[:, 0] * off.imag[:, 1]) == pytest.approx(
        np.mean(shared[:, 0] * shared[:, 1] / made.modulation_u.prod(axis=1)), rel=0.8
    )
    assert np.all(made.modulation_u < 3e-4 * np.abs(true) + 3e-4)


def test_no_beam_is_no_fit():
    alone, swing = measured(Bench(laser()), (0.03, -0.03, 0.3, -0.3))
    nothing = replace(
        swing,
        modulation=np.full_like(swing.modulation, np.nan),
        modulation_u=np.full_like(swing.modulation_u, np.nan),
    )
    with pytest.raises(NoFit, match="single beam"):
        fit_beams(alone, nothing, KNOWN)
    # and beams that no laser has: the reason is told
    sense = np.sign(alone.records.records.rate)[:, np.newaxis]
    with pytest.raises(NoFit, match="too strong for its gain"):
        fit_beams(alone, replace(swing, modulation=swing.modulation * np.where(sense > 0, 5.0, 0.02)), KNOWN)


def test_rates_of_which_nothing_is_known_are_as_good_as_they_show():
    alone, swing = measured(Bench(laser()), (0.03, -0.03, 0.3, -0.3))
    plain, nothing, exact, stated = (
        fit_beams(alone, swing, replace(KNOWN, **known)).lock_in_rate_u
        for known in ({}, {"rate_u": np.nan}, {"rate_u": 0.0}, {"rate_u": 1e-3})
    )
    assert plain == nothing == exact < stated


@pytest.mark.parametrize("slowness", [0.05, 0.3, 1.0, 3.0, 5.5])
def test_the_common_part_of_a_large_ring_and_its_constant(slowness):
    # far above lock-in: (2.12), and the correction of large rings, whose kappa is 1 + (g/w)^2: 1.033 at w = 5.5 g
    rate = 3.0
    made = laser(1.3, 0.8)
    w = 2 * np.pi * K * rate
    made = replace(made, gain_rate=w / slowness)
    beat = steady_beat(made, rate)
    middle = beat.beams.shape[1] // 2
    first, second = 2 * beat.beams[:, middle + 1] / beat.beams[:, middle].real
    common = abs(first + second) / 2
    assert common == pytest.approx(2 * np.pi * K * WL / np.hypot(w, made.gain_rate), rel=1e-3)
    kappa = 1 + (made.gain_rate / w) ** 2
    if slowness == 5.5:
        assert kappa == pytest.approx(1.033, abs=3e-4)
    m1, m2, turned = abs(first), abs(second), float(np.angle(second / first))
    sum2 = (m1**2 + m2**2 + 2 * m1 * m2 * np.cos(turned)) / 4 * kappa
    difference2 = (m1**2 + m2**2 - 2 * m1 * m2 * np.cos(turned)) / 4
    corrected = beat.frequency * (4 + 2 * (sum2 - difference2)) / 4
    pulled = K * rate - beat.frequency
    assert abs(pulled) > 1e-6 * K * rate
    assert corrected == pytest.approx(K * rate, abs=0.02 * abs(pulled))


@pytest.mark.parametrize("slowness", [0.1, 0.3, 1.0, 3.0])
def test_the_second_harmonic_of_the_same_laser(slowness):
    # (2.10) for any coupling, far above lock-in
    rate, made = 3.0, laser(0.6, 1.0)
    w = 2 * np.pi * K * rate
    beat = steady_beat(replace(made, gain_rate=w / slowness), rate)
    middle = beat.beat.size // 2
    first, second = beat.beat[middle + 1], beat.beat[middle + 2]
    adler = np.tan(np.arcsin(WL / rate) / 2)
    assert abs(second / first) == pytest.approx(adler / np.hypot(1, slowness), rel=1e-3)


@pytest.mark.parametrize(
    ("other", "rate", "angular"),
    [
        ([0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0], 0.0, None),
        ([100.0, 80.0, 0.5, 0.5, 6000.0, 0.1, 0.03], 0.0, 990.0),
        ([np.inf, 80.0, 0.5, 0.5, 6000.0, 0.1, 0.03], 0.1, 990.0),
        ([1e300, 80.0, 0.5, 0.5, 6000.0, 0.1, 0.03], 0.1, 990.0),
    ],
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_laser_that_stands_does_not_end_the_others(other, rate, angular):
    made = laser()
    lasers = np.array([other, made.numbers])
    sagnac = 2 * np.pi * K * np.array([rate, 0.1])
    beats = None if angular is None else np.array([angular, 2 * np.pi * K * 0.1])
    values, _, found = periodic_states(lasers, sagnac, np.zeros((2, 2, 65)), beats)
    assert found[1] and not found[0]
    assert np.isfinite(values[1]).all()
    middle = np.exp(values[1]).mean()
    assert middle == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("ratio", "phase_sum", "corner", "slowest"),
    [(0.495, 0.137, 20.0, 1.06), pytest.param(0.513, 1.073, 8.3, 1.03, marks=pytest.mark.slow)],
)
def test_close_to_lock_in_each_route_begins_where_all_have_ended(ratio, phase_sum, corner, slowest):
    """From nothing no periodic solution is found there."""
    rates = (slowest * WL, 2.3 * slowest * WL, -1.5 * slowest * WL)
    fit = fit_beams(*measured(Bench(laser(ratio, phase_sum, corner)), rates, count=1), KNOWN)
    assert [route.name for route in fit.routes] == ["harmonics", "beams", "frequencies"]
    assert abs(fit.lock_in_rate - WL) < 3.3 * fit.lock_in_rate_u < 0.01 * WL


@pytest.mark.parametrize(
    "rates",
    [
        (1.68, 17.0),
        pytest.param((-1.7, -17.0), marks=pytest.mark.slow),
        pytest.param((3, 30), marks=pytest.mark.slow),
    ],
)
def test_a_phase_that_may_turn_makes_the_lock_in_rate_no_smaller(rates):
    """With one record at each rate nothing shows whether it has: the size was freed of a bias that it has not."""
    bench = Bench(laser(0.83, 1.335, 2.06, 0.56), noise=2.0)
    fit = fit_beams(*measured(bench, tuple(WL * np.array(rates)), count=1), KNOWN)
    assert abs(fit.lock_in_rate - WL) < 3.3 * fit.lock_in_rate_u < 0.07 * WL


@pytest.mark.parametrize("seed", [6, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 2, 5, 7))])
def test_a_turn_hides_no_other_laser(seed):
    """One record at each of two rates: a phase that turns and another angle of the coupling look much alike."""
    rng = np.random.default_rng([0, seed])
    spread = (
        np.exp(rng.uniform(-0.8, 0.8)),
        rng.uniform(0, 2.4),
        np.exp(rng.uniform(-0.5, 2)),
        rng.uniform(0.3, 0.7),
    )
    bench = Bench(
        laser(*spread),
        rng.uniform(-3, 3),
        rng.uniform(0.2, 1.8),
        rng.uniform(-0.004, 0.004),
        crosstalk=tuple(rng.uniform(-0.006, 0.006, 2)),
        noise=1.5,
    )
    levels = tuple(rng.normal(size=2) * 0.01)
    fit = fit_beams(*measured(bench, (1.68 * WL, 16.94 * WL), seed=seed, level_error=levels, count=1), KNOWN)
    assert abs(fit.lock_in_rate - WL) < 3.3 * fit.lock_in_rate_u < 0.16 * WL


def test_searches_that_end_at_one_minimum_are_one_solution():
    rng = np.random.default_rng([0, 5])
    spread = (
        np.exp(rng.uniform(-0.8, 0.8)),
        rng.uniform(0, 2.4),
        np.exp(rng.uniform(-0.5, 2)),
        rng.uniform(0.3, 0.7),
    )
    bench = Bench(laser(*spread), noise=1.5)
    fit = fit_beams(*measured(bench, (1.68 * WL, 16.94 * WL), seed=5, count=1), KNOWN)
    assert not fit.flags & BeamsFlag.SEVERAL_SOLUTIONS


def test_a_fit_keeps_the_least_of_lock_in_rates_that_are_all_too_large():
    # strongly winking, and close to lock-in: no fit of the beat alone is near
    alone, _ = measured(Bench(laser(2.09, 2.262, 10.5)), (1.1 * WL, 2.53 * WL, -1.65 * WL), count=2)
    assert np.isfinite(alone.lock_in_rate)


def test_a_search_goes_back_to_the_solutions_of_its_best_step():
    """From those of a laser far away, which a rejected step tried, Newton's method may end at none."""
    found = measured(Bench(laser(1.4, 1.2, 2.0)), (0.03, 0.06, 0.15, 0.3))[0].lasers[0]
    model, seen = found.model.of(found.model.data), []
    plain = model.residual

    def watched(parameters):
        before, left = model.last, plain(parameters)
        if len(parameters) == 1:
            seen.append((before, float(left[0] @ left[0]), model.last))
        return left

    model.residual = watched
    start = found.parameters.copy()
    start[:4] += 0.5, 0.4, -0.5, 0.8
    assert search(model, start, 20) is not None
    near, least, rejected = seen[0][0], np.inf, 0
    for before, cost, after in seen:
        assert before is near
        rejected += cost >= least
        near, least = (after, cost) if cost < least else (near, least)
    assert rejected and model.last is near


def test_lasers_beside_a_known_one_follow_by_one_step():
    """To second order in how far they are away, as lasers found by many steps say."""
    known = replace(laser(0.6, 1.0), beam_imbalance=0.2, gain_dispersion=0.1).numbers
    sagnac = 2 * np.pi * K * np.array([0.1])
    beats = 0.9 * sagnac
    values, at, found = periodic_states(known[np.newaxis], sagnac, np.zeros((1, 2, 33)), beats)
    assert found.all()
    away = []
    for share in (1e-2, 1e-3):
        others = known + share * np.diag([*known[:5], 1.0, 10.0])  # the last two are small where they count
        near, near_at = states_beside(others[:, np.newaxis], known[np.newaxis], at, values, beats)
        exact, exact_at, there = periodic_states(
            others, np.repeat(at, NUMBERS), np.repeat(values, NUMBERS, axis=0), np.repeat(beats, NUMBERS)
        )
        assert there.all()
        moved = np.abs(exact - values).max(axis=(1, 2))
        assert np.all(moved > 1e-2 * share)
        away.append([np.abs(near - exact).max(axis=(1, 2)), np.abs(near_at - exact_at) / at])
    assert np.all(np.array(away[1]) < 0.02 * np.array(away[0]) + 1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "u"),
    [
        (100_010, 2e-3),
        (100_012, 1e-3),
        pytest.param(100_011, 2e-3, marks=pytest.mark.slow, id="with a side valley"),
    ],
)
def test_whatever_is_bounded_may_be_there_at_once(seed, u):
    """Phases turn within a setting, the light changes with the rate, there are valleys beside the lowest."""
    found = beams.outcome(beams.PLANS["3 10 30, one sense"], seed)
    assert found is not None and abs(found.pull) < 3 and found.u < u
    assert not found.flags & (BeamsFlag.MISFIT | BeamsFlag.ROUTES_DIFFER)


@pytest.mark.parametrize("seed", [6, pytest.param(100_027, marks=pytest.mark.slow)])
def test_a_whole_turn_between_the_senses_is_none(seed):
    """The search from every start ends one away, at once or later."""
    found = beams.outcome(beams.PLANS["8, both senses"], seed)
    assert found is not None and abs(found.pull) < 3 and not found.flags


@pytest.mark.slow
@pytest.mark.parametrize("seed", [100_020, 100_094])
def test_a_misfit_is_looked_at_once_more(seed):
    """Softened, every start leads into a valley of another saturation, chi-square 150 to 850 above the least."""
    found = beams.outcome(beams.PLANS["3 30, one sense"], seed)
    assert found is not None and abs(found.pull) < 3 and not found.flags


@pytest.mark.slow
def test_a_start_that_has_no_steady_beat_begins_with_less_backscatter():
    found = beams.outcome(beams.PLANS["3 30, one sense"], 100_102)
    assert found is not None and abs(found.pull) < 3 and not found.flags & BeamsFlag.MISFIT


@pytest.mark.slow
@pytest.mark.parametrize(("plan", "seed"), [("3 30, one sense", 100_079), ("3 5 9 17 30, one sense", 100_063)])
def test_where_no_look_finds_a_laser_others_are_tried(plan, seed):
    """The first is found from a start with another saturation only, the second through valleys of more noise."""
    found = beams.outcome(beams.PLANS[plan], seed)
    assert found is not None and abs(found.pull) < 3 and not found.flags & BeamsFlag.MISFIT


@pytest.mark.slow
def test_a_minimum_that_no_search_finds_again_ends_no_run():
    """Other minima were found after it, and their solutions are too far from it."""
    assert beams.outcome(beams.PLANS["3 5 9 17 30, both senses"], 300_023) is not None
