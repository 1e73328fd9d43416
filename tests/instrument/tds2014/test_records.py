"""Several channels of one acquisition, and records one after the other."""

import itertools
import socket

import numpy as np
import pytest

from instrument import TDS2014, ExecutionError, NoTrigger, SettingError, TransferError
from instrument.dialogue.link import Link
from instrument.simulated import Fault, SimulatedTDS2014, TcpServer


def test_channels_of_one_acquisition(bench, bench_scope):
    before = bench_scope.acquisition.record
    first, second = bench.acquire(("CH1", 2))
    assert first.preamble.wfid.startswith("Ch1")
    assert second.preamble.wfid.startswith("Ch2")
    assert first.times.tolist() == second.times.tolist()
    # Half the amplitude in phase, as only the same acquisition can show.
    assert abs(first.volts - 2 * second.volts).max() < 0.05
    assert bench_scope.acquisition.record is not before
    assert bench.acquire([2])[0].preamble.wfid.startswith("Ch2")


def test_no_channel_at_all(bench):
    with pytest.raises(SettingError, match="at least one"):
        bench.acquire(())


def test_several_channels_are_one_message(bench, bench_scope, monkeypatch):
    bench.set_channel(3, probe=1, scale=0.5)
    bench.acquire((1, 2, 3))  # the first time, new preambles are asked for twice
    messages = []
    execute = SimulatedTDS2014.execute

    def listen(scope, message, **options):
        messages.append(message)
        return execute(scope, message, **options)

    monkeypatch.setattr(SimulatedTDS2014, "execute", listen)
    waveforms = bench.acquire((3, 1, 2))
    assert [waveform.preamble.wfid[:3] for waveform in waveforms] == ["Ch3", "Ch1", "Ch2"]
    assert len(messages) == 1
    # One record after the other costs hardly more than their codes.
    assert len(messages[0]) + sum(len(w.preamble.to_text()) + 2508 for w in waveforms) < 1.09 * 3 * 2500
    assert bench.acquire(2) == bench.fetch(2)
    assert len(messages) == 3


# What a hand does that could make the second channel one of another acquisition.
HANDS = ("ACQUIRE:STATE RUN;*WAI", "HORIZONTAL:SCALE 5E-4;:ACQUIRE:STATE RUN;*WAI", "CH2:POSITION 1")


@pytest.mark.parametrize("command", HANDS)
def test_nobody_can_turn_a_knob_between_two_channels(bench, bench_scope, command):
    bench.acquire((1, 2))
    bench_scope.faults.add(Fault("knob turned within", in_answer=b"WAVF", answer=3, command=command))
    first, second = bench.acquire((1, 2))
    assert bench_scope.faults.happened or len(bench_scope.faults.armed) == 1
    assert first.times.tolist() == second.times.tolist()
    assert abs(first.volts - 2 * second.volts).max() < 0.05
    assert bench.query("LOCK?") == "NONE"


@pytest.mark.parametrize(
    "command", ["ACQUIRE:STOPAFTER RUNSTOP;STATE RUN", "HORIZONTAL:SCALE 5E-3;:ACQUIRE:STATE RUN"]
)
def test_a_scope_that_lets_itself_be_changed_is_refused(bench, bench_scope, command, monkeypatch):
    """As if the unit's lock did not work."""
    monkeypatch.setattr(bench_scope, "turn_knob", lambda hand: list(bench_scope.execute(hand.encode())))
    bench.acquire((1, 2))
    hand = Fault("knob turned within", in_answer=b"WAVF", answer=None, probability=1.0, command=command)
    bench_scope.faults.add(hand)
    with pytest.raises(TransferError):
        bench.acquire((1, 2))
    assert bench_scope.faults.happened
    bench_scope.faults.clear()
    first, second = bench.acquire((1, 2))
    assert first.preamble.xincr == second.preamble.xincr


def test_run_stop_pressed_does_not_make_an_old_record_new(bench, bench_scope):
    """The key ends the single sequence: without asking for it again, a record that is there comes at once."""
    bench.acquire(1)
    bench_scope.turn_knob("ACQUIRE:STOPAFTER RUNSTOP;STATE STOP")
    before = bench_scope.acquisition.record.number
    bench.acquire(1)
    assert bench_scope.acquisition.record.number > before
    assert not bench_scope.acquisition.running


def test_several_channels_of_a_running_scope_are_not_fetched(bench):
    waveforms = bench.acquire((1, 2))
    assert bench.fetch((1, 2)) == waveforms
    bench.write("ACQUIRE:STOPAFTER RUNSTOP;STATE RUN")
    with pytest.raises(SettingError, match="acquires on"):
        bench.fetch((1, 2))
    assert bench.query("LOCK?") == "NONE"
    assert bench.acquire((2, 1))[0].preamble.wfid.startswith("Ch2")


def test_one_of_several_is_not_displayed(bench):
    for names, missing in (((1, 2, 3, 4), "CH3"), ((4, 1), "CH4"), ((1, 3), "CH3"), ((3, 4), "CH3")):
        with pytest.raises(ExecutionError, match=f"{missing} is not displayed"):
            bench.acquire(names)
        assert bench.query("LOCK?") == "NONE"
    assert len(bench.acquire((1, 2))) == 2


def test_the_same_channel_twice(bench):
    with pytest.raises(SettingError, match="twice"):
        bench.acquire((1, "CH1"))


DAMAGE = (
    *(("lost byte", place) for place in (2000, 2720, 5000)),
    *(("inserted byte", 2720), ("cut answer", 2720), ("cut answer", 5000)),
    *(("garbage", 0), ("wrong block length", 0)),
)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "place"), DAMAGE)
def test_damage_to_one_of_several_is_refused_and_over(bench, bench_scope, kind, place):
    waveforms = bench.acquire((1, 2))
    bench_scope.faults.add(Fault(kind, answer=1, bytes_sent=place))
    with pytest.raises(TransferError):
        bench.fetch((1, 2))
    assert bench.query("LOCK?") == "NONE"
    assert bench.fetch((1, 2)) == waveforms


def test_lock_is_left_as_found(bench, bench_scope):
    with bench.front_panel_locked():
        bench.acquire((1, 2))
        assert bench.query("LOCK?") == "ALL"
    assert bench.query("LOCK?") == "NONE"
    bench.write("LOCK ALL")
    bench.acquire((1, 2))
    assert bench.query("LOCK?") == "ALL"
    bench.write("LOCK NONE")


def test_program_that_dies_between_two_channels_leaves_no_lock(bench_scope, manager, impatient, monkeypatch):
    with TcpServer(bench_scope) as server:

        def die(*_, **__):
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt), TDS2014(server.resource_name, resource_manager=manager) as scope:
            scope.set_channel(2, probe=1)
            scope.acquire((1, 2))
            monkeypatch.setattr(Link, "read_blocks", die)
            scope.acquire((1, 2))
        assert bench_scope.panel.text("LOCK") == "NONE"
        assert not bench_scope.panel.flag("SELECT:CH2")


def test_no_trigger_for_several(bench):
    bench.set_trigger(source="EXT", level=1.0, mode="NORMAL")
    with pytest.raises(NoTrigger):
        bench.acquire((1, 2), timeout=0.2)
    assert bench.query("LOCK?") == "NONE"
    bench.set_trigger(source=1, level=0.1, mode="NORMAL")
    assert len(bench.acquire((1, 2))) == 2


def test_records_one_after_the_other(bench, bench_scope):
    numbers = []
    for waveform in bench.records(1, 3):
        assert waveform.codes.shape == (2500,)
        numbers.append(bench_scope.acquisition.record.number)
    assert len(set(numbers)) == 3
    assert len(list(itertools.islice(bench.records(1), 2))) == 2


def test_records_of_several_channels(bench):
    for first, second in bench.records((1, 2), 3):
        assert abs(first.volts - 2 * second.volts).max() < 0.05


@pytest.mark.slow
def test_damaged_record_is_taken_anew(bench, bench_scope):
    bench.acquire(1)
    bench_scope.faults.add(Fault("lost byte", answer=1, bytes_sent=1200))
    assert len(list(bench.records(1, 2))) == 2
    assert len(bench_scope.faults.happened) == 1
    bench_scope.faults.add(Fault("lost byte", shortest=2000, bytes_sent=1200))
    with pytest.raises(TransferError):
        list(bench.records(1, 2, attempts=2))
    assert len(bench_scope.faults.happened) == 3


@pytest.mark.parametrize("command", [b"DATA:START 100\n", b"DATA:STOP 2000\n", b"DATA:START 1477\n"])
def test_a_record_that_another_program_has_cut_short_is_told_and_taken_again(command: bytes) -> None:
    """Two programs on one port: what one sets of the transfer holds for the other."""
    simulated = SimulatedTDS2014({1: lambda times: np.sin(6283 * times)})
    with TcpServer(simulated) as server, TDS2014(server.resource_name) as scope:
        assert len(scope.acquire("CH1")) == 2500
        with socket.create_connection((server.host, server.port), 10.0) as other:
            other.sendall(command + b"*OPC?\n")
            assert other.recv(100)
            with pytest.raises(TransferError, match=r"another program has set DATA:START"):
                scope.acquire("CH1")
            assert len(scope.acquire("CH1")) == 2500  # the transfer is as it was again
            other.sendall(command + b"*OPC?\n")
            assert other.recv(100)
            (record,) = scope.records("CH1", 1)
            assert len(record) == 2500
