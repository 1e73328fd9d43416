import tracemalloc

import numpy as np
import pytest
from reference import adler_beat, bound, random_records, slow_fit

from analysis import FATAL, Flag, beat_signal, combine_estimates, estimate_lock_in, flag_names, harmonic_ratio

N = np.arange(2500)
R = 0.05  # ratio of the hand-made beats


def one_record(rng, *, periods=40.3, x=0.1, amplitude=90.0, noise=0.7, **more):
    k = periods / 2500 / np.sqrt(1 - x * x)
    volts = beat_signal(
        N,
        scale_factor=k,
        input_rate=1.0,
        lock_in_rate=x,
        amplitude=amplitude,
        initial_phase=rng.uniform(0, 6),
        **more,
    )
    return k, np.rint(volts + rng.normal(scale=noise, size=2500))


@pytest.mark.parametrize("periods", [2.7, 5.3, 41.7])
def test_without_noise_the_value_is_exact(periods):
    """Double precision to the end: single would show at 1e-10."""
    u = np.exp(1j * (2 * np.pi * periods / 2500 * N + 0.7))
    volts = 0.3 + (1j * (0.2 - u) / (1 - 0.2 * u) * np.exp(0.4j)).imag
    e = estimate_lock_in(volts, 1.0, scale_factor=1.0)
    assert float(e.ratio) == pytest.approx(0.2, rel=2e-12)
    assert float(e.noise_rms) < 2e-12


@pytest.mark.slow
def test_the_error_stands_at_the_cramer_rao_bound():
    rng = np.random.default_rng(20)
    times, records, truths, noises = random_records(
        rng, 200, x_range=(2, 50), noise_range=(0.3, 2), periods_range=(5, 300)
    )
    errors = []
    for volts, truth, noise in zip(records, truths, noises, strict=True):
        estimate = estimate_lock_in(volts, 1.0, scale_factor=truth["k"])
        errors.append((float(estimate.lock_in_rate) - truth["wl"]) / bound(times, truth, noise))
    assert np.sqrt(np.mean(np.square(errors))) < 1.1
    assert abs(np.mean(errors)) < 0.25


@pytest.mark.parametrize("x_range", [(1.02, 1.3), (1.5, 4), (10, 80)])
def test_the_value_is_that_of_a_slow_maximum_likelihood_fit(x_range):
    rng = np.random.default_rng(21)
    times, records, truths, noises = random_records(
        rng, 12, x_range=x_range, noise_range=(0.3, 2), periods_range=(2.6, 500)
    )
    for volts, truth, noise in zip(records, truths, noises, strict=True):
        estimate = estimate_lock_in(volts, 1.0, scale_factor=truth["k"])
        u = bound(times, truth, noise)
        assert float(np.abs(estimate.complex_ratio)) >= 0
        size = np.abs(estimate.complex_ratio)
        raw = float(estimate.beat_frequency) / truth["k"] * 2 * size / (1 - size**2)
        assert raw == pytest.approx(slow_fit(times, volts, truth), abs=0.02 * u)
        assert float(estimate.lock_in_rate_u) == pytest.approx(u, rel=0.12)


def test_the_interval_covers_also_where_the_ratio_drowns():
    rng = np.random.default_rng(22)
    for x in (0.0, 0.002, 0.005, 0.02, 0.3):
        k = 0.0201 / np.sqrt(1 - x * x)
        volts = beat_signal(
            N,
            scale_factor=k,
            input_rate=1.0,
            lock_in_rate=x,
            amplitude=60,
            initial_phase=rng.uniform(0, 6.3, 1000),
            backscatter_phase=rng.uniform(0, 6.3, 1000),
        )
        e = estimate_lock_in(volts + rng.normal(size=volts.shape), 1.0, scale_factor=k)
        covered = (e.lock_in_rate_low_95 <= x) & (x <= e.lock_in_rate_high_95)
        # Binomial standard deviation 0.7 %: three of them.
        assert abs(covered.mean() - 0.95) < 0.021, x


def test_either_sense_and_both_references_agree():
    rng = np.random.default_rng(23)
    for rate in (0.2, -0.2):
        volts = beat_signal(
            N * 1e-5 * 4, scale_factor=2000, input_rate=rate, lock_in_rate=0.05, backscatter_phase=1.2
        ) + rng.normal(scale=0.01, size=2500)
        own = estimate_lock_in(volts, 4e-5, scale_factor=2000)
        given = estimate_lock_in(volts, 4e-5, scale_factor=2000, input_rate=rate)
        for e in (own, given):
            assert abs(float(e.lock_in_rate) - 0.05) < 4 * float(e.lock_in_rate_u)
        assert float(own.input_rate) == pytest.approx(0.2, rel=1e-3)
        assert float(given.input_rate) == rate
        assert float(given.backscatter_phase) == pytest.approx(1.2, abs=0.02)


def test_the_papers_relations_carry_their_bias():
    volts = beat_signal(N * 4e-5, scale_factor=2000, input_rate=0.2, lock_in_rate=0.1)
    for relation, percent in (("paper-13", -5.5305), ("paper-10", 7.1797)):
        e = estimate_lock_in(volts, 4e-5, scale_factor=2000, input_rate=0.2, relation=relation)
        assert 100 * (float(e.lock_in_rate) / 0.1 - 1) == pytest.approx(percent, abs=1e-3)


def test_a_stack_gives_what_each_record_gives_alone():
    rng = np.random.default_rng(24)
    pairs = [one_record(rng, x=x, periods=p) for x, p in ((0.02, 30.3), (0.7, 30.3), (0.97, 4.4), (0.2, 400.2))]
    stack = np.array([volts for _, volts in pairs])
    together = estimate_lock_in(stack.reshape(2, 2, -1), 1.0, scale_factor=0.02)
    assert together.lock_in_rate.shape == (2, 2)
    for value, volts in zip(together.lock_in_rate.ravel(), stack, strict=True):
        alone = estimate_lock_in(volts, 1.0, scale_factor=0.02)
        # The batch may carry more harmonics than the record needs, and sums round: far below its uncertainty.
        assert float(alone.lock_in_rate) == pytest.approx(value, abs=1e-2 * float(alone.lock_in_rate_u))


@pytest.mark.slow
@pytest.mark.parametrize("limit", [110.0, 95.0])
def test_clipping_is_found_and_leaves_no_bias(limit):
    rng = np.random.default_rng(25)
    x, k = 0.2, 0.0201 / np.sqrt(1 - 0.04)
    volts = beat_signal(
        N,
        scale_factor=k,
        input_rate=1.0,
        lock_in_rate=x,
        amplitude=100 if limit < 100 else 120,
        initial_phase=rng.uniform(0, 6, 200),
        backscatter_phase=rng.uniform(0, 6, 200),
    )
    codes = np.clip(np.rint(volts + rng.normal(scale=0.8, size=volts.shape)), -limit, limit)
    e = estimate_lock_in(codes, 1.0, scale_factor=k)
    assert all("clipped" in flag_names(f) for f in e.flags)
    z = (e.lock_in_rate - x) / e.lock_in_rate_u
    assert abs(z.mean()) < 0.25
    assert np.sqrt((z**2).mean()) < 1.15
    # A fit that believes the clipped samples is wrong by far more.
    told = estimate_lock_in(codes, 1.0, scale_factor=k, clipped=np.zeros(codes.shape, bool))
    assert np.abs(told.lock_in_rate - x).mean() > 3 * np.abs(e.lock_in_rate - x).mean()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("amplitude", "volts_per_code"), [(127.9, 1.0), (130.0, 1.0), (136.0, 1.0), (129.0, 0.0371), (136.0, 0.0371)]
)
def test_clipping_by_a_level_is_found_whatever_the_sampling(amplitude, volts_per_code):
    """In codes from less than half a code on, in volts from 1.5; also at 10, 15, 20 and 25 samples per period."""
    rng = np.random.default_rng(34)
    codes, truths = [], []
    for periods in (250.05, 166.62, 125.02, 100.03, 77.7):
        for x in (0.05, 0.2, 0.6):
            k = periods / 2500 / np.sqrt(1 - x * x)
            beat = beat_signal(
                N,
                scale_factor=k,
                input_rate=1.0,
                lock_in_rate=x,
                amplitude=amplitude,
                initial_phase=rng.uniform(0, 6, 20),
                backscatter_phase=rng.uniform(0, 6, 20),
            )
            codes.append(np.clip(np.rint(beat + rng.normal(scale=0.4, size=beat.shape)), -127, 127))
            truths += [2 * np.pi * periods / 2500 * x / np.sqrt(1 - x * x)] * 20
    volts = np.concatenate(codes) * volts_per_code
    e = estimate_lock_in(volts, 1.0, scale_factor=1 / (2 * np.pi))
    z = (e.lock_in_rate - truths) / e.lock_in_rate_u
    assert np.sqrt((z**2).mean()) < 1.15
    assert np.abs(z).max() < 5
    if volts_per_code == 1:
        assert all("clipped" in flag_names(f) for f in e.flags)


def test_a_crest_in_the_last_but_one_code_is_not_called_clipped():
    rng = np.random.default_rng(35)
    beat = beat_signal(
        N,
        scale_factor=0.0213,
        input_rate=1.0,
        lock_in_rate=0.1,
        amplitude=120.45,
        initial_phase=rng.uniform(0, 6, 50),
    )
    codes = np.rint(beat + rng.normal(scale=0.1, size=beat.shape))
    e = estimate_lock_in(codes * 0.0371, 1.0, scale_factor=0.0213)
    assert not any("clipped" in flag_names(f) for f in e.flags)


def test_spikes_are_left_out():
    rng = np.random.default_rng(26)
    k, volts = one_record(rng)
    clean = estimate_lock_in(volts, 1.0, scale_factor=k)
    volts[[100, 1300, 2000]] += (60, -90, 40)
    spiked = estimate_lock_in(volts, 1.0, scale_factor=k)
    assert "damaged" in flag_names(int(spiked.flags))
    assert float(spiked.lock_in_rate) == pytest.approx(
        float(clean.lock_in_rate), abs=0.3 * float(clean.lock_in_rate_u)
    )


def flags_of(volts, **more):
    return flag_names(int(estimate_lock_in(volts, 1.0, scale_factor=0.02, **more).flags))


def test_each_flag_is_raised_by_its_cause_and_not_without():
    rng = np.random.default_rng(27)
    assert flags_of(one_record(rng)[1]) == []
    assert "constant" in flags_of(np.full(2500, 3.0))
    assert "no_beat" in flags_of(rng.normal(size=2500))
    assert "few_periods" in flags_of(one_record(rng, periods=2.4)[1])
    assert "second_harmonic_above_nyquist" in flags_of(one_record(rng, periods=700.3)[1])
    assert "harmonics_aliased" in flags_of(one_record(rng, periods=833.4, x=0.5)[1])
    assert "ratio_not_significant" in flags_of(one_record(rng, x=1e-5)[1])
    second_tone = one_record(rng)[1] + 20 * np.cos(N * 0.777)
    assert "misfit" in flags_of(second_tone)
    missing = one_record(rng)[1]
    missing[5:50] = np.nan
    assert "damaged" in flags_of(missing, nan_policy="omit")
    square = np.where(np.sin(0.05 * N) > 0, 50.0, -50.0) + rng.normal(scale=0.5, size=2500)
    assert "not_lock_in_like" in flags_of(square)


@pytest.mark.parametrize(("error", "periods"), [(2.4, 40.3), (0.4, 40.3), (1.05, 12.7), (0.99, 90.1)])
def test_a_given_rate_that_is_not_the_beats_is_named(error, periods):
    rng = np.random.default_rng(31)
    for sense in (1.0, -1.0):
        k, volts = one_record(rng, periods=periods)
        given = {"scale_factor": k, "input_rate": sense * error}
        assert flag_names(int(estimate_lock_in(volts, 1.0, **given).flags)) == ["rate_mismatch"]


def test_a_beat_above_half_the_sampling_rate_is_named_by_the_rate_it_is_given():
    rng = np.random.default_rng(32)
    for _ in range(20):
        k, volts = one_record(rng, periods=2500 * rng.uniform(0.52, 0.95))
        found = estimate_lock_in(volts, 1.0, scale_factor=k, input_rate=1.0)
        assert int(found.flags) & int(Flag.RATE_MISMATCH | FATAL)


@pytest.mark.slow
def test_the_right_rate_is_never_called_wrong():
    rng = np.random.default_rng(33)
    records = [one_record(rng, periods=rng.uniform(3, 400), x=rng.uniform(0, 0.9), noise=3.0) for _ in range(300)]
    for k, volts in records:
        found = estimate_lock_in(volts, 1.0, scale_factor=k, input_rate=-1.0)
        assert not int(found.flags) & int(Flag.RATE_MISMATCH)


def averaged(rng, jitter):
    """Sixteen beats whose phase at the start scatters by `jitter` rad, averaged as AVErage mode does."""
    k, w = 0.02, 2 * np.pi * 30.3 / 2500
    u = np.exp(1j * (w * N + rng.normal(scale=jitter, size=(16, 1))))
    beats = 80 * (1j * (R - u) / (1 - R * u)).imag + rng.normal(scale=1.0, size=(16, 2500))
    return k, np.rint(beats.mean(axis=0))


def test_an_average_over_a_moving_phase_is_known_by_its_amplitude():
    """A phase that scatters by s costs the fundamental 1 - exp(-s^2/2), and the ratio three times as much."""
    rng = np.random.default_rng(30)
    k, steady = averaged(rng, 0.0)
    k, moving = averaged(rng, 0.3)
    good, bad = (estimate_lock_in(v, 1.0, scale_factor=k, full_amplitude=80.0) for v in (steady, moving))
    assert "amplitude_lost" not in flag_names(int(good.flags))
    assert "amplitude_lost" in flag_names(int(bad.flags))
    assert float(good.ratio) == pytest.approx(R, abs=4 * float(good.ratio_u))
    assert float(bad.ratio) < R - 10 * float(bad.ratio_u)
    assert float(bad.amplitude) == pytest.approx(80 * np.exp(-(0.3**2) / 2), rel=0.05)


def test_averages_over_a_random_phase_are_known_by_their_scatter():
    rng = np.random.default_rng(31)
    steady = np.array([averaged(rng, 0.0)[1] for _ in range(6)])
    moving = np.array([averaged(rng, 2.0)[1] for _ in range(6)])
    names = [
        flag_names(int(combine_estimates(estimate_lock_in(v, 1.0, scale_factor=0.02)).flags))
        for v in (steady, moving)
    ]
    assert "amplitude_lost" not in names[0]
    assert "amplitude_lost" in names[1]


def test_rounding_that_repeats_with_the_beat_is_flagged_and_paid_for():
    """Fifty samples a period and no noise: the same fifty rounding errors in each of fifty periods."""
    rng = np.random.default_rng(32)
    theta, delta = rng.uniform(0, 6.28, (2, 300, 1))
    u = np.exp(1j * (2 * np.pi * N / 50 + theta))
    z = 1j * (R - u) / (1 - R * u)
    codes = np.rint(60.3 * (z.real * np.sin(delta) + z.imag * np.cos(delta)))
    e = estimate_lock_in(codes, 1.0, scale_factor=0.02)
    assert all("rounding_repeats" in flag_names(f) for f in e.flags)
    wl = 1.0 * 2 * R / (1 - R**2)
    inside = (e.lock_in_rate_low_95 <= wl) & (wl <= e.lock_in_rate_high_95)
    assert inside.mean() > 0.9
    by_hand = 12**-0.5 * np.sqrt(2 / 50) / 60.3 / R
    assert np.median(e.lock_in_rate_u / wl) == pytest.approx(by_hand, rel=0.2)


@pytest.mark.parametrize("samples_per_period", [5, 6, 7, 8, 9, 10, 12, 15])
@pytest.mark.parametrize("r", [0.03, 0.17, 1 / 3, 0.6])
def test_harmonics_that_fold_almost_onto_the_fundamental_do_no_harm(samples_per_period, r):
    """Each batch of its own, since the largest ratio of a batch says how many harmonics are summed."""
    rng = np.random.default_rng(36)
    periods = 2500 / samples_per_period + 0.05
    u = np.exp(1j * (2 * np.pi * periods / 2500 * N + rng.uniform(0, 2 * np.pi, (60, 1))))
    turned = 1j * (r - u) / (1 - r * u) * np.exp(1j * rng.uniform(0, 2 * np.pi, (60, 1)))
    codes = np.rint(120 * turned.imag + rng.normal(scale=0.4, size=(60, 2500)))
    e = estimate_lock_in(codes, 1.0, scale_factor=1.0)
    z = (e.ratio - r) / e.ratio_u
    assert np.sqrt((z**2).mean()) < 1.35


def test_the_blank_of_scan_mode_is_a_missing_sample():
    codes = one_record(np.random.default_rng(33))[1].astype(np.int8)
    floats = codes.astype(float)
    codes[100:140], floats[100:140] = -128, np.nan
    told = estimate_lock_in(floats, 1.0, scale_factor=0.02, nan_policy="omit")
    for kind in (np.int8, np.int16, np.float32, np.float64):
        raw = estimate_lock_in(codes.astype(kind), 1.0, scale_factor=0.02)
        assert "damaged" in flag_names(int(raw.flags))
        assert float(raw.lock_in_rate) == pytest.approx(float(told.lock_in_rate), rel=1e-9)


def test_a_blank_does_not_hide_the_last_code():
    rng = np.random.default_rng(37)
    u = np.exp(1j * (2 * np.pi * 47.3 / 2500 * N + rng.uniform(0, 2 * np.pi, (100, 1))))
    codes = np.rint(127.8 * (1j * (0.1 - u) / (1 - 0.1 * u)).imag + rng.normal(scale=0.4, size=(100, 2500)))
    codes = np.clip(codes, -127, 127)
    codes[:, 1000:1200] = -128
    e = estimate_lock_in(codes, 1.0, scale_factor=1.0)
    assert all({"clipped", "damaged"} <= set(flag_names(f)) for f in e.flags)
    assert np.sqrt((((e.ratio - 0.1) / e.ratio_u) ** 2).mean()) < 1.25


def test_volts_that_happen_to_reach_minus_128_are_no_blank():
    volts = one_record(np.random.default_rng(33))[1] + 0.25
    volts *= -128 / volts.min()
    e = estimate_lock_in(volts, 1.0, scale_factor=0.02)
    assert flag_names(int(e.flags)) == []


def test_no_number_is_given_where_it_would_mean_nothing():
    rng = np.random.default_rng(28)
    e = estimate_lock_in(rng.normal(size=(3, 2500)), 1.0, scale_factor=0.02)
    assert np.all(np.isnan(e.lock_in_rate)) and not e.usable.any()
    combined = combine_estimates(e)
    assert int(combined.records) == 0 and int(combined.records_rejected) == 3
    assert int(combined.flags) & FATAL


@pytest.mark.slow
def test_combining_is_coherent_and_unbiased():
    """Twenty records of ratio 1.4 u each: the mean of sizes would be 20 % high."""
    rng = np.random.default_rng(29)
    x, k = 0.0004, 0.0201
    z, covered = [], []
    for _ in range(150):
        volts = beat_signal(
            N, scale_factor=k, input_rate=1.0, lock_in_rate=x, amplitude=100, initial_phase=rng.uniform(0, 6, 20)
        )
        c = combine_estimates(
            estimate_lock_in(volts + rng.normal(scale=0.5, size=volts.shape), 1.0, scale_factor=k)
        )
        z.append((float(c.lock_in_rate) - x) / float(c.lock_in_rate_u))
        covered.append(float(c.lock_in_rate_low_95) <= x <= float(c.lock_in_rate_high_95))
    assert abs(np.mean(z)) < 0.3
    assert 0.9 <= np.mean(covered) <= 0.99
    assert np.std(z) == pytest.approx(1.0, abs=0.2)


def test_scatter_beyond_the_noise_enlarges_the_uncertainty():
    rng = np.random.default_rng(30)
    rates = 0.2 * (1 + 0.05 * rng.normal(size=15))
    volts = beat_signal(
        N * 4e-5, scale_factor=2000, input_rate=0.5, lock_in_rate=rates, initial_phase=rng.uniform(0, 6, 15)
    )
    volts = volts + rng.normal(scale=0.005, size=volts.shape)
    c = combine_estimates(estimate_lock_in(volts, 4e-5, scale_factor=2000))
    assert "scatter" in c.noise_model
    assert float(c.lock_in_rate_u) == pytest.approx(0.01 / np.sqrt(15), rel=0.5)


def turning(phases, frequencies=None, noise=0.5, lock_in_rate=0.005):
    """Records of WL/W = 0.1 at 2 kHz/deg and 0.05 deg/s, each with its own backscatter phase and rate."""
    rng = np.random.default_rng(40)
    rates = 0.05 * np.ones(len(phases)) if frequencies is None else np.asarray(frequencies)
    volts = beat_signal(
        N * 4e-4,
        scale_factor=2000,
        input_rate=rates,
        lock_in_rate=lock_in_rate,
        amplitude=90,
        backscatter_phase=np.asarray(phases),
        initial_phase=rng.uniform(0, 6, len(phases)),
    )
    return estimate_lock_in(volts + rng.normal(scale=noise, size=volts.shape), 4e-4, scale_factor=2000)


def test_sizes_are_averaged_where_phases_turn():
    """Complex values that turn by a radian would give 16 % less."""
    together = combine_estimates(turning(np.linspace(0, 2.0, 10)))
    assert abs(float(together.lock_in_rate) - 0.005) < 4 * float(together.lock_in_rate_u) < 1e-4
    assert "phase_turns" in flag_names(int(together.flags)) and not int(together.flags) & Flag.MISFIT
    steady = combine_estimates(turning(np.full(10, 0.7)))
    assert "phase_turns" not in flag_names(int(steady.flags))
    # phases that single records do not show are no phases
    weak = combine_estimates(turning(np.linspace(0, 3.0, 10), noise=60.0))
    assert "phase_turns" not in flag_names(int(weak.flags))


def test_the_scatter_of_beats_belongs_to_their_mean():
    rates = [0.05] * 22 + [0.0491] * 8  # a bench that was restarted
    together = combine_estimates(turning(np.zeros(30), rates))
    assert "beat_wanders" in flag_names(int(together.flags))
    assert "records_differ" not in flag_names(int(together.flags))
    assert float(together.beat_frequency_u) == pytest.approx(2000 * 0.0009 * np.sqrt(22 * 8 / 30**3), rel=0.1)
    # each record is its own reference: that is no uncertainty of the lock-in rate
    assert float(together.lock_in_rate_u) < 1e-5
    known = combine_estimates(turning(np.zeros(30), rates), np.array(rates))
    assert "beat_wanders" not in flag_names(int(known.flags))


def test_records_of_another_state_are_told():
    """Their mean is no lock-in rate of either; twice the noise may be the noise that was taken too small."""
    u = float(turning(np.zeros(2)).lock_in_rate_u.mean())
    for apart, told in ((20 * u, True), (4 * u, False)):
        together = combine_estimates(turning(np.zeros(18), lock_in_rate=0.005 - np.repeat([0.0, apart], [12, 6])))
        assert "scatter" in together.noise_model
        assert ("records_differ" in flag_names(int(together.flags))) == told


@pytest.mark.parametrize("copies", [2, 10])
def test_copies_count_once(copies):
    one, other = turning([0.3, 0.3])[0:1], turning([0.3, 0.3])
    many = combine_estimates(other[np.tile([0, 1], copies)])
    assert (int(many.records), int(many.records_rejected)) == (2, 2 * copies - 2)
    assert float(many.lock_in_rate_u) == float(combine_estimates(other).lock_in_rate_u)
    alone = combine_estimates(one[np.zeros(copies, dtype=int)])
    assert float(alone.lock_in_rate_u) == float(one.lock_in_rate_u[0])


@pytest.mark.parametrize("hertz", [49.9, 60.1, 100.0])
def test_mains_hum_is_no_beat(hertz):
    rng, times = np.random.default_rng(41), N * 2e-4
    hum = np.rint(90 * np.sin(2 * np.pi * hertz * times) + rng.normal(scale=0.5, size=2500))
    assert {"no_beat", "mains"} <= set(flag_names(int(estimate_lock_in(hum, 2e-4, scale_factor=2000).flags)))
    elsewhere = estimate_lock_in(hum, 2e-4, scale_factor=2000, mains_hz=400.0)
    assert not int(elsewhere.flags) & (Flag.NO_BEAT | Flag.MAINS)
    # a gyro whose beat happens to lie there has a second harmonic
    near = beat_signal(times, scale_factor=2000, input_rate=hertz / 2000 / 0.995, lock_in_rate=0.1 * hertz / 1990)
    codes = np.rint(90 * near + rng.normal(scale=0.5, size=2500))
    for mains, said in ((None, []), (50.0 if hertz != 60.1 else 60.0, ["mains_beside"])):
        found = estimate_lock_in(codes, 2e-4, scale_factor=2000, mains_hz=mains)
        assert flag_names(int(found.flags)) == said


@pytest.mark.parametrize("contrast", [0.5, 0.99])
def test_shot_noise_is_no_damage(contrast):
    """More light, more noise: by a factor of ten between the dark and the bright part of the beat."""
    rng = np.random.default_rng(42)
    waves = [
        beat_signal(N, scale_factor=0.02, input_rate=1.0, lock_in_rate=0.1, initial_phase=a) for a in range(60)
    ]
    photons = rng.poisson(1e4 * (1 + contrast * np.array(waves))) / 1e4
    codes = np.rint(80 / contrast * (photons - 1) + rng.normal(scale=0.3, size=photons.shape))
    flags = estimate_lock_in(codes, 1.0, scale_factor=0.02).flags
    assert not np.any(flags & (Flag.DAMAGED | Flag.MISFIT))


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "size"), [("thresholds", 0.3), ("widths", 0.3)])
def test_the_codes_of_a_converter_count_by_what_they_show(kind, size):
    """DNL of 0.3 levels in another converter each time: no misfit, and an uncertainty of the size of the error."""
    rng, z = np.random.default_rng(43), []
    doubtful = 0
    for _ in range(60):
        x, noise, phase = 10 ** rng.uniform(-1.3, -0.4), rng.uniform(0.3, 1.5), rng.uniform(0, 6)
        k = rng.uniform(8, 120) / 2500 / np.sqrt(1 - x * x)
        wave = beat_signal(
            N,
            scale_factor=k,
            input_rate=1.0,
            lock_in_rate=x,
            amplitude=95,
            initial_phase=phase,
            readout_phase=phase,
        )
        steps = size * rng.normal(size=254)
        if kind == "widths":
            steps = np.cumsum(steps)
            steps -= np.linspace(steps[0], steps[-1], 254)
        edges = np.sort(np.arange(-127, 127) + 0.5 + steps)
        codes = np.searchsorted(edges, wave + rng.normal(scale=noise, size=2500)) - 127.0
        found = estimate_lock_in(codes, 1.0, scale_factor=k)
        z.append((float(found.ratio) - float(harmonic_ratio(x))) / float(found.ratio_u))
        doubtful += bool(int(found.flags) & Flag.MISFIT)
    assert doubtful <= 9  # all but a few of the widths were, and u ten times the error
    assert 0.4 < np.sqrt(np.mean(np.square(z))) < 1.5


def test_records_of_both_senses_combine_when_the_rate_is_given():
    senses = np.array([0.2, -0.2, 0.2, -0.2])
    rng = np.random.default_rng(31)
    volts = beat_signal(
        N * 4e-5, scale_factor=2000, input_rate=senses, lock_in_rate=0.02, backscatter_phase=0.8
    ) + rng.normal(scale=0.01, size=(4, 2500))
    c = combine_estimates(estimate_lock_in(volts, 4e-5, scale_factor=2000, input_rate=senses))
    assert abs(float(c.lock_in_rate) - 0.02) < 3 * float(c.lock_in_rate_u)
    assert float(c.ratio) == pytest.approx(float(harmonic_ratio(0.1)), rel=0.02)


def test_records_of_the_negative_sense_alone_keep_their_ratio():
    rng = np.random.default_rng(36)
    k, w = 0.02, -30.3 / 2500 / 0.02 / np.sqrt(1 - 0.01)
    volts = np.array(
        [
            beat_signal(N, scale_factor=k, input_rate=w, lock_in_rate=-0.1 * w, amplitude=90, readout_phase=0.7)
            + rng.normal(size=2500)
            for _ in range(5)
        ]
    )
    each = estimate_lock_in(volts, 1.0, scale_factor=k, input_rate=w)
    together = combine_estimates(each)
    assert complex(together.complex_ratio) == pytest.approx(complex(each.complex_ratio.mean()), abs=1e-4)
    assert float(each[0].reshaped().lock_in_rate) == float(each.lock_in_rate[0])


def test_the_reference_waveform_is_ours():
    """`adler_beat` and `beat_signal` were written independently; they must mean the same gyro."""
    truth = {"f_over_k": 0.3, "wl": 0.4, "k": 0.05, "theta": 0.3, "delta": 0.9, "amplitude": 2.0, "offset": 0.0}
    start = 2 * np.arctan(0.8 + 0.6 * np.tan(0.3))
    ours = beat_signal(
        N,
        scale_factor=0.05,
        input_rate=0.5,
        lock_in_rate=0.4,
        amplitude=2.0,
        initial_phase=start,
        readout_phase=0.9,
    )
    np.testing.assert_allclose(adler_beat(N.astype(float), **truth), ours, atol=1e-8)


def test_single_precision_input_gives_the_same():
    volts = 0.01 * one_record(np.random.default_rng(34))[1]
    double, single = (estimate_lock_in(v, 1.0, scale_factor=0.02) for v in (volts, volts.astype(np.float32)))
    assert float(single.lock_in_rate) == pytest.approx(
        float(double.lock_in_rate), abs=0.01 * float(double.lock_in_rate_u)
    )


def test_memory_does_not_grow_with_the_batch():
    """Beyond what one part of the batch needs, a record adds a few hundred bytes of results."""
    volts = np.tile(one_record(np.random.default_rng(35))[1].astype(np.float32), (6000, 1))
    peaks = []
    for n_records in (2000, 6000):
        tracemalloc.start()
        estimate_lock_in(volts[:n_records], 1.0, scale_factor=0.02)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] - peaks[0] < 4000 * 2000


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"scale_factor": 0.0}, "scale_factor"),
        ({"scale_factor": np.nan}, "scale_factor"),
        ({"sample_interval": 0.0}, "sample_interval"),
        ({"volts": np.zeros(5)}, "8 samples"),
        ({"volts": np.full(100, -np.inf)}, "infinite"),
        ({"volts": np.where(np.arange(100) == 37, np.nan, np.sin(N[:100] * 0.5))}, "nan .* sample 37 "),
        ({"volts": np.zeros(100), "nan_policy": "ignore"}, "nan_policy"),
        ({"volts": np.full(100, 2**60)}, "overflow"),
        ({"sample_interval": np.inf}, "sample_interval"),
        ({"input_rate": np.nan}, "input_rate"),
        ({"input_rate": np.ones(3)}, "broadcast|shape"),
        ({"relation": "exactly"}, "relation"),
    ],
)
def test_bad_input_is_named(change, word):
    good = {"volts": np.sin(N * 0.1), "sample_interval": 1.0, "scale_factor": 2000.0}
    with pytest.raises(ValueError, match=word):
        estimate_lock_in(**(good | change))


def test_all_nan_and_nearly_all_nan_records_are_flagged_not_fatal_to_the_batch():
    rng = np.random.default_rng(32)
    _, good = one_record(rng)
    nearly = np.full(2500, np.nan)
    nearly[:9] = np.arange(9) % 2
    records = np.array([good, np.full(2500, np.nan), nearly])
    e = estimate_lock_in(records, 1.0, scale_factor=0.02, nan_policy="omit")
    assert e.usable.tolist() == [True, False, False]
    assert int(e.flags[2]) & Flag.TOO_FEW_SAMPLES


def test_estimates_show_themselves():
    rng = np.random.default_rng(33)
    _, good = one_record(rng)
    e = estimate_lock_in([good, good, np.zeros(2500)], 1.0, scale_factor=0.02)
    assert len(e) == 3
    assert [one.flags.shape for one in e] == [(), (), ()]
    rate = f"{float(e.lock_in_rate[0]):.6g}"
    assert repr(e).startswith(f"<LockInEstimate of 3 records: {rate} to {rate} deg/s, u ")
    assert "constant" in repr(e)
    assert repr(e[0]).startswith(f"<LockInEstimate: {rate} deg/s, u ")
    assert repr(e[2]).startswith("<LockInEstimate: no lock-in rate; ")
    assert "of 1 x 3 records" in repr(e.reshaped(1, 3))
    assert repr(e[:0]) == "<LockInEstimate of 0 records: no lock-in rate; no flags>"
    assert e._repr_html_().count("<tr>") == e.reshaped(1, 3)._repr_html_().count("<tr>") == 4
    assert e[0]._repr_html_().count(f"<td>{rate}</td>") == 1
    with pytest.raises(TypeError, match="unsized"):
        len(e[0])
    from matplotlib.figure import Figure

    axes = Figure().subplots()
    assert e.plot(axes) is axes
    assert axes.get_xlabel() == "record"
