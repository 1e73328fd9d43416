"""Measurements, cursors, math, spectrum and the picture of the screen."""

import io

import numpy as np
import pytest
from PIL import Image


def both(times):
    return 2.0 * np.sin(2 * np.pi * 1000 * times)


def square(times):
    return np.where((500.0 * np.asarray(times)) % 1.0 < 0.25, 1.5, -0.5)


@pytest.fixture
def measured(make_bench):
    """A sine on channel 1 and a pulse of 25 % on channel 2, both well on the screen."""
    bench = make_bench({1: both, 2: square}, noise_levels=0.2)
    bench.write("HEADER OFF;:CH1:PROBE 1;SCALE 1;:CH2:PROBE 1;SCALE 0.5;:SELECT:CH2 ON")
    bench.single()
    assert bench.events() == [401]
    return bench


@pytest.mark.parametrize(
    ("source", "kind", "value", "unit"),
    [
        ("CH1", "FREQUENCY", 1000.0, "Hz"),
        ("CH1", "PERIOD", 1e-3, "s"),
        ("CH1", "MEAN", 0.0, "V"),
        ("CH1", "PK2PK", 4.0, "V"),
        ("CH1", "CRMS", np.sqrt(2), "V"),
        ("CH1", "MINIMUM", -2.0, "V"),
        ("CH1", "MAXIMUM", 2.0, "V"),
        ("CH1", "RISE", 2 * np.arcsin(0.8) / (2 * np.pi * 1000), "s"),
        ("CH1", "FALL", 2 * np.arcsin(0.8) / (2 * np.pi * 1000), "s"),
        ("CH2", "PWIDTH", 0.5e-3, "s"),
        ("CH2", "NWIDTH", 1.5e-3, "s"),
        ("CH2", "PERIOD", 2e-3, "s"),
        ("CH2", "PK2PK", 2.0, "V"),
    ],
)
def test_measurements_of_known_signals(measured, source, kind, value, unit):
    measured.write(f"MEASUREMENT:IMMED:SOURCE {source};TYPE {kind}")
    assert float(measured.ask("MEASUREMENT:IMMED:VALUE?")) == pytest.approx(
        value, rel=0.03, abs=0.03 * (unit == "V")
    )
    assert measured.ask("MEASUREMENT:IMMED:UNITS?") == f'"{unit}"'
    assert measured.ask("MEASUREMENT:IMMED?") == f'{kind};"{unit}";{source}'
    measured.write(f"MEASUREMENT:MEAS3:SOURCE {source};TYPE {kind}")
    assert measured.ask("MEASU:MEAS3:VAL?") == measured.ask("MEASU:IMM:VAL?")
    assert measured.events() == []


@pytest.mark.parametrize(
    ("setup", "event"),
    [
        ("MEASU:IMM:SOURCE CH3", 2225),
        ("MEASU:IMM:SOURCE CH1;:DISPLAY:FORMAT XY", 221),
        ("HOR:SCALE 0.25;:ACQ:STATE RUN", 221),
        ("CH1:COUPLING GND;:ACQ:STATE RUN;*WAI", 2204),
        ("HOR:SCALE 5E-5;:ACQ:STATE RUN;*WAI", 2202),
        ("HOR:SCALE 1E-4;POSITION 2E-4;:ACQ:STATE RUN;*WAI", 2202),
    ],
)
def test_impossible_measurements_give_9_9e37_and_an_event(measured, setup, event):
    measured.write(setup)
    assert measured.ask("MEASU:IMM:VALUE?") == "9.9E37"
    assert measured.events() == [event]


def test_measurement_that_is_not_active(measured):
    assert measured.ask("MEASU:MEAS1:VALUE?") == "9.9E37"
    assert measured.events() == [2231]


@pytest.mark.parametrize(("setup", "event"), [("", 547), ("POSITION 4", 548), ("POSITION -4", 549)])
def test_clipping_is_a_warning_beside_the_value(measured, setup, event):
    measured.write(f"CH1:SCALE {0.2 if event == 547 else 1};{setup};:ACQ:STATE RUN;*WAI;:MEASU:IMM:TYPE PK2PK")
    assert float(measured.ask("MEASU:IMM:VALUE?")) < 4.0
    assert measured.events() == [event]


def test_cursor_differences_and_limits(measured):
    measured.write("CURSOR:FUNCTION HBARS;SELECT:SOURCE CH1;:CURSOR:HBARS:POSITION1 -1;POSITION2 9")
    assert measured.ask("CURSOR:HBARS:DELTA?;UNITS?;POSITION2?") == "5.0E0;VOLTS;4.0E0"
    measured.write("CURSOR:VBARS:POSITION1 -1E-3;POSITION2 1")
    assert measured.ask("CURSOR:VBARS:POSITION2?;DELTA?") == "2.5E-3;3.5E-3"
    measured.write("CURSOR:VBARS:UNITS HERTZ")
    assert measured.ask("CURSOR:VBARS:POSITION2?") == "4.0E2"


@pytest.mark.parametrize(("expression", "sign"), [("CH1+CH2", 1), ("ch1 - ch2", -1), ("CH2-CH1", 1)])
def test_math_adds_and_subtracts(measured, expression, sign):
    measured.write("CH2:SCALE 1;:ACQ:STATE RUN;*WAI")
    first = measured.codes().astype(int)
    measured.write("DATA:SOURCE CH2")
    second = measured.codes().astype(int)
    measured.write(f"MATH:DEFINE '{expression}';:SELECT:MATH ON;:DATA:SOURCE MATH")
    expected = first + sign * second if expression != "CH2-CH1" else second - first
    assert np.array_equal(measured.codes(), np.clip(expected, -127, 127))
    assert measured.ask("WFMPRE:WFID?;YMULT?;YUNIT?") == (
        '"Math, DC coupling, 1.0E0 V/div, 5.0E-4 s/div, 2500 points, Sample mode";4.0E-2;"Volts"'
    )


def test_math_of_unequal_scales_has_no_scale(measured):
    measured.write("SELECT:MATH ON;:DATA:SOURCE MATH")
    assert measured.ask("WFMPRE:YMULT?;YUNIT?;:MATH:DEFINE?") == '0.0E0;"U";"CH1 - CH2"'


@pytest.mark.parametrize("window", ["HANNING", "FLATTOP", "RECTANGULAR"])
def test_spectrum_has_the_axis_of_the_manual_and_the_level_of_the_signal(measured, window):
    measured.write(f"CH1:SCALE 0.5;:ACQ:STATE RUN;*WAI;:MATH:DEFINE 'FFT (CH1, {window})'")
    measured.write("SELECT:MATH ON;:DATA:SOURCE MATH;ENC ASCI;:MATH:FFT:VERTICAL:POSITION -1")
    fields = measured.ask("WFMPRE?").split(";")
    assert fields[5] == "1024" and fields[10] == "0.0E0" and fields[11] == '"Hz"' and fields[15] == '"dB"'
    # the manual's example at 500 us/div, and YZERO of a real file at 0.5 V/div
    assert '"Math, DC coupling, 1.0E1 dB/div, 2.52525253E4 Hz/div, 1024 points, Sample mode"' in fields
    assert float(fields[13]) == pytest.approx(-26.98970, abs=1e-4)
    codes = np.array(measured.ask("CURVE?").split(","), dtype=int)
    assert len(codes) == 1024 and codes.min() >= -100
    levels = (codes - float(fields[14])) * float(fields[12]) + float(fields[13])
    line = 1 + int(np.argmax(levels[1:]))
    assert line * float(fields[8]) == pytest.approx(1000.0, abs=float(fields[8]))
    # 2 V amplitude are 3.01 dB over 1 V rms; a flat-topped window shows it between the lines too
    loss = {"HANNING": 1.5, "FLATTOP": 0.5, "RECTANGULAR": 4.0}[window]
    assert 3.01 - loss <= levels[line] <= 3.6


def test_spectrum_axis_of_a_real_file(make_bench):
    bench = make_bench({1: both})
    bench.write("HEADER OFF;:HOR:SCALE 1E-2;:MATH:DEFINE 'FFT(CH1)';:SELECT:MATH ON;:DATA:SOURCE MATH")
    bench.single()
    assert float(bench.ask("WFMPRE:XINCR?")) == pytest.approx(12.33033, rel=1e-6)
    assert bench.ask("MATH:DEFINE?") == '"FFT(CH1,HANNING)"'


def test_hard_copy_is_a_real_picture_of_the_screen(measured):
    answer = measured.ask_raw("HARDCOPY:FORMAT BMP;PORT GPIB;:HARDCOPY START")
    picture = Image.open(io.BytesIO(answer))
    assert picture.format == "BMP" and picture.size == (320, 240) and picture.mode == "P"
    assert len(picture.getcolors()) >= 5  # paper, graticule, frame, two traces
    assert len(answer) == 14 + 40 + 1024 + 320 * 240
    measured.write("HARDCOPY:PORT CENTRONICS;:HARDCOPY START")
    assert measured.read(0.1) is None


def test_self_tests_answer(fresh):
    fresh.write("HEADER OFF")
    assert fresh.ask("*TST?;*CAL?;:CALIBRATE:STATUS?;:DIAG:RESULT:FLAG?") == "0;0;PASS;PASS"
    assert fresh.ask("DIAG:RESULT:LOG?;:ERRLOG:FIRST?") == '"pass-CPU, pass-ACQ1, pass-EXTENSION";""'
