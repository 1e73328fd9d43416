"""Every fault does what it says, once it is asked to."""

import pytest

from instrument.simulated import Fault, Faults

GOOD = b":HEADER 1\n"


@pytest.mark.parametrize(
    ("fault", "check"),
    [
        (Fault("lost byte", answer=1), lambda a: len(a) == len(GOOD) - 1),
        (Fault("lost byte", answer=1, bytes_sent=0), lambda a: a == GOOD[1:]),
        (Fault("inserted byte", answer=1), lambda a: len(a) == len(GOOD) + 1),
        (Fault("cut answer", answer=1, bytes_sent=4), lambda a: a == b":HEA\n"),
        (Fault("garbage", answer=1), lambda a: len(a) == len(GOOD) and a != GOOD),
        (Fault("lost answer", answer=1), lambda a: a == b""),
    ],
    ids=lambda value: value.kind if isinstance(value, Fault) else "",
)
def test_answer_is_spoilt_once(faulty_bench, fault, check):
    faulty_bench.scope.faults.add(fault)
    assert check(faulty_bench.ask_raw("HEADER?"))
    assert faulty_bench.ask_raw("HEADER?") == GOOD
    assert faulty_bench.scope.faults.happened == [fault]
    assert not faulty_bench.scope.faults.armed


def test_wrong_block_length_changes_only_the_length(faulty_bench):
    good = faulty_bench.ask_raw("ACQ:STATE OFF;:HEADER OFF;:SELECT:REFA ON;:DATA:SOURCE REFA;:CURVE?")
    faulty_bench.scope.faults.add(Fault("wrong block length", answer=1))
    bad = faulty_bench.ask_raw("CURVE?")
    assert len(bad) == len(good) and bad[6:] == good[6:] and bad[:2] == b"#4" and bad[2:6] != b"2500"


def test_late_answer_comes_late(faulty_bench):
    faulty_bench.scope.faults.add(Fault("late answer", answer=1, seconds=3.0))
    assert faulty_bench.ask_raw("HEADER?", timeout=1.0) is None
    assert faulty_bench.read(timeout=2.5) == GOOD
    assert faulty_bench.events() == [401]


def test_faults_choose_their_answers(faulty_bench):
    faulty_bench.scope.faults.add(Fault("lost answer", answer=3), Fault("lost byte", in_answer=b"IDN", shortest=5))
    assert [len(faulty_bench.ask_raw("HEADER?")) for _ in range(4)] == [10, 10, 0, 10]


def test_random_faults_come_with_their_probability_and_are_repeatable():
    def pattern(seed):
        faults = Faults(Fault("lost byte", probability=0.2), seed=seed)
        return [len(faults.deliver(b"0123456789", 0.0).data) for _ in range(2000)]

    assert pattern(1) == pattern(1) != pattern(2)
    assert pattern(1).count(9) == pytest.approx(400, abs=70)


def test_knob_is_turned_between_preamble_and_curve(faulty_bench):
    faulty_bench.write("HEADER OFF")
    faulty_bench.scope.faults.add(Fault("knob turned", answer=1, command="CH1:SCALE 20"))
    before = faulty_bench.ask("WFMPRE:YMULT?")
    assert before == "4.0E-2"
    assert faulty_bench.ask("CH1:SCALE?") == "2.0E1"


def test_stuck_busy_and_no_trigger(faulty_bench):
    faults = faulty_bench.scope.faults
    faults.stuck_busy = True
    assert faulty_bench.ask("BUSY?") == ":BUSY 1"
    assert faulty_bench.ask("*OPC?", timeout=20.0) is None
    faulty_bench.link.clear()
    faults.clear()
    faults.no_trigger = True
    faulty_bench.write("TRIG:MAIN:MODE NORMAL;:ACQ:STOPAFTER SEQ;STATE RUN")
    assert faulty_bench.ask("*OPC?", timeout=20.0) is None
    faults.no_trigger = False
    assert faulty_bench.read(timeout=1.0) == b"1\n"


def test_another_unit_on_the_address(faulty_bench):
    faulty_bench.scope.faults.identity = "HEWLETT-PACKARD,34401A,0,10-5-2"
    assert faulty_bench.ask("*IDN?") == "HEWLETT-PACKARD,34401A,0,10-5-2"
    faulty_bench.scope.faults.clear()
    assert faulty_bench.ask("*IDN?").startswith("TEKTRONIX,TDS 2014,")


def test_power_cycle_loses_records_and_events_but_not_settings(faulty_bench):
    faulty_bench.write("*ESE 4;:CH1:SCALE 5;:ACQ:STATE OFF;FOO")
    faulty_bench.scope.faults.add(Fault("power cycle", answer=1, bytes_sent=3))
    assert faulty_bench.ask_raw("HEADER?") == b":HE"
    assert faulty_bench.link.closed
    assert faulty_bench.ask("*ESE?;*ESR?;:CH1:SCALE?;:ACQ:STATE?") == "0;128;:CH1:SCALE 5.0E0;:ACQUIRE:STATE 1"
    assert faulty_bench.ask("ALLEV?") == ':ALLEV 401,"Power on; "'


def test_power_off_silences_the_instrument(faulty_bench):
    faulty_bench.scope.faults.add(Fault("power off", answer=1, bytes_sent=0))
    assert faulty_bench.ask_raw("HEADER?") == b""
    assert not faulty_bench.scope.powered
    assert faulty_bench.ask_raw("*IDN?", timeout=1.0) is None
