"""A signal that tells its smooth part from its noise: fewer looks, the same statistics as one that does not."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from instrument.simulated.front_end.acquisition import DigitizedRecord, Digitizer
from instrument.simulated.front_end.frontend import Between, CoarseLook, slow_part
from instrument.simulated.front_end.trigger import Comparator, EdgeSearch, PulseSearch, first_edges
from instrument.simulated.panel.panel import PanelChannel, TriggerSettings

FREQUENCY = 163.7  # Hz


@dataclass
class Beat:
    """A sine of 1 V with a second harmonic and white noise; it counts how often it is looked at."""

    noise_rms: float = 0.01
    looks: int = 0
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(7))

    def __call__(self, times):
        return self.smooth(times) + self.noise(times)

    def smooth(self, times):
        self.looks += times.size
        turn = 2 * np.pi * FREQUENCY * times
        return np.sin(turn) + 0.1 * np.sin(2 * turn + 0.4)

    def noise(self, times):
        return self.noise_rms * self.rng.standard_normal(times.shape)

    def interval(self, start, stop):
        return 1 / (16 * FREQUENCY * 2)

    def bounds(self, start, stop):
        return -1.1, 1.1


def plain(beat):
    """The same as a function of which nothing is known."""
    return lambda times: beat(times)


KINDS = pytest.mark.parametrize("kind", [lambda beat: beat, plain], ids=["known", "plain"])


def bench_on(make_bench, signal, setup=""):
    bench = make_bench({1: signal}, noise_levels=0.0)
    bench.write("HEADER OFF;:CH1:PROBE 1;SCALE 0.3;:TRIG:MAIN:LEVEL 0.2;:HOR:SCALE 1E-4")
    bench.write(setup)
    return bench


def test_polynomials_pass_through_the_points_and_stay_within_them():
    values = np.sin(np.linspace(0.0, 3.0, 31))
    between = Between(5.0, 8.0, values)
    assert between(np.linspace(5.0, 8.0, 31)) == pytest.approx(values, abs=1e-12)
    times = np.linspace(5.0, 8.0, 777)
    assert between(times) == pytest.approx(np.sin(times - 5.0), abs=1e-7)
    asked = []
    CoarseLook(lambda at: (asked.append(at), np.sin(at))[1], 0.1)(times)
    assert min(map(np.min, asked)) >= 5.0 and max(map(np.max, asked)) <= 8.0 and sum(map(len, asked)) < 40


@pytest.mark.parametrize("limit", ["ON", "OFF"])
def test_noise_at_the_converter_has_its_rms(make_bench, limit):
    bench = bench_on(make_bench, Beat(0.06), f"CH1:BANDWIDTH {limit};:TRIG:MAIN:EDGE:SOURCE LINE")
    bench.single()
    codes = bench.codes().astype(float)
    place = np.linspace(-1, 1, 2500)
    rest = codes - np.polyval(np.polyfit(place, codes, 7), place)
    assert rest.std() == pytest.approx(0.06 * 25 / 0.3, rel=0.08)
    spectrum = np.abs(np.fft.rfft(rest))[20:] ** 2
    assert spectrum[: spectrum.size // 2].mean() == pytest.approx(spectrum[spectrum.size // 2 :].mean(), rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("slope", ["RISE", "FALL"])
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_trigger_has_the_same_jitter(make_bench, noise, slope):
    found = []
    for kind in (lambda beat: beat, plain):
        bench = bench_on(make_bench, kind(Beat(noise)), f"TRIG:MAIN:EDGE:SLOPE {slope}")
        bench.ask("CURVE?")
        phases = []
        for _ in range(120):
            bench.clock.sleep(0.013)
            bench.scope.acquisition.update()
            at = bench.scope.acquisition.record.starts[-1] + 5e-4
            phases.append(FREQUENCY * at % 1.0)
        found.append(np.array(phases))
    known, unknown = found
    spread = max(known.std(), unknown.std(), 1e-6)
    assert abs(known.mean() - unknown.mean()) < 5 * spread / np.sqrt(60)
    assert known.std() == pytest.approx(unknown.std(), rel=0.4, abs=2e-5)


def test_noise_beyond_the_hysteresis_triggers(make_bench):
    beat = Beat(0.3)
    bench = bench_on(make_bench, beat, "TRIG:MAIN:MODE NORMAL;LEVEL 1.7")
    bench.ask("*OPC?")
    bench.clock.sleep(0.2)
    assert int(bench.ask("ACQ:NUMACQ?")) > 3


def test_a_level_out_of_reach_is_passed_by_without_a_look(make_bench):
    beat = Beat()
    bench = bench_on(make_bench, beat, "HOR:SCALE 0.5;:TRIG:MAIN:MODE NORMAL;LEVEL 1.6")
    bench.clock.sleep(3.0)
    beat.looks = 0
    for _ in range(3):
        bench.clock.sleep(10.0)
        assert bench.ask("TRIG:STATE?") == "READY"
    assert beat.looks == 0
    # far below the level it has been armed: the first edge counts
    bench.write("TRIG:MAIN:LEVEL 0.2")
    bench.clock.sleep(0.1)
    assert bench.ask("TRIG:STATE?") == "TRIGGER"


def test_few_looks_tell_what_the_scope_shows(make_bench):
    beat = Beat()
    bench = bench_on(make_bench, beat)
    bench.codes()
    beat.looks = 0
    for _ in range(10):
        bench.clock.sleep(0.05)
        bench.ask("TRIG:STATE?")
        bench.codes()
    assert beat.looks < 10 * 1200


@pytest.mark.parametrize("base", ["1E-4", "1E-2"])
def test_peak_detect_shows_the_extremes_of_noise(make_bench, base):
    means = []
    for kind in (lambda beat: beat, plain):
        bench = bench_on(make_bench, kind(Beat(0.1)), f"HOR:SCALE {base};:ACQ:MODE PEAK")
        bench.single()
        codes = bench.codes().astype(float)
        means.append(codes[1::2] - codes[::2])
    if base == "1E-4":
        # the plain one is random at each look of the filter
        assert means[0].mean() == pytest.approx(2 * 2.37 * 0.1 * 25 / 0.3, rel=0.05)
    assert means[0].mean() >= 0.9 * means[1].mean()


def test_coupling_takes_away_what_it_takes_from_any_signal():
    beat = Beat(0.0)
    times = 3.0 + 1e-4 * np.arange(900)
    turn = 2j * np.pi * FREQUENCY * times
    gains = 1 / (1 + 1j * FREQUENCY / 10.0), 1 / (1 + 2j * FREQUENCY / 10.0)
    expected = (gains[0] * np.exp(turn) + 0.1 * gains[1] * np.exp(2 * turn + 0.4j)).imag
    assert np.abs(slow_part(beat, times) - expected).max() < 4e-3


@KINDS
def test_looks_of_an_average_are_kept(make_bench, kind):
    beat = Beat(0.05)
    bench = bench_on(make_bench, kind(beat), "HOR:SCALE 1E-2;:ACQ:MODE AVERAGE;NUMAVG 16")
    bench.single()
    bench.codes()
    codes = bench.codes().astype(float)
    # third differences leave nothing of the beat, and sqrt(1 + 9 + 9 + 1) times the noise of 16 looks, rounded;
    # of one look it would be four times that
    noise = np.hypot(0.05 * 25 / 0.3 / 4, 1 / np.sqrt(12))
    assert np.diff(codes, 3).std() == pytest.approx(
        np.sqrt(20) * noise, rel=0.15
    )  # of one look it is four times that


def test_a_search_goes_on_where_smooth_looks_are_known_up_to_its_end_only():
    """Behind what is searched the table changes its rate: from there on nothing is known of the signal."""

    def smooth(times):
        return np.sin(2 * np.pi * 5.0 * times - 1.0)

    def interval(start, stop):
        return 1e-3 if stop <= 1.0 else 0.0

    search = EdgeSearch(Comparator(smooth, interval=interval), 0.0, True, 0.1, 0.0)
    found = search.advance(0.9, 1e-5, now=2.0)
    # armed from the first negative values on: the first rising zero is at 1/(2 pi 5) s
    assert found == pytest.approx(1.0 / (2 * np.pi * 5.0), abs=1e-4)


def one_edge(volts_at, rising, ready_at):
    until = ready_at + 0.05
    return EdgeSearch(volts_at, 0.2, rising, 0.09, ready_at).advance(until, 1e-6, until)


@pytest.mark.parametrize("rising", [True, False])
def test_many_edges_at_once_are_those_of_one_search_after_the_other(rising):
    ready = 10.0 + np.cumsum(np.random.default_rng(5).uniform(7e-3, 20e-3, 300))
    spreads = []
    for noise in (0.0, 0.01):
        beat = Beat(noise)
        volts_at = Comparator(beat.smooth, beat.noise, noise, beat.interval, beat.bounds)
        edges = first_edges(EdgeSearch(volts_at, 0.2, rising, 0.09, 0.0), ready, 8e-3, 1e-6)
        each = np.array([one_edge(volts_at, rising, when) for when in ready])
        assert not np.isnan(edges).any()
        apart = edges - each
        apart -= np.rint(apart * FREQUENCY) / FREQUENCY  # noise at the hysteresis arms one of them a period later
        spreads.append(apart.std())
        assert abs(apart.mean()) < 1e-9 + 5 * apart.std() / np.sqrt(len(apart))
    assert spreads[0] < 2e-9 and 2e-6 < spreads[1] < 4e-5


def test_averages_after_a_silence_are_those_of_a_scope_that_was_asked_all_the_time(make_bench):
    shown = []
    for naps, nap in ((1, 12.0), (400, 0.01)):  # 20 ms for each message
        bench = bench_on(make_bench, Beat(0.01), "HOR:SCALE 1E-3;:ACQ:MODE AVERAGE;NUMAVG 64")
        bench.codes()
        for _ in range(naps):
            bench.clock.sleep(nap)
            bench.ask("TRIG:STATE?")
        shown.append(bench.codes().astype(float))
        assert 550 < int(bench.ask("ACQ:NUMACQ?")) < 760
        assert len(bench.scope.acquisition.record.starts) == 64
    rest = shown[0] - shown[1]
    assert np.ptp(shown[0]) > 160 and abs(rest.mean()) < 0.5 and rest.std() < 2.5


def test_an_average_that_goes_on_is_the_one_made_anew():
    channel = PanelChannel(0.3, 0.0, "DC", 1.0, limited=True, inverted=False, time_constant=8e-9)
    starts = 10.0 + np.cumsum(np.random.default_rng(6).uniform(0.02, 0.03, 30))
    going_on = Digitizer(lambda name: Beat(0.0), 0.0, 1)
    for number in range(10):
        latest = tuple(starts[number : number + 16].tolist())
        record = DigitizedRecord(number, latest, -0.01, 2e-3, "AVERAGE", {"CH1": channel})
        codes = going_on.codes(record, "CH1").astype(int)
    anew = Digitizer(lambda name: Beat(0.0), 0.0, 1).codes(record, "CH1").astype(int)
    assert np.abs(codes - anew).max() <= 1 and np.ptp(anew) > 20


def test_what_was_taken_was_taken_with_the_settings_before(make_bench):
    """The trigger of a sweep that nobody has asked for yet is looked for before its level is changed."""
    bench = bench_on(make_bench, Beat(0.0), "HOR:SCALE 1E-4")
    bench.codes()
    bench.clock.sleep(1.0)
    bench.write("TRIG:MAIN:LEVEL 0.9;:ACQ:STATE OFF")
    record = bench.scope.acquisition.record
    height = Beat(0.0).smooth(np.array([record.starts[-1] - record.xzero]))[0]
    assert height == pytest.approx(0.2, abs=0.02)
    assert bench.clock.now() - 0.2 < record.starts[-1] < bench.clock.now()


def test_the_state_after_a_silence_is_every_one_in_its_turn(make_bench):
    bench = bench_on(make_bench, Beat(0.0), "HOR:SCALE 2.5E-3")
    bench.codes()
    states = []
    for _ in range(300):
        bench.clock.sleep(1.0)
        states.append(bench.ask("TRIG:STATE?"))
    # 12.5 ms before the trigger, 3 ms on the mean for it, 12.5 ms behind it, 5.6 ms dead
    shares = {state: states.count(state) / len(states) for state in set(states)}
    assert shares["ARMED"] == pytest.approx(0.54, abs=0.15) and shares["TRIGGER"] == pytest.approx(0.37, abs=0.15)
    assert 0.01 < shares["READY"] < 0.25


@pytest.mark.parametrize(("noise", "triggers"), [(0.0, False), (0.012, True)])
def test_noise_lifts_a_pulse_over_the_hysteresis(noise, triggers):
    beat = Beat(noise)
    peak = beat.smooth(np.linspace(0.0, 1 / FREQUENCY, 10_000)).max()
    level = peak - 0.08  # the hysteresis is a little more: 0.8 of the noise is missing
    trigger = TriggerSettings("NORMAL", "PULSE", "CH1", "DC", "RISE", level, 0.0, "POSITIVE", "INSIDE", 8e-3)
    volts_at = Comparator(beat.smooth, beat.noise, noise, beat.interval, beat.bounds)
    search = PulseSearch(trigger, volts_at, 0.09, 0.0)
    assert (search.advance(0.5, 1e-5, 0.5) is not None) == triggers


def ringing(height, phase, points):
    """A slow sine with a faster one, which is left within the hysteresis of 0.1 V or crosses it several times."""

    def smooth(times):
        return np.sin(2 * np.pi * 7.3 * times) + height * np.sin(2 * np.pi * FREQUENCY * times + phase)

    return Comparator(smooth, interval=lambda start, stop: 1 / (points * FREQUENCY)), Comparator(smooth)


@pytest.mark.parametrize(
    ("height", "phase", "points"),
    [
        (0.0, 0.3, 20),
        (0.06, 0.3, 20),
        (0.12, 0.3, 10),
        (0.3, 0.3, 10),
        (0.1725, 4.778, 6.26),
        (0.1763, 3.164, 6.17),
    ],
)
@pytest.mark.parametrize(
    ("when", "width"), [("INSIDE", 4e-3), ("EQUAL", 68.5e-3), ("NOTEQUAL", 68.5e-3), ("OUTSIDE", 50e-3)]
)
def test_pulses_are_those_that_many_looks_find(when, width, height, phase, points):
    trigger = TriggerSettings("NORMAL", "PULSE", "CH1", "DC", "RISE", 0.0, 0.0, "POSITIVE", when, width)
    found = []
    for volts_at in ringing(height, phase, points):
        pulses, search = [], PulseSearch(trigger, volts_at, 0.1, 0.013)
        while len(pulses) < 8 and (pulse := search.advance(1.5, 2e-5, 1.5)) is not None:
            pulses.append(pulse)
            search = PulseSearch(trigger, volts_at, 0.1, pulse + 1e-4)
        found.append(pulses)
    few, many = found
    assert few == pytest.approx(many, abs=1e-4)
    assert len(many) == 8 or height < 0.3 or when != "INSIDE"


@dataclass
class Ending(Beat):
    """A beat that ends."""

    ends: float = 7.0

    def smooth(self, times):
        return np.where(times < self.ends, super().smooth(times), -0.1)

    def interval(self, start, stop):
        return 0.0 if start < self.ends < stop else super().interval(start, stop)


@KINDS
@pytest.mark.parametrize(("acquire", "records"), [("SAMPLE", 1), ("AVERAGE;NUMAVG 16", 16)])
@pytest.mark.parametrize("silence", [6.999, 7.3, 25.0])
def test_a_signal_that_ends_while_nobody_asks_leaves_its_last_records(make_bench, kind, acquire, records, silence):
    bench = bench_on(
        make_bench, kind(Ending(0.01)), f"TRIG:MAIN:MODE NORMAL;:HOR:SCALE 2.5E-3;:ACQ:MODE {acquire}"
    )
    bench.clock.sleep(silence)
    codes = bench.codes().astype(int)
    record = bench.scope.acquisition.record
    triggers = np.array(record.starts) - record.xzero
    assert len(triggers) == records and np.ptp(codes) > 150
    # one takes 25 ms and 3 to 9 ms more; the last one that fits was triggered at most two of them before the end
    assert 7.0 - 0.08 < triggers[-1] < 7.0 and triggers[0] > 7.0 - 0.75
    assert (np.diff(triggers) > 0.025).all() and bench.ask("TRIG:STATE?") in ("READY", "ARMED")
    bench.clock.sleep(3.0)
    assert (bench.codes() == codes).all()
