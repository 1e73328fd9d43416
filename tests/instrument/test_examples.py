"""Examples of inner functions of instrument: what they make of one value each."""

import numpy as np


def test_advice() -> None:
    from instrument.claims import advice

    assert "0699" in advice("USB0::0x0699::0x0368::C1::INSTR", "[Errno 13] Access denied")


def test_behind_adapter() -> None:
    from instrument.claims import behind_adapter

    assert behind_adapter("PRLGX-TCPIP1::10.0.0.5::1234::GPIB::7::INSTR") == (
        "PRLGX-TCPIP1::10.0.0.5::1234::INTFC",
        "GPIB1::7::INSTR",
    )


def test_visa_name() -> None:
    from instrument.claims import visa_name

    assert (visa_name("COM3"), visa_name("/dev/ttyUSB0"), visa_name("GPIB0::1::INSTR")) == (
        "ASRL3::INSTR",
        "ASRL/dev/ttyUSB0::INSTR",
        "GPIB0::1::INSTR",
    )


def test_link_of() -> None:
    from instrument.claims import link_of

    assert (link_of("TCPIP0::127.0.0.1::4001::SOCKET"), link_of("socket://127.0.0.2:4001")) == (
        "tcp 127.0.0.1 4001",
        "tcp 127.0.0.1 4001",
    )
    assert (link_of("USB0::0x0699::0x0368::C012345::INSTR"), link_of("GPIB::7")) == (
        "usb 1689 872 C012345",
        "gpib 0 7",
    )


def test_inunit() -> None:
    from instrument.controllers import InUnit

    assert (InUnit("dps")("change_per_s"), InUnit("v")("highest"), InUnit("v")("ask")) == (
        "change_dps_per_s",
        "highest_v",
        "ask",
    )


def test_parse_events() -> None:
    from instrument.dialogue.identify import parse_events

    assert [(e.code, e.text) for e in parse_events('401,"Power on; "')] == [(401, "Power on")]


def test_named_columns() -> None:
    from instrument.fibre_gyro.frame_fields import named_columns

    assert named_columns(["Time [ms]", "Gyro X (deg/h)", "T_C", "hot"]) == (
        ["time", "counts_x", "temperature", "hot"],
        ["ms", "deg/h", "", ""],
    )


def test_axis_column() -> None:
    from instrument.fibre_gyro.frame_fields import axis_column

    assert axis_column("Z") == "counts_z"


def test_crc() -> None:
    from instrument.fibre_gyro.frame_fields import crc

    assert hex(crc(32, 0x04C11DB7, initial=0xFFFFFFFF).compute(b"123456789")) == "0x376e6e7"


def test_line_of() -> None:
    from instrument.fibre_gyro import parse_frame_format
    from instrument.fibre_gyro.identify import line_of

    fields = [{"name": "counts", "bytes": 4}]
    assert (
        line_of(parse_frame_format({"kind": "binary", "output_rate_hz": 1, "header": "55", "fields": fields}))
        == "115200 baud 8N1"
    )


def test_clock_of_counter() -> None:
    from instrument.fibre_gyro.log_clock import clock_of_counter

    assert clock_of_counter(np.array([126.0, 127.0, 0.0, 3.0])).tolist() == [0, 1, 2, 5]


def test_nr3() -> None:
    from instrument.scpi import nr3

    assert (nr3(0.00025), nr3(0), nr3(-11008), nr3(50)) == ("2.5E-4", "0.0E0", "-1.1008E4", "5.0E1")


def test_split_header() -> None:
    from instrument.scpi import split_header

    assert (split_header(":WFMPRE:BYT_NR 1"), split_header("2500"), split_header('"Ch1, DC"')) == (
        (":WFMPRE:BYT_NR", "1"),
        ("", "2500"),
        ("", '"Ch1, DC"'),
    )


def test_split_parts() -> None:
    from instrument.scpi import split_parts

    assert split_parts('1;"Ch1; DC";Y') == ["1", '"Ch1; DC"', "Y"]


def test_heldclock() -> None:
    from instrument.simulated.clock import HeldClock, VirtualClock

    real = VirtualClock()
    clock = HeldClock(real)
    clock.hold()
    real.sleep(1.0)
    assert clock.now() == 0.0
    clock.release()
    assert clock.now() == 1.0


def test_tek_identity() -> None:
    from instrument.simulated.commands.setup_status import tek_identity

    assert (
        tek_identity("TEKTRONIX,TDS 2014,0,CF:91.1CT FV:v4.12 TDS2CM:CMV:v1.04")
        == "ID TEK/TDS 2014,CF:91.1CT,FV:v4.12 TDS2CM:CMV:v1.04"
    )


def test_convert() -> None:
    from instrument.simulated.front_end.frontend import PanelChannel, convert

    channel = PanelChannel(0.5, 1.0, "DC", 1.0, limited=False, inverted=False)
    assert convert(np.array([0.0, 0.5, 9.0, -9.0]), channel).tolist() == [25, 50, 127, -127]


def test_smoothed() -> None:
    from instrument.simulated.front_end.frontend import smoothed

    assert smoothed(np.array([1.0, 1.0, 0.0]), 0.5, 0.0).tolist() == [0.5, 0.75, 0.375]


def test_middle_crossings() -> None:
    from instrument.simulated.front_end.traces import middle_crossings

    edges = middle_crossings(np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0]))
    assert (edges.times.tolist(), edges.rising.tolist()) == ([1.5, 3.5], [True, False])


def test_visible_part() -> None:
    from instrument.simulated.front_end.traces import visible_part

    assert (visible_part(1, 50), visible_part(2, 50), visible_part(10, 0)) == (
        slice(0, 1024, None),
        slice(256, 768, None),
        slice(0, 102, None),
    )


def test_locks() -> None:
    from instrument.simulated.links.hislip import Locks

    locks = Locks()
    assert (
        repr((locks.request("a", b"", 0.0), locks.request("b", b"", 10.0), locks.may_talk("b")))
        == "(<LockAnswer.EXCLUSIVE: 1>, None, False)"
    )
    assert (
        repr((locks.release("a"), locks.settle(1.0), locks.may_talk("a")))
        == "(<LockAnswer.EXCLUSIVE: 1>, [('b', <LockAnswer.EXCLUSIVE: 1>)], False)"
    )


def test_hislipframe_encoded() -> None:
    from instrument.simulated.links.hislip import HislipFrame, MessageType

    assert (
        HislipFrame(MessageType.DATA_END, 0, 0xFFFFFF00, b"*IDN?").encoded().hex(" ", -4)
        == "48530700 ffffff00 00000000 00000005 2a49444e 3f"
    )


def test_event_text() -> None:
    from instrument.simulated.panel.events import event_text

    assert (event_text(401), event_text(113, "FOO?")) == ("Power on; ", "Undefined header; FOO?")


def test_status_bit() -> None:
    from instrument.simulated.panel.events import CME, EXE, QYE, status_bit

    assert (status_bit(113) == CME, status_bit(2244) == EXE, status_bit(420) == QYE, status_bit(350)) == (
        True,
        True,
        True,
        0,
    )


def test_join_leaves() -> None:
    from instrument.simulated.panel.parsing import join_leaves

    leaves = [
        (("HORizontal", "VIEW"), "MAIN"),
        (("HORizontal", "MAIn", "SCAle"), "5.0E-4"),
        (("HORizontal", "MAIn", "POSition"), "0.0E0"),
        (("HORizontal", "DELay", "SCAle"), "5.0E-5"),
    ]
    assert (
        join_leaves(leaves, header=True, verbose=True)
        == ":HORIZONTAL:VIEW MAIN;MAIN:SCALE 5.0E-4;POSITION 0.0E0;:HORIZONTAL:DELAY:SCALE 5.0E-5"
    )
    assert join_leaves(leaves, header=False, verbose=True) == "MAIN;5.0E-4;0.0E0;5.0E-5"


def test_abbreviations() -> None:
    from instrument.simulated.panel.parsing import abbreviations

    assert abbreviations("COUPling") == ["COUP", "COUPL", "COUPLI", "COUPLIN", "COUPLING"]
    assert (abbreviations("MEAS1"), abbreviations("SOUrce1")) == (
        ["MEAS1"],
        ["SOU1", "SOUR1", "SOURC1", "SOURCE1"],
    )


def test_spell() -> None:
    from instrument.simulated.panel.parsing import spell

    assert (spell("ACQuire", True), spell("ACQuire", False), spell("BYT_Nr", False)) == ("ACQUIRE", "ACQ", "BYT_N")


def test_block() -> None:
    from instrument.simulated.panel.parsing import block

    assert block(b"abc") == b"#13abc"


def test_nr3_panel() -> None:
    from instrument.simulated.panel.parsing import nr3

    assert (nr3(0), nr3(5e-4), nr3(1), nr3(-11008), nr3(3.852921)) == (
        "0.0E0",
        "5.0E-4",
        "1.0E0",
        "-1.1008E4",
        "3.852921E0",
    )


def test_parse_message() -> None:
    from instrument.simulated.panel.parsing import parse_message

    assert [c.header for c in parse_message(b" data:source ch1 ; width 1;; :CH1:SCALE? ")] == [
        "data:source",
        "width",
        ":CH1:SCALE",
    ]


def test_streamsplitter() -> None:
    from instrument.simulated.panel.parsing import StreamSplitter

    splitter = StreamSplitter()
    assert (splitter.feed(b"*IDN?\r\nCURVE #13"), splitter.feed(b"\n\n\n\n")) == ([b"*IDN?"], [b"CURVE #13\n\n\n"])


def test_operands() -> None:
    from instrument.simulated.panel.settings import operands

    assert (operands("CH1 - CH2"), operands("FFT(CH3,HANNING)")) == (["CH1", "CH2"], ["CH3"])


def test_time_steps() -> None:
    from instrument.simulated.panel.settings import time_steps

    assert (time_steps(5e-9)[:4], time_steps(5e-9)[-1]) == ((5e-09, 1e-08, 2.5e-08, 5e-08), 50.0)


def test_settings_of() -> None:
    from instrument.tds2014.front_panel import settings_of

    assert settings_of(":CH1:PROBE 10;SCALE 1.0E0;:LOCK NONE;:CURSOR:SELECT:SOURCE CH1") == {
        ":CH1:PROBE": "10",
        ":CH1:SCALE": "1.0E0",
        ":CURSOR:SELECT:SOURCE": "CH1",
    }


def test_as_text() -> None:
    from instrument.text_files import as_text

    assert (as_text(b"*IDN?\n"), as_text(b"\x80\x81")) == ({"text": "*IDN?\n"}, {"base64": "gIE="})
