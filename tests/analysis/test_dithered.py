"""Records of dithered gyros, integrated in time by a program of their own."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from analysis import combine_dithered, estimate_dithered, lock_in_of_random_walk, walk_of_counts
from analysis.arrays import NoFit
from analysis.dithered import DitheredEstimate, DitherFlag, dithered_bound
from benchmarks.dithered import hour_of_counts

K, SAMPLES, FINER = 2000.0, 2500, 8


def records(
    rng,
    count,
    *,
    lock_in,
    phase,
    swing=100.0,
    dither=400.0,
    periods=2.0,
    jitter=0.01,
    wave=np.cos,
    gain_corner=0.0,
    pole=0.0,
):
    """Volts (count, SAMPLES) in eight bits, and the sample interval: fourth-order Runge and Kutta."""
    step = periods / dither / SAMPLES / FINER
    begin = rng.uniform(0, 2 * np.pi, count)
    knots = (np.arange(int(np.ceil(periods)) + 4) - 2) / dither
    breath = CubicSpline(knots, 1 + jitter * rng.standard_normal((knots.size, count)))

    def turning(time):
        return 2 * np.pi * K * (0.7 + swing * breath(time) * wave(2 * np.pi * dither * time + begin))

    pull = 2 * np.pi * K * np.broadcast_to(lock_in, count)
    psi, seen, after = rng.uniform(0, 2 * np.pi, count), np.empty((count, SAMPLES)), turning(0.0)
    light, behind = np.zeros(count), np.zeros(count)
    for number in range(SAMPLES * FINER):
        volts = (1 + light) * np.sin(psi) + 0.003 * np.cos(2 * psi)
        behind = volts + (behind - volts) * np.exp(-2 * np.pi * pole * step) if pole and number else volts
        if number % FINER == 0:
            seen[:, number // FINER] = behind
        if gain_corner:  # both beams follow the coupling, (2.12)
            light += step * (pull * np.cos(psi + phase) - 2 * np.pi * gain_corner * light)
        before, middle, after = after, turning((number + 0.5) * step), turning((number + 1) * step)
        one = before - pull * np.sin(psi + phase)
        two = middle - pull * np.sin(psi + step / 2 * one + phase)
        three = middle - pull * np.sin(psi + step / 2 * two + phase)
        four = after - pull * np.sin(psi + step * three + phase)
        psi = psi + step / 6 * (one + 2 * two + 2 * three + four)
    return np.round(90 * seen + 0.6 * rng.standard_normal(seen.shape)) / 90, step * FINER


def test_errors_are_those_of_the_bound(run):
    """Of Cramér and Rao, over phases of beat, dither and coupling: the records of this file draw them."""
    true, each = run
    rng = np.random.default_rng(1)
    known = {"scale_factor": K, "dither_frequency": 400.0, "sample_interval": 2e-6, "n_samples": SAMPLES}
    turns = np.exp(2j * np.pi * rng.uniform(size=(12, 2)))
    bounds = [
        dithered_bound(0.06 * own, 100 * turn, noise=np.hypot(0.6, 12**-0.5) / 90, bias=0.7, start=start, **known)
        for (own, turn), start in zip(turns, rng.uniform(0, 6, 12), strict=True)
    ]
    off = (each.lock_in_rate - true)[(each.flags & ~int(DitherFlag.NOT_SIGNIFICANT)) == 0]
    assert 0.6 < np.sqrt(np.mean(off**2) / np.mean(np.square(bounds))) < 1.6


@pytest.fixture(scope="module")
def run():
    rng = np.random.default_rng(11)
    true = np.exp(rng.uniform(np.log(0.02), np.log(0.2), 16))
    volts, interval = records(rng, 16, lock_in=true, phase=1.1)
    return true, estimate_dithered(volts, interval, scale_factor=K, dither_frequency=401.5)


def test_each_record_holds_what_it_says(run):
    true, each = run
    usable = (each.flags & ~int(DitherFlag.NOT_SIGNIFICANT)) == 0
    assert usable.sum() >= 14
    off = ((each.lock_in_rate - true) / each.lock_in_rate_u)[usable]
    assert np.max(np.abs(off)) < 4
    assert 0.5 < np.sqrt(np.mean(off**2)) < 1.4
    assert np.median(each.lock_in_rate_u[usable]) < 0.006
    assert each.dither_rate[usable] == pytest.approx(np.full(usable.sum(), 100.0), rel=0.03)
    # the coupling itself, or that of the other sense
    wanted = true * np.exp(1.1j)
    apart = np.minimum(np.abs(each.coupling - wanted), np.abs(each.coupling + np.conj(wanted)))
    assert np.all(apart[usable] < 5 * each.lock_in_rate_u[usable])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gain_corner", "pole"),
    [
        (3000.0, 0.0),
        (0.0, 7e5),
        pytest.param(12_000.0, 0.0, marks=pytest.mark.slow),
        pytest.param(5000.0, 1.5e6, marks=pytest.mark.slow),
    ],
)
def test_light_that_follows_and_a_slow_receiver_are_no_lock_in(gain_corner, pole):
    rng = np.random.default_rng(23)
    true = np.exp(rng.uniform(np.log(0.03), np.log(0.2), 16))
    volts, interval = records(rng, 16, lock_in=true, phase=0.6, gain_corner=gain_corner, pole=pole, periods=1.6)
    each = estimate_dithered(volts, interval, scale_factor=K, dither_frequency=401.0)
    usable = (each.flags & ~int(DitherFlag.NOT_SIGNIFICANT)) == 0
    assert usable.sum() >= 13
    off = ((each.lock_in_rate - true) / each.lock_in_rate_u)[usable]
    assert np.max(np.abs(off)) < 3.5
    assert np.sqrt(np.mean(off**2)) < 1.4


@pytest.mark.slow
@pytest.mark.parametrize(("periods", "swing", "jitter"), [(2.0, 90.0, 0.1), (6.0, 28.0, 0.02)])
def test_a_dither_that_breathes_and_a_long_record_are_followed(periods, swing, jitter):
    rng = np.random.default_rng(29)
    true = np.exp(rng.uniform(np.log(0.03), np.log(0.2), 10))
    volts, interval = records(rng, 10, lock_in=true, phase=1.9, swing=swing, periods=periods, jitter=jitter)
    each = estimate_dithered(volts, interval, scale_factor=K, dither_frequency=402.0)
    usable = (each.flags & ~int(DitherFlag.NOT_SIGNIFICANT)) == 0
    assert usable.sum() >= 8
    assert np.max(np.abs((each.lock_in_rate - true) / each.lock_in_rate_u)[usable]) < 4


@pytest.mark.slow
def test_a_strong_coupling_is_followed_to_its_end():
    rng = np.random.default_rng(41)
    true = np.exp(rng.uniform(np.log(0.3), np.log(1.0), 10))
    volts, interval = records(rng, 10, lock_in=true, phase=0.9)
    each = estimate_dithered(volts, interval, scale_factor=K, dither_frequency=402.0)
    usable = (each.flags & ~int(DitherFlag.NOT_SIGNIFICANT)) == 0
    assert usable.sum() >= 8
    assert np.sqrt(np.mean(((each.lock_in_rate - true) / each.lock_in_rate_u)[usable] ** 2)) < 1.5


@pytest.mark.slow
def test_half_a_period_may_do():
    volts, interval = records(np.random.default_rng(8), 8, lock_in=0.08, phase=0.2, periods=0.6)
    each = estimate_dithered(volts, interval, scale_factor=K, dither_frequency=402.0)
    usable = (each.flags & ~int(DitherFlag.NOT_SIGNIFICANT)) == 0
    assert usable.sum() >= 3
    assert np.all(np.abs(each.lock_in_rate - 0.08)[usable] < 4 * each.lock_in_rate_u[usable])
    assert np.isnan(each.dither_rate).all()


@pytest.mark.slow
def test_many_records_are_one_value():
    rng = np.random.default_rng(5)
    volts, interval = records(rng, 16, lock_in=0.03, phase=2.4)
    each = estimate_dithered(volts, interval, scale_factor=K, dither_frequency=398.0)
    together = combine_dithered(each)
    assert together.lock_in_rate_u[0] < 0.45 * np.nanmin(each.lock_in_rate_u)
    assert abs(together.lock_in_rate[0] - 0.03) < 3.3 * together.lock_in_rate_u[0]
    assert not together.flags[0]
    # those of the other sense are turned round, whichever comes first
    turned = each.take(slice(None, None, -1))
    assert combine_dithered(turned).lock_in_rate[0] == pytest.approx(together.lock_in_rate[0], rel=1e-6)
    half = estimate_dithered(volts[:2], interval, scale_factor=K / 2, dither_frequency=398.0)
    assert half.lock_in_rate == pytest.approx(2 * each.lock_in_rate[:2], rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("true", "angle"), [(0.01, 0.3), (0.01, 1.4), (0.003, 0.5), (0.05, 0.7)])
def test_records_of_either_sense_make_no_lock_in_rate_of_noise(true, angle):
    # each record alone does not tell which of its two answers is right: to take the nearer one would add noise
    rng, held, off = np.random.default_rng(3), 0, []
    for _ in range(40):
        axes = rng.uniform(0, np.pi, 20)
        turn = np.array([[np.cos(axes), -np.sin(axes)], [np.sin(axes), np.cos(axes)]]).transpose(2, 0, 1)
        covariance = turn @ np.diag([0.005**2, 0.008**2]) @ turn.transpose(0, 2, 1)
        noise = np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), rng.standard_normal((20, 2)))
        z = true * np.exp(1j * angle) + noise[:, 0] + 1j * noise[:, 1]
        other = rng.random(20) < 0.5
        z = np.where(other, -z.conj(), z)
        covariance[other] *= [[1, -1], [-1, 1]]
        nothing = np.full(20, 0.005)
        each = DitheredEstimate(
            abs(z), nothing, nothing, nothing, z, covariance, 1e4 * nothing, nothing, nothing, np.zeros(20, int)
        )
        made = combine_dithered(each)
        held += bool(made.lock_in_rate_low_95[0] <= true <= made.lock_in_rate_high_95[0])
        off.append(float((made.lock_in_rate[0] - true) / made.lock_in_rate_u[0]))
    assert held >= 35
    assert abs(np.mean(off)) < 0.55


@pytest.mark.slow
def test_what_cannot_be_followed_is_no_number():
    rng = np.random.default_rng(3)
    plain = {"lock_in": 0.05, "phase": 0.4}
    volts, interval = records(rng, 4, **plain)

    def flags(some, step=interval, dither=400.0, **more):
        return estimate_dithered(some, step, scale_factor=K, dither_frequency=dither, **more)

    for wrong in (
        flags(volts, dither=520.0),
        flags(rng.standard_normal((3, SAMPLES))),
        flags(np.ones((2, SAMPLES))),
        flags(np.outer([1.0, -1e-3], np.linspace(0, 1, SAMPLES) ** 3)),
        flags(np.outer([1.0, 5.0], np.arange(SAMPLES) == 700)),
        flags(np.sin(np.outer([0.01, 3.1, 2.0], np.arange(SAMPLES)))),
        flags(*records(rng, 3, **plain, wave=lambda x: np.arcsin(np.sin(x)) * 2 / np.pi)),
    ):
        assert np.all(wrong.flags & int(DitherFlag.NOT_FOLLOWED | DitherFlag.MISFIT | DitherFlag.ALIASED))
    assert np.all(flags(volts, dither=90.0).flags == int(DitherFlag.TOO_SHORT))
    assert np.all(flags(volts[:, ::3], 3 * interval).flags & int(DitherFlag.ALIASED | DitherFlag.NOT_FOLLOWED))
    cut = np.zeros(volts.shape, dtype=bool)
    cut[1, 40] = True
    gaps = flags(volts, clipped=cut)
    assert (gaps.flags & int(DitherFlag.GAPS)).tolist() == [0, int(DitherFlag.GAPS), 0, 0]
    assert np.isnan(gaps.lock_in_rate[1])
    with pytest.raises(NoFit, match="dithered"):
        combine_dithered(flags(volts, dither=90.0))
    for bad in ({"scale_factor": 0.0}, {"dither_frequency": -1.0}):
        with pytest.raises(ValueError, match="positive"):
            estimate_dithered(volts, interval, **({"scale_factor": K, "dither_frequency": 400.0} | bad))
    with pytest.raises(ValueError, match="shape"):
        estimate_dithered(volts[:, :100], interval, scale_factor=K, dither_frequency=400.0)


def test_the_random_walk_of_counts():
    # science.md (2.13) and its table: 1.262e-4 deg/sqrt(s) for 0.05 deg/s at 50 deg/s and 500 pulses/deg
    assert lock_in_of_random_walk(1.262e-4, scale_factor=500, dither_rate=50) == pytest.approx(0.05, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("k", "true"), [(1000.0, 0.02), (3000.0, 0.15)])
def test_counts_tell_a_walk_of_hundredths_of_a_count(k, true):
    """Every turning point a step of the phase, which the counts cut to whole numbers."""
    rng = np.random.default_rng(5)
    per_walk = lock_in_of_random_walk(1.0, scale_factor=k, dither_rate=100.0)
    off, u = [], []
    for _ in range(5):
        found = walk_of_counts(hour_of_counts(rng, k, true, 100.0, 1000), 1.0, scale_factor=k)
        assert found.walks and found.random_walk_low_95 < found.random_walk < found.random_walk_high_95
        off.append((per_walk * found.random_walk - true) / (per_walk * found.random_walk_u))
        u.append(found.random_walk_u / found.random_walk)
    assert np.abs(off).max() < 3.5 and np.sqrt(np.mean(np.square(off))) < 1.6
    # no estimator has less than that of a walk that is seen without rounding
    assert 0.9 / np.sqrt(2000) < np.median(u) < 0.2


@pytest.mark.slow
def test_counts_that_are_no_walk_say_so():
    rng = np.random.default_rng(6)
    walk = hour_of_counts(rng, 2000.0, 0.05, 100.0, 1000)
    swing = np.rint(80 * np.sin(2 * np.pi * rng.uniform(size=1001))).astype(int)
    assert not walk_of_counts(walk + np.diff(swing), 1.0, scale_factor=2000.0).walks
    with pytest.raises(NoFit, match="longer gates"):
        walk_of_counts(np.full(1000, 3), 1.0, scale_factor=2000.0)
    with pytest.raises(ValueError, match="200 whole numbers"):
        walk_of_counts(walk + 0.5, 1.0, scale_factor=2000.0)
    with pytest.raises(ValueError, match="200 whole numbers"):
        walk_of_counts(walk[:150], 1.0, scale_factor=2000.0)
    with pytest.raises(ValueError, match="positive"):
        walk_of_counts(walk, 0.0, scale_factor=2000.0)
