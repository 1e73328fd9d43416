"""The driver against recorded sentences over a real TCP connection: exchanges, read-back, faults, restoring."""

import socket
import time

import numpy as np
import pytest

from instrument import (
    TDS2014,
    CommandError,
    ExecutionError,
    LinkError,
    NoTrigger,
    SettingError,
    TransferError,
    WrongInstrument,
)


@pytest.fixture
def scope(line_server, line_scope, manager, impatient):
    with TDS2014(line_server.resource_name, resource_manager=manager) as scope:
        yield scope
        line_scope.forced.clear()  # what is put back in the end is read back, too


def expected_codes(line_scope):
    return [byte - 256 if byte > 127 else byte for byte in line_scope.codes]


def test_identity_and_channels(scope, line_server):
    identity = scope.identity
    assert (identity.manufacturer, identity.model, identity.serial) == ("TEKTRONIX", "TDS 2014", "0")
    assert identity.firmware == "CF:91.1CT FV:v4.12 TDS2CM:CMV:v1.04"
    assert scope.channels == ("CH1", "CH2", "CH3", "CH4")
    assert line_server.resource_name in repr(scope)


def test_record_has_the_codes_and_preamble_that_were_sent(scope, line_scope):
    waveform = scope.acquire("CH1")
    assert waveform.codes.tolist() == expected_codes(line_scope)
    assert waveform.preamble.to_text() == line_scope.preamble
    # 071-1075-04, p. 2-85: value = (code - YOFF) * YMULT + YZERO.
    assert waveform.volts[3] == pytest.approx((21 + 169) * 0.02)
    assert scope.fetch(1) == waveform


def test_fresh_record_is_one_exchange_within_the_line_budget(scope, line_scope):
    scope.acquire("CH1")
    line_scope.lines.clear()
    sent = []
    line_scope.damage = lambda line, answer: sent.append(len(answer)) or answer
    scope.acquire("CH1")
    scope.acquire("CH1")
    assert len(line_scope.lines) == 2
    up, down = len(line_scope.lines[1]) + 1, sent[1]
    assert up + down <= 1.08 * 2500


def test_stored_record_is_one_exchange(scope, line_scope):
    scope.fetch("CH1")
    line_scope.lines.clear()
    scope.fetch("CH1")
    assert line_scope.lines == ["*ESR?;:WAVF?"]


def test_everything_is_put_back(line_server, line_scope, manager):
    before = dict(line_scope.settings)
    with TDS2014(line_server.resource_name, resource_manager=manager) as scope:
        scope.setup(
            channels={
                "CH1": {"probe": 1, "scale": 0.5, "position": -1.0, "coupling": "AC"},
                2: {"displayed": True},
            },
            timebase={"seconds_per_division": 1e-3, "position": 2e-4},
            trigger={"source": 2, "level": 0.25, "slope": "FALL", "mode": "NORMAL", "coupling": "NOISEREJ"},
            acquisition={"mode": "AVERAGE", "averages": 64},
        )
        assert line_scope.settings["CH1:SCALE"] == "5.0E-1"
        assert line_scope.settings["TRIGGER:MAIN:EDGE:SOURCE"] == "CH2"
        assert line_scope.settings["HEADER"] == "0"
        scope.acquire(1)
    assert line_scope.settings == before


def test_opening_and_reading_change_nothing_on_the_front_panel(line_server, line_scope, manager):
    before = dict(line_scope.settings)
    with TDS2014(line_server.resource_name, resource_manager=manager) as scope:
        scope.fetch("CH1")
        scope.channel_settings(1)
        changed = {name for name, value in line_scope.settings.items() if value != before[name]}
    assert changed <= {"HEADER", "VERBOSE"} | {
        f"DATA:{leaf}" for leaf in ("ENCDG", "SOURCE", "START", "STOP", "WIDTH")
    }


def test_settings_are_put_back_after_an_exception(line_server, line_scope, manager):
    before = dict(line_scope.settings)
    with pytest.raises(ZeroDivisionError), TDS2014(line_server.resource_name, resource_manager=manager) as scope:
        scope.set_timebase(2.5e-3)
        _ = 1 / 0
    assert line_scope.settings == before


def test_failing_restore_does_not_hide_the_first_error(line_server, line_scope, manager):
    with (
        pytest.raises(ZeroDivisionError) as caught,
        TDS2014(line_server.resource_name, resource_manager=manager) as scope,
    ):
        scope.set_timebase(2.5e-3)
        scope.set_acquisition(mode="AVERAGE")
        del line_scope.settings["HORIZONTAL:MAIN:POSITION"]
        _ = 1 / 0
    assert "could not be put back" in caught.value.__notes__[0]
    # The other groups were put back all the same.
    assert line_scope.settings["ACQUIRE:MODE"] == "SAMPLE"
    assert line_scope.settings["HEADER"] == "1"


def test_closing_twice(line_server, manager):
    scope = TDS2014(line_server.resource_name, resource_manager=manager)
    scope.close()
    scope.close()


# ---------------------------------------------------------------------- settings


def test_read_back_that_differs_names_command_wanted_and_got(scope, line_scope):
    line_scope.forced["HORIZONTAL:MAIN:SCALE"] = "2.5E-4"
    with pytest.raises(SettingError, match=r"HORIZONTAL:MAIN:SCALE was set to 3.0E-4 .* holds 2.5E-4"):
        scope.set_timebase(3e-4)
    line_scope.forced["CH1:COUPLING"] = "GND"
    with pytest.raises(SettingError, match=r"CH1:COUPLING was set to AC .* holds GND"):
        scope.set_channel(1, coupling="AC")
    line_scope.forced["CH1:INVERT"] = "OFF"
    with pytest.raises(SettingError, match="CH1:INVERT was set to ON"):
        scope.set_channel(1, invert=True)


def test_position_may_differ_by_half_a_level(scope, line_scope):
    line_scope.forced["CH1:POSITION"] = "1.0E0"
    assert scope.set_channel(1, position=1.015).position == 1.0
    with pytest.raises(SettingError, match="CH1:POSITION"):
        scope.set_channel(1, position=1.03)


@pytest.mark.parametrize(
    ("call", "problem"),
    [
        (lambda scope: scope.set_channel(5), "no channel CH5"),
        (lambda scope: scope.acquire("CH0"), "no channel CH0"),
        (lambda scope: scope.acquire("MATH"), "no channel MATH"),
        (lambda scope: scope.save_reference("CH1", 1), "no reference CH1"),
        (lambda scope: scope.set_channel(1, coupling="XX"), "DC, AC, GND"),
        (lambda scope: scope.set_trigger(slope="UP"), "RISE, FALL"),
        (lambda scope: scope.set_trigger(source="CH7"), "no channel CH7"),
        (lambda scope: scope.set_acquisition(mode="ENVELOPE"), "PEAKDETECT"),
        (lambda scope: scope.set_timebase(0.0), "positive"),
    ],
)
def test_impossible_values_are_refused_before_they_are_sent(scope, line_scope, call, problem):
    line_scope.lines.clear()
    with pytest.raises(SettingError, match=problem):
        call(scope)
    assert line_scope.lines == []


def test_two_channel_model(line_server, line_scope, manager):
    line_scope.identity = "TEKTRONIX,TDS 2012,0,CF:91.1CT FV:v2.12 TDS2CM:CMV:v1.04"
    with TDS2014(line_server.resource_name, resource_manager=manager) as scope:
        assert scope.channels == ("CH1", "CH2")
        with pytest.raises(SettingError, match="TDS 2012 has no channel CH3; choose one of CH1, CH2"):
            scope.acquire("CH3")


def test_events_become_typed_exceptions(scope, line_scope):
    with pytest.raises(CommandError, match="113: Undefined header; FOO") as caught:
        scope.query("FOO?")
    assert (caught.value.code, caught.value.text) == (113, "Undefined header; FOO?")
    # In step again:
    assert scope.query("HORIZONTAL:MAIN:SCALE?") == "5.0E-4"
    line_scope.register = 16
    line_scope.queue = ['221,"Settings conflict; "']
    with pytest.raises(ExecutionError, match="221: Settings conflict"):
        scope.write("TRIGGER:MAIN:LEVEL 1.0E0")
    line_scope.queue = ['401,"Power on; "', '222,"Data out of range; "']
    assert [event.code for event in scope.events()] == [401, 222]
    assert scope.events() == []


def test_channel_that_is_not_displayed(scope):
    with pytest.raises(ExecutionError, match=r"CH2 is not displayed; switch it on") as caught:
        scope.fetch(2)
    assert caught.value.code == 2244
    assert scope.fetch(1).preamble.wfid.startswith("Ch1")


# ---------------------------------------------------------------------- waiting


def test_no_trigger_is_told_from_a_lost_link(scope, line_scope):
    scope.set_trigger(mode="NORMAL")
    line_scope.triggers = False
    with pytest.raises(NoTrigger, match="trigger state READY"):
        scope.acquire("CH1")
    assert line_scope.settings["ACQUIRE:STATE"] == "0"  # it does not go on waiting
    line_scope.triggers = True
    assert scope.acquire("CH1").codes.tolist() == expected_codes(line_scope)


def test_given_timeout_is_named(scope, line_scope):
    scope.set_trigger(mode="NORMAL")
    line_scope.triggers = False
    with pytest.raises(NoTrigger, match=r"within 0\.02 s"):
        scope.acquire("CH1", timeout=0.02)


# ---------------------------------------------------------------------- faults


def at_block(change):
    """Damage only the answers with a curve."""
    return lambda line, answer: change(answer) if b"#42500" in answer else answer


def in_preamble(old, new):
    return at_block(lambda answer: answer.replace(old, new, 1))


DAMAGES = {
    "byte lost in the curve": at_block(lambda a: a[:900] + a[901:]),
    "last byte lost": at_block(lambda a: a[:-2] + a[-1:]),
    "byte added in the curve": at_block(lambda a: a[:900] + b"x" + a[900:]),
    "line feed added in the curve": at_block(lambda a: a[:900] + b"\n" + a[900:]),
    "cut": at_block(lambda a: a[:1300] + b"\n"),
    "block length one short": in_preamble(b"#42500", b"#42499"),
    "block length one long": in_preamble(b"#42500", b"#42501"),
    "digit of the block length lost": in_preamble(b"#42500", b"#4250"),
    "number sign lost": in_preamble(b"#42500", b"42500"),
    "huge block": in_preamble(b"#42500", b"#9999999999"),
    "field lost": in_preamble(b'"s";', b""),
    "digit lost in YOFF": in_preamble(b"-1.69E2", b"-1.6E2"),
    "exponent sign lost": in_preamble(b"2.0E-2", b"2.0E2"),
    "digit added in YMULT": in_preamble(b"2.0E-2", b"2.05E-2"),
    "quote lost": in_preamble(b'"Volts"', b'"Volts'),
    "garbage": at_block(lambda a: bytes((n * 11 + 128) % 256 for n in range(len(a)))),
    "another channel": in_preamble(b"Ch1", b"Ch2"),
    "headers switched on": in_preamble(b"1;8;", b":WFMPRE:BYT_NR 1;8;"),
    "fewer points": in_preamble(b";2500;", b";2400;"),
    "nothing": at_block(lambda a: b""),
    "only a line end": at_block(lambda a: b"\n"),
}


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
@pytest.mark.parametrize("first_record", [True, False], ids=["first record", "later record"])
def test_damaged_record_is_refused_and_the_next_one_is_right(scope, line_scope, damage, first_record):
    if not first_record:
        scope.acquire("CH1")
    line_scope.damage = damage
    with pytest.raises(TransferError):
        scope.acquire("CH1")
    line_scope.damage = lambda line, answer: answer
    waveform = scope.acquire("CH1")
    assert waveform.codes.tolist() == expected_codes(line_scope)
    assert waveform.preamble.to_text() == line_scope.preamble


def test_spoiled_request_cannot_return_an_old_record(scope, line_scope):
    scope.acquire("CH1")
    line_scope.register, line_scope.queue = 32, ['113,"Undefined header; ACQ:STTE"']
    with pytest.raises(TransferError, match="113"):
        scope.acquire("CH1")
    scope.acquire("CH1")


def test_power_cycle_between_records(scope, line_scope):
    scope.acquire("CH1")
    line_scope.register = 128
    line_scope.settings |= {"HEADER": "1", "DATA:STOP": "100", "DATA:ENCDG": "ASCII"}
    with pytest.raises(TransferError, match="off and on"):
        scope.acquire("CH1")
    assert line_scope.settings["HEADER"] == "0"
    assert line_scope.settings["DATA:STOP"] == "2500"
    scope.acquire("CH1")


def test_another_instrument_on_the_link_after_a_fault(line_server, line_scope, manager, impatient):
    with (
        pytest.raises(WrongInstrument, match="another instrument answers"),
        TDS2014(line_server.resource_name, resource_manager=manager) as scope,
    ):
        line_scope.identity = line_scope.identity.replace("2014", "2024")
        line_scope.damage = DAMAGES["cut"]
        scope.acquire("CH1")


@pytest.mark.parametrize("sent", [0, 1, 40, 1500, 2600])
def test_scope_switched_off_in_the_middle_of_a_record(line_server, line_scope, manager, sent):
    with (
        pytest.raises(LinkError, match=r"closed the connection|lost") as caught,
        TDS2014(line_server.resource_name, resource_manager=manager) as scope,
    ):
        scope.acquire("CH1")
        line_scope.hang_up_after = sent
        asked = time.monotonic()
        scope.acquire("CH1")
    # At once, wherever in the answer it happens: closing does not wait for a scope that is gone either.
    assert time.monotonic() - asked < 5.0
    assert line_server.resource_name in str(caught.value)


def test_scope_that_falls_silent(line_server, line_scope, manager, impatient):
    with (
        pytest.raises(LinkError, match="switched on and connected"),
        TDS2014(line_server.resource_name, resource_manager=manager) as scope,
    ):
        scope.acquire("CH1")
        line_scope.damage = lambda line, answer: b""
        scope.acquire("CH1")


# ---------------------------------------------------------------------- opening


@pytest.mark.parametrize(
    "identity",
    [
        "HEWLETT-PACKARD,34401A,0,10-5-2",
        "TEKTRONIX,TDS 3014B,0,CF:91.1CT FV:v3.27",
        "TEKTRONIX,TDS 220,0,CF:91.1CT FV:v2.03 TDS2CM:CMV:v1.04",
        "hello",
    ],
)
def test_wrong_instrument(line_server, line_scope, manager, impatient, identity):
    line_scope.identity = identity
    with pytest.raises(WrongInstrument, match="calls itself") as caught:
        TDS2014(line_server.resource_name, resource_manager=manager)
    assert identity in str(caught.value)


@pytest.mark.parametrize(
    ("identity", "count"),
    [
        ("TEKTRONIX,TDS 2024,0,CF:91.1CT FV:v4.12 TDS2CM:CMV:v1.04", 4),
        ("TEKTRONIX,TDS 1002,0,CF:91.1CT FV:v2.06 TDS2CM:CMV:v1.04", 2),
        ("TEKTRONIX,TDS 2012B,C062851,CF:91.1CT FV:v22.01", 2),
        ("TEKTRONIX,TDS 2024C,C042765,CF:91.1CT FV:v24.26", 4),
        ("TEKTRONIX,TPS 2012,0,CF:91.1CT FV:v9.48 TPS2PWR1:v1.00", 2),
    ],
)
def test_whole_family_is_accepted(line_server, line_scope, manager, identity, count):
    line_scope.identity = identity
    with TDS2014(line_server.resource_name, resource_manager=manager) as scope:
        assert len(scope.channels) == count
        assert scope.identity.text == identity


def test_lines_left_over_from_another_program_are_skipped(line_server, line_scope, manager):
    line_scope.damage = lambda line, answer: b"1.5E0\n\xff\x80\n" + answer if line == "*IDN?" else answer
    with TDS2014(line_server.resource_name, resource_manager=manager) as scope:
        assert scope.identity.model == "TDS 2014"
        line_scope.damage = lambda line, answer: answer
        scope.acquire(1)


def test_nobody_listens(manager):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    name = f"TCPIP0::127.0.0.1::{port}::SOCKET"
    with pytest.raises(LinkError, match=name):
        TDS2014(name, resource_manager=manager)


def test_listener_that_never_answers(manager, impatient):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        name = f"TCPIP0::127.0.0.1::{listener.getsockname()[1]}::SOCKET"
        with pytest.raises(LinkError, match="did not answer"):
            TDS2014(name, resource_manager=manager)


def test_somebody_who_answers_no_text(line_server, line_scope, manager, impatient):
    line_scope.damage = lambda line, answer: b"\xfe\xff\x80\n"
    with pytest.raises(TransferError, match=r"what came after \*IDN\? is no answer .* check that the name"):
        TDS2014(line_server.resource_name, resource_manager=manager)


@pytest.mark.parametrize("name", ["nonsense", "GPIB0::77::INSTR", "ASRL/dev/none::INSTR", ""])
def test_resource_that_does_not_exist(manager, name):
    with pytest.raises(LinkError, match="cannot open"):
        TDS2014(name, resource_manager=manager)


def test_codes_are_signed_bytes(scope):
    assert scope.acquire(1).codes.dtype == np.int8


def test_interrupted_in_the_middle_of_a_record(line_server, line_scope, manager, monkeypatch):
    before = dict(line_scope.settings)
    with (
        pytest.raises(KeyboardInterrupt) as caught,
        TDS2014(line_server.resource_name, resource_manager=manager) as scope,
    ):
        scope.set_timebase(1e-3)
        read = scope._dialogue.link.read_some

        def interrupt(count, patience):
            if count > 1:
                monkeypatch.setattr(scope._dialogue.link, "read_some", read)
                raise KeyboardInterrupt
            return read(count, patience)

        monkeypatch.setattr(scope._dialogue.link, "read_some", interrupt)
        scope.acquire("CH1")
    # The rest of the record was still under way when the settings were put back.
    assert line_scope.settings == before
    assert not hasattr(caught.value, "__notes__")


def test_event_of_an_own_query_is_not_taken_for_one_about_the_record(scope, line_scope):
    scope.acquire(1)
    scope.query("CH1:SCALE?")
    line_scope.register, line_scope.queue = 16, ['2202,"Measurement error, No period found; "']
    assert scope.acquire(1).codes.shape == (2500,)


def test_timeout_zero_is_a_timeout(scope, line_scope):
    scope.set_trigger(mode="NORMAL")
    line_scope.triggers = False
    with pytest.raises(NoTrigger):
        scope.acquire("CH1", timeout=0)


def test_hang_up_is_called_by_its_name(line_server, line_scope, manager):
    scope = TDS2014(line_server.resource_name, resource_manager=manager)
    line_scope.hang_up_after = 1500
    with pytest.raises(LinkError, match="has closed the connection; switch it on"):
        scope.fetch("CH1")
    with pytest.raises(LinkError):
        scope.close()
