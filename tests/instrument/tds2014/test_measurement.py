"""Measurements, cursors and the math waveform of the scope itself, through the driver."""

import numpy as np
import pytest

from instrument import MEASUREMENTS, ExecutionError, SettingError


def front_panel(simulated):
    return b"".join(answer or b"" for answer in simulated.execute(b"SET?"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "expected", "unit", "tolerance"),
    [
        ("FREQUENCY", 1000.0, "Hz", 2.0),
        ("PERIOD", 1e-3, "s", 2e-6),
        ("PK2PK", 1.6, "V", 0.04),
        ("MAXIMUM", 0.8, "V", 0.02),
        ("MINIMUM", -0.8, "V", 0.02),
        ("CRMS", 0.8 / np.sqrt(2), "V", 0.02),
        ("PWIDTH", 0.5e-3, "s", 1e-5),
        # 10 % to 90 % of a sine: asin(0.8) / pi of its period.
        ("RISE", np.arcsin(0.8) / np.pi * 1e-3, "s", 2e-5),
    ],
)
def test_measurement_of_a_sine(bench, kind, expected, unit, tolerance):
    bench.acquire(1)
    measured = bench.measure(kind, 1)
    assert (measured.kind, measured.source, measured.unit) == (kind, "CH1", unit)
    assert measured.value == pytest.approx(expected, abs=tolerance)
    assert measured.warnings == ()


def test_measurement_reads_as_a_sentence(bench):
    bench.acquire(1)
    assert str(bench.measure("pk2pk", "CH2")).startswith("PK2PK of CH2: 0.8")


def test_every_measurement_is_known_to_the_scope(bench):
    bench.acquire(1)
    for kind in MEASUREMENTS:
        assert np.isfinite(bench.measure(kind, 1).value)


def test_no_value_is_an_exception_with_the_event(bench):
    bench.set_timebase(2.5e-5)  # a quarter of a period
    bench.acquire(1)
    with pytest.raises(ExecutionError, match="No period") as caught:
        bench.measure("FREQUENCY", 1)
    assert caught.value.code == 2202
    with pytest.raises(ExecutionError) as caught:
        bench.measure("FREQUENCY", 3)
    assert caught.value.code == 2225
    # The events are out of the way of the next record.
    assert bench.acquire(1).codes.shape == (2500,)
    assert bench.events() == []


def test_clipped_record_gives_a_value_and_a_warning(bench):
    bench.set_channel(1, scale=0.1)
    bench.acquire(1)
    measured = bench.measure("PK2PK", 1)
    assert measured.value == pytest.approx(1.016, abs=0.01)  # 254 levels of 4 mV
    assert "lipping" in measured.warnings[0]
    assert bench.acquire(1).clipped


def test_warning_of_the_users_own_query_does_not_spoil_a_record(bench):
    bench.set_channel(1, scale=0.1)
    bench.acquire(1)
    bench.query("MEASUREMENT:IMMED:TYPE PK2PK;SOURCE CH1;VALUE?")
    assert bench.acquire(1).clipped


def test_unknown_measurement(bench):
    with pytest.raises(SettingError, match="FREQUENCY, PERIOD"):
        bench.measure("JITTER", 1)


def test_cursors(bench, bench_scope):
    before = front_panel(bench_scope)
    assert bench.cursors().bars == "OFF"
    cursors = bench.set_cursors("VBARS", positions=(-5e-4, 5e-4))
    assert (cursors.bars, cursors.source, cursors.unit) == ("VBARS", "CH1", "s")
    assert cursors.positions == pytest.approx((-5e-4, 5e-4), abs=2e-5)
    assert cursors.difference == pytest.approx(1e-3, rel=0.03)
    cursors = bench.set_cursors("hbars", source=2, positions=(-0.4, 0.4))
    assert (cursors.source, cursors.unit) == ("CH2", "VOLTS") or cursors.unit == "DIVS"
    assert bench.cursors() == cursors
    with pytest.raises(SettingError):
        bench.set_cursors("VBARS", positions=(-1.0, 1.0))  # far off the screen
    bench.set_cursors("OFF")
    bench.restore()
    assert b"CURSOR:FUNCTION OFF" in before
    assert b"CURSOR:FUNCTION OFF" in front_panel(bench_scope)


def test_difference_of_two_channels(bench):
    first, second = bench.acquire((1, 2))
    bench.set_math("CH1 - CH2")
    bench.acquire(1)
    difference = bench.fetch("MATH")
    assert difference.preamble.wfid.startswith("Math")
    np.testing.assert_allclose(difference.volts, first.volts - second.volts, atol=0.06)


def test_spectrum(bench, bench_scope):
    bench.set_timebase(2.5e-3)
    bench.set_math("FFT(CH1)")
    bench.acquire(1)
    # The first spectrum of a process loads SciPy, for longer than an impatient driver waits on a busy computer.
    bench_scope.trace("MATH")
    spectrum = bench.fetch("MATH")
    assert (spectrum.preamble.xunit, spectrum.preamble.yunit) == ("Hz", "dB")
    assert spectrum.times[np.argmax(spectrum.volts)] == pytest.approx(1000, abs=60)


def test_math_that_the_model_cannot_do(bench):
    with pytest.raises(ExecutionError):
        bench.set_math("CH1 * CH2")
    with pytest.raises(SettingError, match="not a math expression"):
        bench.set_math('CH1";*RST;"')


def test_math_is_put_back(bench, bench_scope):
    bench.set_math("FFT(CH2, FLATTOP)")
    assert b'"FFT(CH2,FLATTOP)"' in front_panel(bench_scope)
    bench.restore()
    panel = front_panel(bench_scope)
    assert b'MATH:DEFINE "CH1 - CH2"' in panel
    assert b"MATH 0" in panel
