"""Whole setups, memories, autoset, references, and the lock of the front panel."""

import numpy as np
import pytest

from instrument import ExecutionError, NoTrigger, SettingError
from instrument.tds2014.front_panel import settings_of


def panel_of(simulated):
    text = b"".join(answer or b"" for answer in simulated.execute(b"SET?")).decode()
    return settings_of(text)


def test_setup_goes_out_and_back(bench, bench_scope):
    setup = bench.read_setup()
    kept = panel_of(bench_scope)
    assert settings_of(setup)[":CH1:SCALE"] == "5.0E-1"
    bench.set_channel(1, scale=2.0, position=1.0)
    bench.set_timebase(1e-2)
    bench.set_trigger(level=0.5, slope="FALL")
    assert panel_of(bench_scope) != kept
    bench.write_setup(setup)
    assert panel_of(bench_scope) == kept


def test_setup_that_the_scope_does_not_take(bench):
    setup = bench.read_setup()
    with pytest.raises(SettingError, match=r"CH1:SCALE was set to 9\.0E9"):
        bench.write_setup(setup.replace(":CH1:PROBE 1;SCALE 5.0E-1", ":CH1:PROBE 1;SCALE 9.0E9"))
    with pytest.raises(SettingError, match="not a setup"):
        bench.write_setup("nonsense")


def test_memories(bench, bench_scope):
    kept = panel_of(bench_scope)
    bench.save_setup(3)
    bench.set_timebase(5e-3)
    bench.recall_setup(3)
    assert panel_of(bench_scope) == kept
    # Our transfer format is still in force.
    assert bench.acquire(1).codes.shape == (2500,)
    for number in (0, 11):
        with pytest.raises(SettingError, match="choose 1 to 10"):
            bench.save_setup(number)


def test_everything_is_put_back_after_recall_and_autoset(bench, bench_scope):
    bench.restore()
    found = panel_of(bench_scope)
    bench.set_channel(1, scale=2.0)
    bench.recall_setup("factory")
    assert panel_of(bench_scope)[":CH1:SCALE"] == "1.0E0"
    bench.set_timebase(1e-2)
    bench.autoset()
    bench.set_channel(2, scale=0.1)
    assert panel_of(bench_scope) != found
    bench.restore()
    assert panel_of(bench_scope) == found


def test_autoset_finds_the_signal(bench):
    bench.set_channel(1, scale=5.0)
    bench.set_timebase(10.0e-3)
    bench.autoset()
    waveform = bench.acquire(1)
    assert not waveform.clipped
    assert np.ptp(waveform.volts) == pytest.approx(1.6, abs=0.1)
    assert 2 <= waveform.sample_interval * 2500 * 1000 <= 10  # periods on the screen


def test_reference_keeps_a_record(bench):
    kept = bench.acquire(1)
    bench.save_reference("REFA", 1)
    bench.set_channel(1, position=1.0)
    bench.acquire(1)
    reference = bench.fetch("refa")
    assert reference.preamble.wfid.startswith("RefA")
    np.testing.assert_array_equal(reference.codes, kept.codes)
    with pytest.raises(ExecutionError):
        bench.save_reference("REFB", 3)  # not displayed
    with pytest.raises(SettingError, match="no channel REFE"):
        bench.fetch("REFE")


def test_front_panel_is_locked_during_a_block(bench):
    assert bench.query("LOCK?") == "NONE"
    with bench.front_panel_locked():
        assert bench.query("LOCK?") == "ALL"
        bench.acquire(1)
    assert bench.query("LOCK?") == "NONE"
    bench.set_trigger(mode="NORMAL", level=2.0)
    with pytest.raises(NoTrigger), bench.front_panel_locked():
        bench.acquire(1, timeout=0.05)
    assert bench.query("LOCK?") == "NONE"
