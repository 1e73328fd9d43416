"""The message sequences of other people's programs for this family, on every kind of link.

Each function sends what the named program sends, in its order, spelling and framing, as far as it can be read in
public sources, and interprets the answers as that program does. The scope shows a known sine; where such a program
gets it right with a real scope, it must get it right here.
"""

import contextlib
import struct
import sys
import time

import numpy as np
import pytest
import pyvisa

from instrument.simulated import HislipServer, PtyServer, SimulatedTDS2014, TcpServer, resource_manager

AMPLITUDE, FREQUENCY = 2.0, 1000.0
LINKS = ["gpib", "usb", "hislip", "serial in process", "tcp"] + ([] if sys.platform == "win32" else ["tty"])
MESSAGE_LINKS = LINKS[:3]  # where a message has an end of its own


def sine(times):
    return AMPLITUDE * np.sin(2 * np.pi * FREQUENCY * times)


@pytest.fixture
def scope():
    simulated = SimulatedTDS2014({1: sine, 2: lambda t: 0.5 * sine(t)}, noise_levels=0.0, seed=2)
    # Set by hand and long running when the program comes.
    shown = b"ACQ:STOPA SEQ;STATE RUN;*WAI;:ACQ:STOPA RUNSTOP;STATE RUN"
    for command in (b"CH1:PROBE 1", b"CH2:PROBE 1", b"CH1:SCALE 1", b"HORIZONTAL:SCALE 2.5E-4", shown, b"*ESR?"):
        for _ in simulated.execute(command):
            pass
    return simulated


@pytest.fixture
def opened(scope, request, manager):
    """A resource as PyVISA opens it by name, nothing set but what every such program sets for its link."""
    with contextlib.ExitStack() as stack:
        kind = request.param
        if kind in ("gpib", "usb", "serial in process"):
            name = {"gpib": "GPIB0::1::INSTR", "usb": "USB0::0x0699::0x0368::C010101::INSTR"}.get(
                kind, "ASRL1::INSTR"
            )
            manager = resource_manager(scopes={name: scope})
            stack.callback(manager.close)
        else:
            serve = {"tcp": TcpServer, "hislip": HislipServer}.get(kind, PtyServer)
            server = serve(scope)
            name = stack.enter_context(server).resource_name
        resource = manager.open_resource(name)
        stack.callback(resource.close)
        resource.timeout = 5000
        if kind not in MESSAGE_LINKS:
            resource.read_termination = resource.write_termination = "\n"
        yield resource


def on(*links):
    return pytest.mark.parametrize("opened", links or LINKS, indirect=True)


def is_the_sine(volts, *, scale=1.0):
    """The sine in amplitude, offset and frequency, to a converter level."""
    volts = np.asarray(volts) / scale
    assert len(volts) == 2500
    # 2.5 ms hold two and a half periods.
    phase = 2 * np.pi * FREQUENCY * 1e-6 * np.arange(2500)
    design = np.stack([np.sin(phase), np.cos(phase), np.ones(2500)], axis=1)
    fit, *_ = np.linalg.lstsq(design, volts, rcond=None)
    assert np.abs(volts - design @ fit).max() < 0.05
    assert np.hypot(fit[0], fit[1]) == pytest.approx(AMPLITUDE, rel=0.01)
    assert fit[2] == pytest.approx(0.0, abs=0.02)


def number(answer):
    """Last word of an answer, with or without a header."""
    return float(answer.split(" ")[-1])


@on()
def test_pymeasure_tds2000(opened):
    """Measurements by their shortest spelling; headers are left as they are."""
    opened.write("MEASU:IMM:SOU CH1")
    opened.write("MEASU:IMM:TYP PK2")
    assert number(opened.query("MEASU:IMM:VAL?")) == pytest.approx(4.0, abs=0.1)
    assert opened.query("MEASU:IMM:SOU?").strip().endswith("CH1")
    assert opened.query("MEASU:IMM:TYP?").strip().endswith("PK2PK")
    assert opened.query("MEASU:IMM:UNI?").strip().endswith('"V"')
    for kind, value in (("FREQ", 1000.0), ("PERI", 1e-3), ("CRM", np.sqrt(2)), ("MINI", -2.0), ("PWI", 5e-4)):
        opened.write(f"MEASU:IMM:TYP {kind}")
        assert number(opened.query("MEASU:IMM:VAL?")) == pytest.approx(value, rel=0.05)
    opened.write("MEASU:IMM:UNI V")  # a mistake in that driver, and the next query must not suffer from it
    opened.write("MEASU:IMM:TYP PHA")
    assert opened.query("MEASU:IMM:TYP?").strip().endswith("PWIDTH")


@on(*MESSAGE_LINKS)
def test_qcodes_tps2012(opened):
    """Two-byte positive integers read as latin-1 text; `SELect?` cut at semicolons."""
    opened.clear()
    opened.encoding = "latin-1"
    opened.read_termination = None
    opened.write("HEADER OFF")
    assert len(opened.query("*IDN?").strip().split(",")) == 4
    for message in ("DATa:ENCdg RPBinary", "DATa:WIDTh 2", "SELect:CH1 ON", "DATa:SOURce CH1"):
        opened.write(message)
    assert list(map(int, opened.query("SELect?").split(";"))) == [1, 0, 0, 0, 0, 0, 0, 0, 0]
    fields = opened.query("WFMPre?").split(";")
    assert len(fields) == 16
    opened.write("DATa:SOURce CH1")
    answer = opened.query("WAVFrm?").split(";")
    opened.write("*WAI")
    curve = ";".join(answer[16:])[6:-1]
    codes = np.array([(ord(high) - 128) * 256 for high in curve[::2]])
    yoff, ymult = float(fields[14]) - 2**15, float(fields[12])
    is_the_sine(ymult * (codes - yoff))
    opened.write("TRIGger FORce")
    opened.write("HORizontal:SCAle 5e-09")
    assert number(opened.query("HORizontal:SCAle?")) == 5e-9
    assert opened.query("TRIGger:MAIn:EDGE:SOURce?").strip() == "CH1"


@on()
def test_instrumentkit_tds224(opened):
    """Preamble after the curve, by the name of the source; block read by exact counts."""
    opened.write("HEAD 0")
    opened.write("DAT:SOU CH1")
    opened.write("DAT:ENC RIB")
    width = int(opened.query("DATA:WIDTH?"))
    opened.write("CURVE?")
    head = opened.read_bytes(2)
    assert head[:1] == b"#"
    count = int(opened.read_bytes(int(head[1:])))
    data = opened.read_bytes(count)
    opened.read_bytes(1)  # the line feed
    codes = np.frombuffer(data, dtype=f">i{width}")
    yoff, ymult, yzero = (float(opened.query(f"WFMP:CH1:{name}?")) for name in ("YOF", "YMU", "YZE"))
    xzero, xincr = float(opened.query("WFMP:XZE?")), float(opened.query("WFMP:XIN?"))
    assert (xzero, xincr) == pytest.approx((-1.25e-3, 1e-6))
    assert int(float(opened.query("WFMP:CH1:NR_P?"))) == 2500
    is_the_sine((codes - yoff) * ymult + yzero)
    opened.write("DAT:ENC ASCI")
    is_the_sine((np.array(opened.query("CURVE?").split(","), dtype=float) - yoff) * ymult + yzero)
    assert opened.query("CH1:COUPL?").strip() == "DC"


@on()
def test_sigrok_tds220(opened):
    """`*OPC?` before each message; ASCII curves of one channel after the other."""

    def send(message):
        assert opened.query("*OPC?").strip() == "1"
        opened.write(message)

    for message in ("HEAD OFF", "DAT:ENC ASCI"):
        send(message)
    for channel in (1, 2):
        for message in (
            f"CH{channel}:POS 0",
            f"CH{channel}:SCA 1.0e+00",
            f"SEL:CH{channel} ON",
            "HOR:SCA 2.50e-04",
        ):
            send(message)
    send("ACQ:STOPA SEQ")
    send("ACQ:STATE RUN")
    for channel, scale in ((1, 1.0), (2, 0.5)):
        send(f"DAT:SOU CH{channel}")
        send("CURV?")
        is_the_sine(np.array(opened.read().split(","), dtype=float) / 25, scale=scale)


@on()
def test_pyhardware_tds2024b(opened):
    """Every field of the preamble by itself, after a misspelt command that the scope does not know."""
    messages = ("HEADER OFF", "DATa:WIDth 1", "DATa:ENCdg RPBinary", "DATa:STARt 1", "DATa:STOP 2500")
    for message in (*messages, "SELect:CH1 ON", "DATa:SOUrce CH1", "WFRMPre:PT_Fmt Y"):
        opened.write(message)
    names = ("YZEro", "YMUlt", "YOFf", "XZEro", "XINcr", "PT_OFf", "NR_Pt")
    yzero, ymult, yoff, _, _, _, points = (float(opened.query(f"WFMPRe:{name}?")) for name in names)
    assert len(opened.query("WFMPRe?").split(";")) == 16
    opened.write("CURVe?")
    data = opened.read_bytes(2507)[:-1][-int(points) :]
    is_the_sine(yzero + ymult * (np.frombuffer(data, dtype=np.uint8) - yoff))
    assert int(opened.query("*ESR?")) & 32
    assert "113" in opened.query("ALLEV?")


@on()
def test_students_osci_class(opened):
    """Relative queries in one message, curve by PyVISA's own reader, acquisition stopped and started."""
    assert "TDS 2014" in opened.query("*IDN?")
    for message in ("HEADER OFF", "DAT:ENC RPB", "DAT:WID 1", "SELECT:CH2 1", "ACQ:STATE 0", "DATA:SOUR CH1"):
        opened.write(message)
    yzero, ymult, yoff = opened.query_ascii_values("WFMPRE:YZE?;YMU?;YOFF?", separator=";")
    assert int(opened.query("WFMP:NR_Pt?")) == 2500
    data = opened.query_binary_values("CURV?", datatype="B", container=np.array)
    is_the_sine(yzero + ymult * (data - yoff))
    opened.write("ACQ:STATE 1")
    opened.write("MEASU:IMM:SOU CH1")
    opened.write("MEASU:IMM:TYPE MAXI")
    assert float(opened.query("MEASU:IMM:VAL?")) == pytest.approx(2.0, abs=0.1)
    assert opened.query("MEASU:IMM:UNI?").strip() == '"V"'


@on()
def test_oscilloscope_class_with_event_check(opened):
    """After each setting `*ESR?` and, if it is not zero, `EVMSG?`."""

    def set_parameter(message):
        opened.write(message)
        return True if int(opened.query("*ESR?")) == 0 else opened.query("EVMSG?").split(",")[1].strip('"')

    opened.query("*ESR?")
    assert set_parameter("HEADER OFF") is True
    assert set_parameter("ACQ:MOD SAMPLE") is True
    assert set_parameter("ACQ:NUMAV 64") is True
    assert "BANANA" in set_parameter("ACQ:BANANA 1")
    assert set_parameter("DAT:ENC ASCI") is True
    assert opened.query("DAT:SOU?").strip() == "CH1"
    fields = opened.query("WFMP?").split(";")
    assert len(fields) == 16
    assert fields[11].strip('"') == "s"
    ymult, yzero, yoff = map(float, fields[12:15])
    is_the_sine([yzero + ymult * (int(word) - yoff) for word in opened.query("CURV?").split(",")])
    assert opened.query("ACQ?").strip() == "SAMPLE;64;1;RUNSTOP"
    assert opened.query("TRIG:STATE?").strip() in ("AUTO", "ARMED", "READY", "TRIGGER")
    assert opened.query("CURS?").startswith("OFF;CH1;")
    assert opened.query("*CAL?").strip() == "0"
    assert opened.query("CAL:STATUS?").strip() == "PASS"
    assert opened.query("DIA:RESUL:FLA?").strip() == "PASS"
    assert opened.query("ERRLOG:FIRST?").strip() == '""'
    assert opened.query("BUSY?").strip() == "0"
    for message in ("CAL:ABO", "CAL:CONTINUE", "CAL:INTERNAL"):
        opened.write(message)
    assert int(opened.query("*ESR?")) == 0


@on()
def test_makers_own_example(opened):
    """Lower case, single acquisition, `*opc?`, little-endian codes, the whole preamble, events at the end."""
    opened.write("*cls")
    opened.write("header 0")
    opened.write("acquire:state OFF")
    opened.write("acquire:stopafter SEQUENCE;state ON")
    assert opened.query("*opc?").strip() == "1"
    opened.write("data:encdg SRIBINARY")
    opened.write("data:source CH1")
    opened.write("data:start 1")
    record = int(opened.query("horizontal:recordlength?"))
    opened.write(f"data:stop {record}")
    opened.write("wfmpre:byt_nr 1")
    codes = opened.query_binary_values("curve?", datatype="b", container=np.array)
    names = ("xincr", "xzero", "pt_off", "ymult", "yoff", "yzero")
    _, _, _, ymult, yoff, yzero = (float(opened.query(f"wfmpre:{name}?")) for name in names)
    is_the_sine((codes - yoff) * ymult + yzero)
    assert int(opened.query("*esr?")) == 0
    assert opened.query("allev?").startswith("0,")


@on()
def test_labgrid_tds2000(opened):
    """Channel settings, five measurements, and the screen as TIFF."""
    opened.write("HEADER OFF")
    assert opened.query("SELect:CH1?").strip() == "1"
    assert opened.query(":CH1:BANdwidth?").strip() == "OFF"
    assert opened.query(":CH1:INVert?").strip() == "OFF"
    assert [float(opened.query(f":CH1:{name}?")) for name in ("POSition", "PROBe", "SCAle")] == [0.0, 1.0, 1.0]
    opened.write(":MEASUrement:IMMed:SOUrce1 CH1")
    expected = {"MEAN": 0.0, "FREQuency": 1000.0, "PK2pk": 4.0, "MINImum": -2.0, "MAXImum": 2.0}
    for kind, value in expected.items():
        opened.write(f":MEASUrement:IMMed:TYPe {kind}")
        assert float(opened.query(":MEASUrement:IMMed:VALue?")) == pytest.approx(value, rel=0.05, abs=0.05)
    opened.write(":hardcopy:format tiff")
    opened.write(":hardcopy:port gpib")
    opened.write(":hardcopy start")
    header = opened.read_bytes(8)
    assert header[:4] == b"II*\0"
    directory = struct.unpack("<I", header[4:])[0]
    picture = header + opened.read_bytes(directory - 8)
    (entries,) = struct.unpack("<H", opened.read_bytes(2))
    opened.read_bytes(12 * entries + 4)
    assert len(set(picture[8 : 8 + 320 * 240])) > 3
    assert opened.query("*OPC?").strip() == "1"


@on(*MESSAGE_LINKS)
def test_visa_example_with_serial_poll(opened):
    """Factory setup, one acquisition whose end is told by the status byte, 500 points of two bytes."""
    opened.write(":RECALL:SETUP FACTORY")
    opened.write(":CH1:PROBE 1")
    opened.write(":SELECT:CH1 1;CH2 0;CH3 0;CH4 0")
    opened.write(":DATA:ENCDG RIBINARY;SOURCE CH1;START 1;STOP 500;WIDTH 2")
    opened.write(":ACQUIRE:STOPAFTER SEQUENCE;STATE 0;MODE SAMPLE")
    opened.write("DESE 1;*ESE 1;*SRE 32")
    opened.write("*CLS")
    opened.write(":ACQUIRE:STATE 1")
    opened.write("*OPC")
    deadline = time.monotonic() + 5
    while not opened.read_stb() & 64:
        assert time.monotonic() < deadline, "no service request"
    assert int(opened.query("*ESR?")) == 1
    answer = opened.query_binary_values("CURVE?", datatype="h", is_big_endian=True, header_fmt="ieee")
    assert len(answer) == 500
    assert not np.any(np.array(answer) % 256)


@on()
def test_serial_script_that_keeps_headers(opened):
    """Headers stay on, so that no value can be taken for another; the block is found behind its header."""
    assert opened.query("HEADER?").strip() == ":HEADER 1"
    opened.write("DATA:ENCDG SRIBINARY;WIDTH 1;SOURCE CH1")
    answer = opened.query("WFMPRE?").strip()
    fields = dict(part.split(" ", 1) for part in answer.removeprefix(":WFMPRE:").split(";"))
    assert fields["ENCDG"], fields["BYT_OR"] == ("BIN", "LSB")
    opened.write("CURVE?")
    assert opened.read_bytes(13) == b":CURVE #42500"
    codes = np.frombuffer(opened.read_bytes(2501)[:-1], dtype=np.int8)
    is_the_sine((codes - float(fields["YOFF"])) * float(fields["YMULT"]) + float(fields["YZERO"]))


@on()
def test_reset_and_read_at_once(opened):
    """`*RST` and the question for a curve in one message: the answer has to be that of the new settings."""
    opened.write("HEADER OFF")
    opened.write("*RST;:CH1:PROBE 1;SCALE 1;:DATA:ENCDG RIBINARY;WIDTH 1;:CURVE?")
    data = opened.read_bytes(2507)
    assert data[:6] == b"#42500"
    # 5 ms at 500 us/div, 1 V/div
    codes = np.frombuffer(data[6:-1], dtype=np.int8)
    assert np.ptp(codes.astype(int)) == pytest.approx(100, abs=2)


@on()
def test_single_shot_with_blanks_behind_semicolons(opened):
    """As microcontrollers on USB send it."""
    opened.write("HEADER OFF")
    opened.write("ACQuire:STOPAfter SEQUENCE; STATE RUN")
    assert opened.query("*OPC?").strip() == "1"
    assert opened.query("ACQuire?").strip() == "SAMPLE;16;0;SEQUENCE"
    opened.write("ACQuire:STOPAfter RUNSTOP; STATE RUN")
    assert opened.query("ACQ:STATE?").strip() == "1"


@on("gpib", "tcp")
def test_several_sources_in_one_command_are_refused(opened):
    """An old GPIB program names two; this family takes one at a time, and says so."""
    opened.query("*ESR?")
    opened.write("DATA:SOURCE CH1, CH2")
    assert int(opened.query("*ESR?")) & 48
    assert opened.query("DATA:SOURCE?").strip() == ":DATA:SOURCE CH1"


@on(*MESSAGE_LINKS)
def test_autodetect_that_gives_up_early(opened):
    """A query whose answer is never fetched, then another: the first answer is gone and 410 is reported."""
    opened.write("SYST:ERR?")
    opened.write("*OPT?")
    opened.query("*ESR?")
    opened.write("*IDN?")
    assert opened.query("*ESR?").strip() == "4"
    assert "410" in opened.query("ALLEV?")
    with pytest.raises(pyvisa.VisaIOError):
        opened.timeout = 50
        opened.query("SYST:ERR?")
    assert "2014" in opened.query("*IDN?")
