"""What later models answer otherwise, and their own commands; short forms; service requests."""

import numpy as np
import pytest

LATER = ["TDS2014B", "TDS2024C", "TPS2014"]


@pytest.mark.parametrize("model", LATER)
def test_later_models_come_without_headers(make_bench, model):
    bench = make_bench(model=model)
    assert bench.ask("CH1:COUPLING?") == "DC"
    assert bench.ask("HDR ON;:HDR?") == ":HEADER 1"
    assert bench.ask("*RST;:CH1:COUPLING?") == ":CH1:COUPLING DC"
    bench.write("HEADER OFF")
    assert bench.ask("FACTORY;:CH1:COUPLING?") == ":CH1:COUPLING DC"  # FACtory turns them on on every model


def test_the_first_series_comes_with_headers(fresh):
    assert fresh.ask("CH1:COUPLING?") == ":CH1:COUPLING DC"


@pytest.mark.parametrize(("firmware", "events"), [("v22.16", [401, 113]), ("v24.02", [401])])
def test_b_models_have_rms_from_firmware_24_on(make_bench, firmware, events):
    bench = make_bench(model="TDS2024B", identity=f"TEKTRONIX,TDS 2024B,C100044,CF:91.1CT FV:{firmware}")
    bench.write("MEASUREMENT:METHOD MINMAX")
    assert bench.events() == events
    bench.write("MEASUREMENT:MEAS1:TYPE RMS")
    assert bench.events() == ([] if events == [401] else [102])


def test_values_of_a_real_instrument(make_bench):
    """A TDS2024 at 20 mV a level: 4.98 less 4.88 V, and 4.96 less 4.82 V, in its own arithmetic."""
    volts = {"PK2PK": "9.99999046E-2", "MAXIMUM": "4.9800000191E0", "MINIMUM": "4.8800001144E0"}
    bench = make_bench({1: lambda t: np.where(t % 1e-2 < 5e-3, 4.98, 4.88)}, noise_levels=0.0)
    bench.write("HEADER OFF;:CH1:PROBE 1;SCALE 0.5;POSITION -9.76;:HOR:SCALE 5E-2;:TRIG:MAIN:LEVEL 4.93")
    bench.single()
    for kind, answer in volts.items():
        assert bench.ask(f"MEASU:IMM:TYPE {kind};VALUE?") == answer
    bench.write("CH1:POSITION -9.64")
    # an edge from one sample to the next lasts no sample at all; all times are whole samples
    assert bench.ask("MEASU:IMM:TYPE RISE;VALUE?") == "0.0E0"
    assert bench.ask("MEASU:IMM:TYPE PERIOD;VALUE?") == "9.9999998E-3"
    assert bench.ask("MEASU:IMM:TYPE CRMS;VALUE?").startswith("4.93")
    assert bench.events() == [401]  # five levels are enough


@pytest.mark.parametrize(
    ("shape", "word"),
    [
        (lambda t: np.sin(2 * np.pi * 1e3 * t), "SINE"),
        (lambda t: np.sign(np.sin(2 * np.pi * 1e3 * t)), "SQUARE"),
        (lambda t: (1e3 * t) % 1.0, "OTHER"),
        (lambda t: np.full_like(t, 0.3), "LEVEL"),
    ],
)
def test_autoset_tells_the_kind_of_signal(make_bench, shape, word):
    bench = make_bench({1: shape}, noise_levels=0.0)
    assert bench.ask("AUTOSET:SIGNAL?") == ":AUTOSET:SIGNAL NONE"
    bench.write("AUTOSET EXECUTE")
    assert bench.ask("AUTOSET:SIGNAL?") == f":AUTOSET:SIGNAL {word}"


def test_cursors_of_later_models_stand_on_the_waveform(make_bench):
    ramp = {1: lambda t: 1e3 * ((t + 5e-3) % 10e-3 - 5e-3)}  # 1 V/ms through zero at the trigger
    bench = make_bench(ramp, model="TPS2012", noise_levels=0.0)
    bench.write("CH1:PROBE 1;SCALE 2;:HOR:SCALE 5E-4;:CURSOR:VBARS:POSITION1 -1E-3;POSITION2 1E-3")
    bench.single()
    assert bench.ask("CURSOR:VBARS:VDELTA?") == "9.9E37"
    assert bench.events() == [401, 2302]
    bench.write("CURSOR:FUNCTION VBARS")
    assert float(bench.ask("CURSOR:VBARS:VDELTA?")) == pytest.approx(2.0, abs=0.1)
    assert float(bench.ask("CURSOR:VBARS:HDELTA?")) == pytest.approx(2e-3)
    assert float(bench.ask("CURSOR:VBARS:HPOS1?")) == pytest.approx(-1.0, abs=0.1)
    assert float(bench.ask("CURSOR:VBARS:SLOPE?")) == pytest.approx(1e3, rel=0.05)
    bench.write("CURSOR:SELECT:SOURCE CH2")
    assert bench.ask("CURSOR:VBARS:HPOS2?") == "9.9E37"
    assert bench.events() == [2303]


@pytest.mark.parametrize(
    ("model", "message", "answer"),
    [
        ("TPS2014", "POWER:AC:PRESENT?", "1"),
        ("TPS2014", "POWER:BATTERY2:GASGAUGE?", "100"),
        ("TPS2014", "POWER:BATTERY1:STATUS?", "FULLYCHARGED"),
        ("TPS2014", "POWER:BUTTONLIGHT OFF;BUTTONLIGHT?", "0"),
        ("TPS2014", "DISPLAY:BRIGHTNESS 40;BRIGHTNESS?", "45"),
        ("TPS2012", "HARMONICS:SELECT 3;SELECT?", "3"),
        ("TPS2012", "SWLOSS:SOURCES CH1CH2;SOURCES?", "CH1CH2"),
        ("TBS1072B", "MEASUREMENT:MEAS6:TYPE PK2PK;TYPE?", "PK2PK"),
        ("TBS1102B", "ZOOM:STATE ON;STATE?", "1"),
        ("TDS2002B", "AUTOSET:ENABLE OFF;ENABLE?", "0"),
        ("TDS2014B", "PICTBRIDGE:PAPERSIZE A4;PAPERSIZE?;:PICTBRIDGE:DEF;PAPERSIZE?", "A4;DEFLT"),
        ("TDS2014C", "HARDCOPY:BUTTON PRINTS;BUTTON?", "PRINTS"),
    ],
)
def test_commands_of_one_series(make_bench, fresh, model, message, answer):
    assert make_bench(model=model).ask(message) == answer
    fresh.write(message.split(";")[0])
    assert fresh.events() == [401, 113]


def test_the_power_key_of_a_tps(make_bench):
    """A voltage with a third harmonic of a fifth, and a current that lags by 60 degrees: by hand."""
    turns = 2 * np.pi * 1e3
    volts = {1: lambda t: 3 * np.sin(turns * t) + 0.6 * np.sin(3 * turns * t)}
    volts[2] = lambda t: 2 * np.sin(turns * t - np.pi / 3)
    bench = make_bench(volts, model="TPS2012", noise_levels=0.0)
    bench.write("CH1:PROBE 1;SCALE 1;:CH2:PROBE 1;SCALE 1;:HOR:SCALE 1E-3;:SELECT:CH2 ON")
    bench.single()
    bench.write("HARMONICS:SELECT 3")
    expected = {
        "HARMONICS:FREQUENCY": 3e3,
        "HARMONICS:PERCENT": 20.0,
        "HARMONICS:RMS": 0.6 / 2**0.5,
        "HARMONICS:THDF": 20.0,
        "HARMONICS:THDR": 20 / 1.04**0.5,
        "WAVEFORMANALYSIS:RMS": (4.5 + 0.18) ** 0.5,
        "POWERANALYSIS:TRUEPOWER": 1.5,  # the third harmonic carries none
        "POWERANALYSIS:APPARENTPOWER": ((4.5 + 0.18) * 2) ** 0.5,
        "SWLOSS:TOTAL:ENERGY": 1.5 * 10e-3,
    }
    for header, value in expected.items():
        assert float(bench.ask(f"{header}?")) == pytest.approx(value, rel=0.03), header
    bench.events()
    bench.write("SELECT:CH2 OFF")
    assert bench.ask("POWERANALYSIS:PFACTOR?") == "9.9E37"
    assert bench.events() == [2303]


def test_autoset_can_be_locked_away(make_bench):
    bench = make_bench(model="TDS2012C")
    bench.events()
    bench.write("AUTOSET:ENABLE 0;:AUTOSET EXECUTE")
    assert bench.events() == [221]


@pytest.mark.parametrize(("message", "answer"), [("ACQ:STATE OFF;:TRIG:STATE?", ":TRIG:STATE SAV")])
def test_short_forms_of_the_trigger_state(bench, message, answer):
    bench.write("VERBOSE OFF")
    assert bench.ask(message) == answer


def test_a_header_after_an_unknown_one_is_read_in_the_unknown_branch(bench):
    bench.write("CH1:SCALE 2;:LIMIT:SCALE 5;POSITION 1;:HOR:SCALE 1E-3;FOO 1;SCALE 2.5E-3")
    assert bench.ask("HEADER OFF;:CH1:SCALE?;POSITION?;:HOR:MAIN:SCALE?") == "2.0E0;0.0E0;2.5E-3"
    assert bench.events() == [113, 113, 113]
