"""The driver against the complete simulated scope, on every kind of link: in this process, TCP and a real tty."""

import sys

import numpy as np
import pytest

from instrument import (
    TDS2014,
    ExecutionError,
    InstrumentError,
    LinkError,
    NoTrigger,
    SettingError,
    TransferError,
    WrongInstrument,
)
from instrument.simulated import (
    Fault,
    Faults,
    PtyServer,
    SimulatedTDS2014,
    TcpServer,
    VirtualClock,
    resource_manager,
)

AMPLITUDE, FREQUENCY = 0.8, 1000.0

LINKS = ["gpib", "tcp"] + ([] if sys.platform == "win32" else ["pty"])


def sine(times):
    return AMPLITUDE * np.sin(2 * np.pi * FREQUENCY * times)


def ramp(times):
    return np.asarray(times * 1000.0)


@pytest.fixture
def simulated():
    return SimulatedTDS2014({1: sine, 2: ramp}, noise_levels=0.0, seed=3, faults=Faults(seed=5))


@pytest.fixture(params=LINKS)
def opened(request, simulated, manager, impatient):
    """Resource name and resource manager of the simulated scope on one kind of link."""
    if request.param == "gpib":
        name = "GPIB0::1::INSTR"
        simulated_manager = resource_manager(scopes={name: simulated})
        yield name, simulated_manager
        simulated_manager.close()
        return
    with TcpServer(simulated) if request.param == "tcp" else PtyServer(simulated) as server:
        yield server.resource_name, manager


@pytest.fixture
def scope(opened):
    name, visa = opened
    with TDS2014(name, resource_manager=visa) as scope:
        yield scope


def prepare(scope):
    scope.set_channel(1, probe=1, scale=0.5, position=-1.0, coupling="DC")
    scope.set_timebase(2.5e-4)
    scope.set_trigger(source=1, level=0.1, slope="RISE", mode="NORMAL")


def test_record_is_the_signal_at_the_input(scope):
    prepare(scope)
    for _ in range(2):
        waveform = scope.acquire("CH1")
        assert waveform.preamble.yoff == -25.0
        assert waveform.preamble.ymult == pytest.approx(0.02)
        assert waveform.sample_interval == pytest.approx(1e-6)
        assert not waveform.clipped
        # The trigger at 0.1 V, rising, is the time zero.
        expected = AMPLITUDE * np.sin(2 * np.pi * FREQUENCY * waveform.times + np.arcsin(0.1 / AMPLITUDE))
        # One converter level, and as much again for where between two samples the trigger fell.
        np.testing.assert_allclose(waveform.volts, expected, atol=0.02 + 0.01)


def test_fetch_gives_the_same_stopped_record_again(scope):
    prepare(scope)
    waveform = scope.acquire(1)
    assert scope.fetch(1) == waveform


def test_two_channels_of_one_acquisition(scope):
    prepare(scope)
    scope.set_channel(2, probe=1, scale=1.0)
    first = scope.acquire(1)
    second = scope.fetch(2)
    assert second.preamble.wfid.startswith("Ch2")
    assert scope.fetch(1) == first


def test_front_panel_is_as_found_afterwards(opened, simulated):
    name, visa = opened
    for command in ("CH1:SCALE 2", "HEADER ON", "DATA:ENCDG ASCII", "DATA:STOP 100", "TRIGGER:MAIN:LEVEL 1.2"):
        list(simulated.execute(command.encode()))

    def setup():
        return b"".join(answer or b"" for answer in simulated.execute(b"SET?"))

    before = setup()
    assert b"SCALE 2.0E0" in before
    with TDS2014(name, resource_manager=visa) as scope:
        prepare(scope)
        scope.set_channel(3, scale=0.2, bandwidth_limit=True, invert=True)
        scope.set_acquisition(mode="AVERAGE", averages=4)
        scope.acquire(1)
        assert setup() != before
    assert setup() == before


def test_read_back(scope):
    settings = scope.set_channel("CH3", probe=10, scale=2.0, position=0.52, coupling="AC", invert=True)
    assert (settings.scale, settings.position, settings.coupling) == (2.0, 0.52, "AC")
    assert (settings.probe, settings.invert, settings.displayed, settings.bandwidth_limit) == (
        10,
        True,
        True,
        False,
    )
    assert scope.set_timebase(5e-3, position=1e-3) == 5e-3
    with pytest.raises(SettingError, match=r"3\.0E-3 but the scope holds 2\.5E-3"):
        scope.set_timebase(3e-3)


def test_no_trigger(scope):
    prepare(scope)
    scope.set_trigger(level=1.5)
    with pytest.raises(NoTrigger, match="check signal, trigger source and level"):
        scope.acquire(1)
    scope.set_trigger(level=0.1)
    assert scope.acquire(1).codes.shape == (2500,)


def test_channel_off_and_channel_missing(scope):
    with pytest.raises(ExecutionError, match="CH4 is not displayed"):
        scope.acquire(4)
    with pytest.raises(SettingError, match="no channel CH5"):
        scope.acquire(5)
    scope.set_channel(4)
    assert scope.acquire(4).preamble.wfid.startswith("Ch4")


def test_average_and_peak_detect(scope):
    prepare(scope)
    scope.set_acquisition(mode="AVERAGE", averages=4)
    assert "Average" in scope.acquire(1).preamble.wfid
    scope.set_acquisition(mode="PEAKDETECT")
    assert scope.acquire(1).preamble.pt_fmt == "ENV"


@pytest.mark.parametrize(
    "kind",
    ["lost byte", "inserted byte", "cut answer", "wrong block length", "garbage", "lost answer", "late answer"],
)
def test_fault_in_a_curve_is_refused_and_then_over(scope, simulated, kind):
    prepare(scope)
    right = scope.acquire(1)
    simulated.faults.add(Fault(kind, answer=1, bytes_sent=1200, seconds=0.2))
    if kind == "late answer":
        assert scope.fetch(1) == right
    else:
        with pytest.raises(TransferError):
            scope.fetch(1)
    assert simulated.faults.happened
    assert scope.fetch(1) == right


def test_knob_turned_behind_the_curve(scope, simulated):
    prepare(scope)
    scope.acquire(1)
    simulated.faults.add(Fault("knob turned", in_answer=b"#42500", command="CH1:POSITION 2"))
    before = scope.acquire(1)
    simulated.faults.clear()
    assert before.preamble.yoff == -25.0
    # The next record has a new preamble, which is confirmed before it is believed.
    assert scope.acquire(1).preamble.yoff == 50.0


def test_switched_off_in_the_middle_of_a_record(opened, simulated):
    name, visa = opened
    with pytest.raises(LinkError) as caught, TDS2014(name, resource_manager=visa) as scope:
        scope.acquire(1)
        simulated.faults.add(Fault("power off", answer=1, bytes_sent=1200))
        scope.acquire(1)
    assert name in str(caught.value)


def test_wrong_instrument(opened, simulated):
    name, visa = opened
    simulated.faults.identity = "TEKTRONIX,TDS 3014B,0,CF:91.1CT FV:v3.27"
    with pytest.raises(WrongInstrument, match="TDS 3014B"):
        TDS2014(name, resource_manager=visa)


def test_records_among_random_faults_are_right_or_refused():
    """Two in a hundred answers are spoiled somehow; virtual time makes the waiting free."""
    kinds = ("lost byte", "inserted byte", "cut answer", "wrong block length", "garbage", "lost answer")
    faults = Faults(seed=11)
    simulated = SimulatedTDS2014({1: sine}, clock=VirtualClock(), noise_levels=0.4, seed=4, faults=faults)
    visa = resource_manager(scopes={"GPIB0::1::INSTR": simulated})
    refused = 0
    with TDS2014("GPIB0::1::INSTR", resource_manager=visa) as scope:
        prepare(scope)
        right = scope.acquire(1)
        faults.add(*(Fault(kind, probability=0.02) for kind in kinds))
        for _ in range(400):
            try:
                assert scope.fetch(1) == right
            except InstrumentError:
                refused += 1
        faults.clear()
        assert scope.fetch(1) == right
    visa.close()
    assert 10 < refused < 200
    assert {fault.kind for fault in faults.happened} == set(kinds)
