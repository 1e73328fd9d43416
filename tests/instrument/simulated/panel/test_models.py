"""What B, C and TPS models have beyond the first series, and the delayed time base of all of them."""

import numpy as np
import pytest


def sine(times):
    return 2.0 * np.sin(2 * np.pi * 1000.0 * times)


def test_current_probe_exists_on_later_models_only(make_bench, fresh):
    bench = make_bench(model="TDS2014B")
    bench.write("HEADER ON")
    assert bench.ask("CH3:CURRENTPROBE 50;CURRENTPROBE?") == ":CH3:CURRENTPROBE 5.0E1"
    assert bench.events() == [401]
    fresh.write("CH3:CURRENTPROBE 50")
    assert fresh.events() == [401, 113]


def test_product_of_two_channels(make_bench, fresh):
    bench = make_bench({1: sine, 2: lambda times: np.full_like(times, 1.5)}, model="TPS2014", noise_levels=0.0)
    bench.write("HEADER OFF;:CH1:PROBE 1;SCALE 1;:CH2:PROBE 1;SCALE 1;:SELECT:CH2 ON;MATH ON;:DATA:SOURCE MATH")
    bench.write('MATH:DEFINE "CH1*CH2";VERTICAL:SCALE 2;POSITION 1')
    bench.single()
    assert bench.ask("MATH:DEFINE?") == '"CH1 * CH2"'
    assert bench.ask("WFMPRE:YMULT?;YOFF?;YUNIT?") == '8.0E-2;2.5E1;"VV"'
    assert bench.codes().max() == pytest.approx(25 + 3.0 / 0.08, abs=1)
    assert bench.codes().min() == pytest.approx(25 - 3.0 / 0.08, abs=1)
    fresh.write('MATH:DEFINE "CH1*CH2"')
    assert fresh.events() == [401, 2235]


def test_rms_of_the_whole_record_on_c_models(make_bench, fresh):
    bench = make_bench({1: lambda times: np.full_like(times, -1.4)}, model="TDS2024C", noise_levels=0.0)
    bench.write("HEADER OFF;:CH1:PROBE 1;SCALE 1;:MEASU:IMM:TYPE RMS")
    assert float(bench.ask("MEASU:IMM:VALUE?")) == pytest.approx(1.4, abs=1e-6)
    assert bench.ask("MEASU:IMM:UNITS?") == '"V"'
    fresh.write("MEASU:IMM:TYPE RMS")
    assert fresh.events() == [401, 102]


@pytest.mark.parametrize("position", [0.0, 1e-4, 1.25e-3])
def test_window_acquires_with_the_delayed_time_base(make_bench, position):
    bench = make_bench({1: sine}, noise_levels=0.0)
    bench.write("HEADER OFF;:CH1:PROBE 1;SCALE 0.5;:HOR:SCALE 1E-3;DELAY:SCALE 2.5E-5")
    bench.write(f"HOR:DELAY:POSITION {position};:HOR:VIEW WINDOW")
    bench.single()
    xincr, xzero = map(float, bench.ask("WFMPRE:XINCR?;XZERO?").split(";"))
    assert (xincr, xzero) == pytest.approx((1e-7, position - 1.25e-4))
    times = xzero + xincr * np.arange(2500)
    assert np.abs(bench.codes() * 0.02 - sine(times)).max() < 0.02
    for view in ("ZONE", "MAIN"):
        bench.write(f"HOR:VIEW {view}")
        bench.single()
        assert bench.ask("WFMPRE:XINCR?;XZERO?") == "4.0E-6;-5.0E-3"


def test_phase_of_two_channels_with_the_power_key(make_bench):
    late = {1: sine, 2: lambda times: sine(times - 125e-6)}  # an eighth of a period
    bench = make_bench(late, model="TPS2012", noise_levels=0.0)
    bench.write("HEADER OFF;:CH1:PROBE 1;SCALE 1;:CH2:PROBE 1;SCALE 1;:SELECT:CH2 ON;:MEASU:IMM:TYPE PHASE")
    bench.single()
    assert float(bench.ask("MEASU:IMM:VALUE?")) == pytest.approx(45.0, abs=1.0)
    bench.write("MEASU:IMM:SOURCE1 CH2;SOURCE2 CH1")
    assert float(bench.ask("MEASU:IMM:VALUE?")) == pytest.approx(-45.0, abs=1.0)
    assert bench.ask("MEASU:IMM:UNITS?;SOURCE?;SOURCE2?") == '"deg";CH2;CH1'
    bench.write("SELECT:CH1 OFF")
    assert bench.ask("MEASU:IMM:VALUE?") == "9.9E37"
    assert bench.events() == [401, 2225]


def test_rms_between_the_cursors_on_c_models(make_bench):
    bench = make_bench({1: lambda t: np.where(t % 1e-3 < 0.5e-3, 2.0, 1.0)}, model="TDS2014C", noise_levels=0.0)
    bench.write("HEADER OFF;:CH1:PROBE 1;SCALE 1;:TRIG:MAIN:LEVEL 1.5;:MEASU:IMM:TYPE CURSORRMS")
    bench.single()
    assert bench.ask("MEASU:IMM:VALUE?") == "9.9E37"
    assert bench.events() == [401, 2302]
    bench.write("CURSOR:FUNCTION VBARS;VBARS:POSITION1 0.1E-3;POSITION2 0.4E-3")
    assert float(bench.ask("MEASU:IMM:VALUE?")) == pytest.approx(2.0, abs=0.01)
    bench.write("CURSOR:VBARS:POSITION1 0.9E-3;POSITION2 0.6E-3")
    assert float(bench.ask("MEASU:IMM:VALUE?")) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("model", "answer"),
    [
        ("TDS2014", ':MEASUREMENT:IMMED:TYPE PERIOD;UNITS "s";SOURCE CH1'),
        ("TDS2014B", ':MEASUREMENT:IMMED:TYPE PERIOD;UNITS "s";SOURCE1 CH1'),
        ("TPS2012", ':MEASUREMENT:IMMED:TYPE PERIOD;UNITS "s";SOURCE1 CH1;SOURCE2 CH2'),
    ],
)
def test_header_of_the_source_of_a_measurement(make_bench, model, answer):
    bench = make_bench(model=model)
    bench.write("HDR ON")
    assert bench.ask("MEASU:IMMED?") == answer
    bench.write("MEASU:IMM:SOU CH2;SOURCE1 CH1")  # both spellings are taken by all of them
    assert bench.events() == [401]


def test_external_trigger_over_ten_exists_on_tps_only(make_bench, fresh):
    bench = make_bench(model="TPS2014")
    bench.write("HEADER ON")
    assert bench.ask("TRIG:MAI:EDGE:SOU EXT10;:TRIG:MAI:LEV 15;LEV?") == ":TRIGGER:MAIN:LEVEL 1.5E1"
    fresh.write("TRIG:MAI:EDGE:SOU EXT10")
    assert fresh.events() == [401, 102]
