"""Bandwidth, trigger coupling, pulse width and video trigger."""

import numpy as np
import pytest

from instrument.simulated.front_end.frontend import low_pass
from instrument.simulated.panel.models import MODELS


def tone(frequency, amplitude=2.0):
    return lambda times: amplitude * np.sin(2 * np.pi * frequency * times)


def pulses(*widths, period=1e-3, low=0.0, high=3.0):
    """Pulses of these widths in turn, one every period."""

    def signal(times):
        number = np.floor(times / period).astype(int)
        width = np.asarray(widths)[number % len(widths)]
        return np.where(times - number * period < width, high, low)

    return signal


def swing(bench):
    """Half the peak-to-peak codes."""
    bench.single()
    codes = bench.codes().astype(float)
    return (codes.max() - codes.min()) / 2


@pytest.mark.parametrize(
    ("scale", "frequency"),
    [("2.5E-8", 20e6), ("2.5E-8", 50e6), ("1E-3", 1.037e6), ("1E-3", 20.037e6), ("1E-3", 50.037e6)],
)
def test_bandwidth_limit_is_a_pole_at_20_mhz(make_bench, scale, frequency):
    bench = make_bench({1: tone(frequency)}, noise_levels=0.0)
    bench.write(f"CH1:PROBE 1;SCALE 1;BANDWIDTH ON;:HOR:SCALE {scale};:TRIG:MAIN:EDGE:SOURCE LINE")
    assert swing(bench) == pytest.approx(50 / np.hypot(1, frequency / 20e6), abs=1.6)


@pytest.mark.parametrize(("model", "bandwidth"), [("TDS2014", 100e6), ("TDS2024", 200e6), ("TDS1002", 60e6)])
def test_full_bandwidth_is_that_of_the_model(make_bench, model, bandwidth):
    bench = make_bench({1: tone(bandwidth)}, model=model, noise_levels=0.0)
    bench.write("CH1:PROBE 1;SCALE 1;:HOR:SCALE 1E-8;:TRIG:MAIN:EDGE:SOURCE LINE")
    assert swing(bench) == pytest.approx(50 / np.sqrt(2), abs=1.5)


def test_sensitive_scales_have_20_mhz_only(make_bench):
    bench = make_bench({1: tone(20e6, 4e-3)}, noise_levels=0.0)
    bench.write("CH1:PROBE 1;SCALE 2E-3;:HOR:SCALE 2.5E-8;:TRIG:MAIN:EDGE:SOURCE LINE")
    assert swing(bench) == pytest.approx(50 / np.sqrt(2), abs=1.5)
    bench.write("CH1:SCALE 5E-3")
    assert swing(bench) == pytest.approx(20 / np.hypot(1, 0.2), abs=1.0)


def test_peak_detect_has_75_mhz(make_bench):
    bench = make_bench({1: tone(75e6)}, noise_levels=0.0)
    bench.write("CH1:PROBE 1;SCALE 1;:HOR:SCALE 1E-3;:TRIG:MAIN:EDGE:SOURCE LINE;:ACQ:MODE PEAK")
    assert swing(bench) == pytest.approx(50 / np.sqrt(2), abs=1.5)
    bench.write("CH1:BANDWIDTH ON")
    assert swing(bench) == pytest.approx(50 / np.hypot(1, 75 / 20), abs=1.5)


@pytest.mark.parametrize("interval", [1e-9, 3.3e-8, 1e-7, 1.3e-6, 1e-4])
@pytest.mark.parametrize("frequency", [1e3, 1e5, 1.1e6, 3.7e6, 21e6])
def test_filter_is_a_pole_however_far_apart_the_samples_lie(interval, frequency):
    constant = 1 / (2 * np.pi * 20e6)
    times = 5.0 + interval * np.arange(400)
    gain = 1 / (1 + 1j * frequency / 20e6)
    expected = np.imag(gain * np.exp(2j * np.pi * frequency * times))
    assert np.abs(low_pass(tone(frequency, 1.0), constant)(times) - expected).max() < 0.006


@pytest.mark.parametrize("interval", [1e-9, 4e-8, 1e-6])
def test_filter_answers_a_step_with_an_exponential(interval):
    """Also where a single sample among many sees what is left of the step."""
    constant = 1 / (2 * np.pi * 20e6)
    times = interval * (np.arange(200) - 100.0)
    for part in (0.3, 1.0, 2.2, 3.0, 3.9, 5.0):
        edge = -part * constant
        expected = np.where(times > edge, 1 - np.exp(-np.maximum(times - edge, 0) / constant), 0.0)
        filtered = low_pass(lambda t, edge=edge: np.where(t > edge, 1.0, 0.0), constant)(times)
        assert np.abs(filtered - expected).max() < 0.01


def test_filter_hardly_costs_anything_on_slow_signals():
    looks = 0

    def slow(times):
        nonlocal looks
        looks += len(times)
        return np.sin(2 * np.pi * 800.0 * times)

    low_pass(slow, 8e-9)(1e-6 * np.arange(2500))
    assert looks <= 4 * 2500


def test_filter_delays_a_ramp_by_its_time_constant():
    times = np.linspace(0.0, 1e-6, 7)
    assert low_pass(lambda t: 1e6 * t, 8e-9)(times) == pytest.approx(1e6 * (times - 8e-9), abs=1e-4)


def test_every_model_names_its_bandwidth():
    # data sheets, MHz
    named = {"TDS1001B": 40, "TDS1002B": 60, "TDS2001C": 50, "TDS2002B": 60, "TDS2004C": 70, "TDS2014": 100}
    named |= {"TDS2012C": 100, "TDS2022B": 200, "TPS2024": 200, "TBS1022": 25, "TBS1072B": 70, "TBS1152B": 150}
    for name, megahertz in named.items():
        assert MODELS[name].bandwidth == megahertz * 1e6


def takes_a_record(bench):
    """Whether NORMAL mode finds a trigger within 3 s."""
    bench.write("TRIG:MAIN:MODE NORMAL;:ACQUIRE:STOPAFTER SEQUENCE;STATE RUN")
    if bench.ask("*OPC?", timeout=3.0) == "1":
        return True
    bench.link.clear()
    return False


@pytest.mark.slow
@pytest.mark.parametrize(
    ("coupling", "frequency", "triggers"),
    [
        ("DC", 1e3, True),
        ("HFREJ", 1e3, True),
        ("HFREJ", 1e6, False),  # 80 kHz: 2 V becomes 0.16 V, less than the hysteresis
        ("LFREJ", 1e6, True),
        ("LFREJ", 20e3, False),  # 300 kHz: 2 V becomes 0.13 V
    ],
)
def test_coupling_rejects_what_the_manual_says(make_bench, coupling, frequency, triggers):
    bench = make_bench({1: tone(frequency)}, noise_levels=0.0)
    bench.write(f"CH1:PROBE 1;SCALE 1;:HOR:SCALE 2.5E-5;:TRIG:MAIN:EDGE:COUPLING {coupling}")
    assert takes_a_record(bench) == triggers


@pytest.mark.parametrize(("coupling", "triggers"), [("DC", True), ("NOISEREJ", False)])
def test_noise_reject_halves_the_sensitivity(make_bench, coupling, triggers):
    bench = make_bench({1: tone(1e3, 0.45)}, noise_levels=0.0)
    bench.write(f"CH1:PROBE 1;SCALE 1;:TRIG:MAIN:EDGE:COUPLING {coupling}")
    assert takes_a_record(bench) == triggers


def pulse_bench(make_bench, signal, when, width, polarity="POSITIVE"):
    bench = make_bench({2: signal}, noise_levels=0.0)
    bench.write("SELECT:CH1 OFF;CH2 ON;:DATA:SOURCE CH2;:CH2:PROBE 1;SCALE 1;:HOR:SCALE 1E-4")
    bench.write("TRIG:MAIN:TYPE PULSE;PULSE:SOURCE CH2")
    bench.write(f"TRIG:MAIN:PULSE:WIDTH:POLARITY {polarity};WHEN {when};WIDTH {width}")
    bench.write("TRIG:MAIN:LEVEL 1.5")
    return bench


@pytest.mark.slow
@pytest.mark.parametrize(
    ("when", "width", "shown"),
    [  # pulses of 100, 200 and 300 us; s from the leading edge to the trigger, and the width of the pulse shown
        ("EQUAL", 2e-4, (2e-4, 2e-4)),
        ("EQUAL", 2.5e-4, None),
        ("EQUAL", 1.91e-4, (2e-4, 2e-4)),  # within 5 %
        ("EQUAL", 1.89e-4, None),
        ("INSIDE", 1.5e-4, (1e-4, 1e-4)),
        ("INSIDE", 0.9e-4, None),
        ("OUTSIDE", 2.5e-4, (2.5e-4, 3e-4)),
        ("OUTSIDE", 3.2e-4, None),
        ("NOTEQUAL", 1.2e-4, None),
    ],
)
def test_pulse_trigger_picks_its_pulse(make_bench, when, width, shown):
    bench = pulse_bench(make_bench, pulses(1e-4, 2e-4, 3e-4), when, width)
    taken = takes_a_record(bench)
    if when == "NOTEQUAL":
        assert taken
    elif shown is None:
        assert not taken
    else:
        assert taken
        high = np.flatnonzero(bench.codes() > 37)
        start, end = -5e-4 + 4e-7 * high[0], -5e-4 + 4e-7 * (high[-1] + 1)
        assert (-start, end - start) == pytest.approx(shown, abs=1.5e-6)


def test_not_equal_triggers_at_either_side_of_the_width(make_bench):
    for width, lead in ((2e-4, 1e-4), (0.5e-4, 0.525e-4)):
        bench = pulse_bench(make_bench, pulses(1e-4), "NOTEQUAL", width)
        assert takes_a_record(bench)
        start = -5e-4 + 4e-7 * np.flatnonzero(bench.codes() > 37)[0]
        assert -start == pytest.approx(lead, abs=1.5e-6)
    assert not takes_a_record(pulse_bench(make_bench, pulses(1e-4), "NOTEQUAL", 1e-4))


def test_negative_pulses_are_the_gaps(make_bench):
    gaps = pulses(7e-4, 8e-4, low=0.0)
    assert takes_a_record(pulse_bench(make_bench, gaps, "EQUAL", 3e-4, "NEGATIVE"))
    assert takes_a_record(pulse_bench(make_bench, gaps, "EQUAL", 2e-4, "NEGATIVE"))
    assert not takes_a_record(pulse_bench(make_bench, gaps, "EQUAL", 7e-4, "NEGATIVE"))
    assert not takes_a_record(pulse_bench(make_bench, gaps, "EQUAL", 2e-4, "POSITIVE"))


def test_short_pulses_are_seen_on_a_slow_sweep(make_bench):
    bench = pulse_bench(make_bench, pulses(2e-6, 5e-6), "EQUAL", 2e-6)
    bench.write("HOR:SCALE 1E-3")
    assert takes_a_record(bench)


@pytest.mark.slow
def test_video_trigger_without_video_finds_no_sync(make_bench):
    bench = make_bench({1: tone(1e3)}, noise_levels=0.0)
    bench.write("TRIG:MAIN:TYPE VIDEO;VIDEO:SYNC LINENUM;LINE 17;STANDARD PAL;POLARITY INVERT")
    assert bench.ask("HEADER OFF;:TRIG:MAIN:VIDEO?") == "CH1;LINENUM;INVERT;17;PAL"
    assert not takes_a_record(bench)
    bench.write("TRIG:MAIN:MODE AUTO")
    assert bench.ask("*OPC?") == "1"


def test_level_belongs_to_the_source_of_the_trigger_in_use(make_bench):
    bench = make_bench({})
    bench.write("CH1:PROBE 1;SCALE 1;:CH2:PROBE 1;SCALE 0.1;:TRIG:MAIN:LEVEL 5;PULSE:SOURCE CH2")
    assert bench.ask("TRIG:MAIN:LEVEL?") == ":TRIGGER:MAIN:LEVEL 5.0E0"
    bench.write("TRIG:MAIN:TYPE PULSE")
    assert bench.ask("TRIG:MAIN:LEVEL?") == ":TRIGGER:MAIN:LEVEL 8.0E-1"
