"""The HiSLIP server: through PyVISA-py's own client, and byte by byte after IVI-6.1."""

import socket
import struct
import time

import numpy as np
import pytest
import pyvisa
from pyvisa_py.protocols.hislip import Instrument

from instrument.simulated import Fault, Faults, SimulatedTDS2014, VirtualClock, resource_manager
from instrument.simulated.links.hislip import HislipServer

HEADER = struct.Struct("!2sBBIQ")
INITIALIZE, ASYNC_INITIALIZE, DATA, DATA_END, TRIGGER = 0, 17, 6, 7, 12
FATAL, ERROR, INTERRUPTED, ASYNC_INTERRUPTED = 2, 3, 13, 14
STATUS_QUERY, STATUS_RESPONSE, SERVICE_REQUEST = 21, 22, 20
LOCK, LOCK_RESPONSE, LOCK_INFO, LOCK_INFO_RESPONSE = 4, 5, 24, 25
DEVICE_CLEAR, CLEAR_ACKNOWLEDGE, CLEAR_COMPLETE, CLEARED = 19, 23, 8, 9
REMOTE, REMOTE_RESPONSE = 10, 11


def ramp(times):
    """Every code comes, line feeds too."""
    return 4.5 * (2 * ((200.0 * times) % 1.0) - 1)


@pytest.fixture
def scope():
    return SimulatedTDS2014({1: ramp}, noise_levels=0.0, faults=Faults(seed=1))


@pytest.fixture
def server(scope):
    with HislipServer(scope) as server:
        yield server


@pytest.fixture
def visa(server):
    manager = pyvisa.ResourceManager("@py")
    opened = manager.open_resource(server.resource_name, timeout=4000)
    yield opened
    opened.close()
    manager.close()


def test_messages_and_their_ends(visa):
    assert visa.query("*IDN?").startswith("TEKTRONIX,TDS 2014,")
    visa.write("HEADER OFF;:CH1:PROBE 1;SCALE 1;:HOR:SCALE 5E-4;:DATA:ENCDG RIBINARY")
    codes = np.array(visa.query_binary_values("CURVE?", datatype="b"))
    assert codes.shape == (2500,)
    assert {10, 13} <= set(codes)  # codes that would end a message on a stream
    assert visa.query("CH1:SCALE?") == "1.0E0\n"
    # a message in pieces: this client sends no more than it has agreed on in one frame
    visa.visalib.sessions[visa.session].interface.max_msg_size = 116
    visa.visalib.sessions[visa.session].interface._max_msg_size = 36
    visa.write_raw(b"CH1:POSITION 1;:CH2:POSITION 2;:CH3:POSITION 3")
    assert visa.query("CH3:POSITION?") == "3.0E0\n"
    assert len(visa.query_binary_values("CURVE?", datatype="b")) == 2500  # and the answer comes in pieces, too


def test_no_message_waits_for_the_server_to_look_up(monkeypatch):
    """Clients take turns of some messages: what is left of a turn comes in the next, and not after a pause."""
    monkeypatch.setattr("instrument.simulated.links.stream_server.LOOK_UP", 60.0)
    with HislipServer(SimulatedTDS2014()) as server:
        client = Instrument("127.0.0.1", port=server.port, timeout=5.0)
        for count in range(1, 12):
            for number in range(count):
                client.send(f"CH1:SCALE {number + 1}".encode())
            client.send(b"HEADER OFF;:CH1:PROBE?")
            assert client.receive() == b"10\n"
        client.close()


def test_device_clear_frees_a_waiting_query(visa):
    visa.write("CH1:COUPLING GND;:TRIGGER:MAIN:MODE NORMAL;LEVEL 5;:ACQ:STOPA SEQ;STATE RUN;:HEADER OFF")
    visa.timeout = 100
    with pytest.raises(pyvisa.VisaIOError):
        visa.query("*OPC?")
    visa.timeout = 4000
    visa.clear()
    assert visa.query("TRIGGER:STATE?") == "READY\n"


def test_status_byte_tells_of_a_waiting_answer(visa):
    assert visa.read_stb() == 0
    visa.write("*ESE 128")
    assert visa.read_stb() == 32  # power on
    visa.write("*IDN?")
    assert visa.read_stb() == 48
    visa.read()
    assert visa.read_stb() == 32


def test_two_clients_have_each_their_answers(server):
    one, two = (Instrument("127.0.0.1", port=server.port, timeout=4.0) for _ in range(2))
    one.send(b"*IDN?")
    two.send(b"HEADER OFF;:CH1:SCALE?")
    assert two.receive() == b"1.0E0\n"
    assert one.receive().startswith(b"TEKTRONIX")
    one.send(b"CH1:SCALE 2")
    two.send(b"*OPC?")
    assert two.receive() == b"1\n"
    for client in (one, two):
        client.close()


def test_locks(server):
    one, two = (Instrument("127.0.0.1", port=server.port, timeout=4.0) for _ in range(2))
    assert one.async_lock_request(1.0) == "success"
    assert (two.async_lock_info(), two.async_lock_request(0.05)) == (1, "failure")
    two.send(b"CH1:COUPLING AC")  # waits for the lock
    one.send(b"HEADER OFF;:CH1:COUPLING?")
    assert one.receive() == b"DC\n"
    assert one.async_lock_request(0.0) == "error"
    assert one.async_lock_release() == "success"
    two.send(b"CH1:COUPLING?")
    assert two.receive() == b"AC\n"
    assert one.async_lock_release() == "error"
    assert (one.async_lock_request(0.0, "key"), two.async_lock_request(0.0, "key")) == ("success", "success")
    assert two.async_lock_request(0.0, "other") == "error"
    assert one.async_lock_request(0.0) == "success"  # the exclusive one within the shared one
    assert two.async_lock_request(0.02) == "failure"
    one.close()
    assert two.async_lock_request(2.0) == "success"  # what a lost client held is free again
    assert [two.async_lock_release() for _ in range(3)] == ["success", "success shared", "error"]
    two.close()


def test_several_scopes_behind_one_port():
    scopes = [SimulatedTDS2014(), SimulatedTDS2014(model="TDS1002")]
    manager = pyvisa.ResourceManager("@py")
    with HislipServer(scopes) as server:
        for name, model in zip(server.resource_names, ("TDS 2014", "TDS 1002"), strict=True):
            with manager.open_resource(name, timeout=4000) as opened:
                assert model in opened.query("*IDN?")
    manager.close()


def test_on_a_virtual_clock_waiting_costs_nothing():
    with HislipServer(SimulatedTDS2014({1: ramp}, clock=VirtualClock())) as server:
        client = Instrument("127.0.0.1", port=server.port, timeout=4.0)
        client.send(b"HOR:SCALE 5;:ACQ:STOPA SEQ;STATE RUN")
        client.send(b"*OPC?")
        assert client.receive() == b"1\n"  # 50 s of simulated time
        client.close()


class Wire:
    """A client of bytes."""

    def __init__(self, server, name=b"hislip0"):
        self.sync = self.connected(server)
        self.aside = self.connected(server)
        self.send(self.sync, INITIALIZE, 0, 0x01000000 | 0x7879, name)
        kind, control, parameter, _ = self.receive(self.sync)
        assert (kind, control, parameter >> 16) == (1, 0, 0x0100)
        self.send(self.aside, ASYNC_INITIALIZE, 0, parameter & 0xFFFF)
        assert self.receive(self.aside)[0] == 18

    @staticmethod
    def connected(server):
        made = socket.create_connection((server.host, server.port), timeout=4.0)
        return made

    @staticmethod
    def send(channel, kind, control, parameter, payload=b""):
        channel.sendall(HEADER.pack(b"HS", kind, control, parameter, len(payload)) + payload)

    @staticmethod
    def exactly(channel, count):
        data = b""
        while len(data) < count:
            piece = channel.recv(count - len(data))
            assert piece, "hung up"
            data += piece
        return data

    @classmethod
    def receive(cls, channel):
        prologue, kind, control, parameter, length = HEADER.unpack(cls.exactly(channel, HEADER.size))
        assert prologue == b"HS"
        return kind, control, parameter, cls.exactly(channel, length)

    def status(self, delivered=0):
        self.send(self.aside, STATUS_QUERY, delivered, 0)
        kind, status, *_ = self.receive(self.aside)
        assert kind == STATUS_RESPONSE
        return status

    def close(self):
        self.sync.close()
        self.aside.close()


@pytest.fixture
def wire(server):
    made = Wire(server)
    yield made
    made.close()


def test_an_answer_bears_the_number_of_its_question(wire):
    wire.send(wire.sync, DATA, 0, 0xFFFFFF00, b"*ID")
    wire.send(wire.sync, DATA_END, 0, 0xFFFFFF02, b"N?")
    kind, control, parameter, payload = wire.receive(wire.sync)
    assert (kind, control, parameter) == (DATA_END, 0, 0xFFFFFF02)
    assert payload.endswith(b"v1.04\n")


def test_a_message_before_the_answer_was_read_interrupts(wire):
    wire.send(wire.sync, DATA_END, 0, 2, b"*ESR?")
    assert wire.receive(wire.sync)[2:] == (2, b"128\n")
    wire.send(wire.sync, DATA_END, 0, 4, b"*ESR?")  # the bit that says "read" is not set
    assert wire.receive(wire.sync)[:3] == (INTERRUPTED, 0, 4)
    assert wire.receive(wire.aside)[:3] == (ASYNC_INTERRUPTED, 0, 4)
    assert wire.receive(wire.sync)[2:] == (4, b"4\n")  # query error
    wire.send(wire.sync, DATA_END, 1, 6, b"HEADER OFF;:EVENT?")
    assert wire.receive(wire.sync)[2:] == (6, b"410\n")


def test_service_request_comes_by_itself_and_once(wire):
    wire.send(wire.sync, DATA_END, 0, 2, b"*CLS;*ESE 1;*SRE 32;:ACQ:STOPA SEQ;STATE RUN;*OPC")
    assert wire.receive(wire.aside)[:2] == (SERVICE_REQUEST, 64 + 32)
    assert wire.status() == 64 + 32
    assert wire.status() == 32  # the poll has taken the request away
    wire.send(wire.sync, DATA_END, 0, 4, b"*ESR?")
    assert wire.receive(wire.sync)[3] == b"1\n"
    wire.send(wire.sync, DATA_END, 1, 6, b"ACQ:STATE RUN;*OPC")
    assert wire.receive(wire.aside)[:2] == (SERVICE_REQUEST, 64 + 32)


def test_clear_throws_away_what_is_under_way(wire):
    wire.send(wire.sync, DATA, 0, 2, b"CH1:SCALE ")
    time.sleep(0.05)
    wire.send(wire.aside, DEVICE_CLEAR, 0, 0)
    assert wire.receive(wire.aside)[0] == CLEAR_ACKNOWLEDGE
    wire.send(wire.sync, DATA_END, 0, 4, b"*IDN?")  # sent before the client noticed: not carried out
    wire.send(wire.sync, CLEAR_COMPLETE, 0, 0)
    assert wire.receive(wire.sync)[0] == CLEARED
    wire.send(wire.sync, DATA_END, 0, 0xFFFFFF00, b"HEADER OFF;:CH1:SCALE?;COUPLING?")
    assert wire.receive(wire.sync)[2:] == (0xFFFFFF00, b"1.0E0;DC\n")


def test_trigger_and_remote(wire):
    wire.send(wire.sync, DATA_END, 0, 2, b"*DDT #213CH2:SCALE 0.5")
    wire.send(wire.sync, TRIGGER, 0, 4)
    wire.send(wire.sync, DATA_END, 0, 6, b"HEADER OFF;:CH2:SCALE?")
    assert wire.receive(wire.sync)[2:] == (6, b"5.0E-1\n")
    wire.send(wire.aside, REMOTE, 1, 6)
    assert wire.receive(wire.aside)[0] == REMOTE_RESPONSE


@pytest.mark.parametrize(
    ("channel", "kind", "control", "payload", "code"),
    [
        ("sync", 99, 0, b"", 1),
        ("sync", STATUS_QUERY, 0, b"", 1),
        ("aside", DATA_END, 0, b"*IDN?", 1),
        ("sync", DATA_END, 2, b"*IDN?", 2),
        ("aside", REMOTE, 9, b"", 2),
        ("aside", LOCK, 7, b"", 2),
        ("sync", 200, 0, b"", 3),
        ("sync", DATA_END, 0, b"x" * ((1 << 20) + 1), 4),
    ],
)
def test_frames_that_are_not_carried_out(wire, channel, kind, control, payload, code):
    way = getattr(wire, channel)
    wire.send(way, kind, control, 2, payload)
    assert wire.receive(way)[:2] == (ERROR, code)
    wire.send(wire.sync, DATA_END, 0, 4, b"*OPC?")
    assert wire.receive(wire.sync)[3] == b"1\n"  # and the connection goes on


@pytest.mark.parametrize(
    ("first", "code"),
    [
        (b"GET / HTTP/1.0\r\n\r\n", 1),
        (HEADER.pack(b"HS", DATA_END, 0, 2, 5) + b"*IDN?", 2),
        (HEADER.pack(b"HS", INITIALIZE, 0, 0x01007879, 7) + b"hislip7", 3),
        (HEADER.pack(b"HS", ASYNC_INITIALIZE, 0, 12345, 0), 3),
    ],
)
def test_connections_that_begin_wrongly_are_told_and_hung_up_on(server, first, code):
    channel = Wire.connected(server)
    channel.sendall(first)
    kind, told, _, words = Wire.receive(channel)
    assert (kind, told) == (FATAL, code)
    assert {1: b"header", 2: b"both channels", 3: b"initialization"}[code] in words
    assert channel.recv(1) == b""
    channel.close()


def test_data_before_the_second_channel(server):
    channel = Wire.connected(server)
    Wire.send(channel, INITIALIZE, 0, 0x01007879, b"hislip0")
    Wire.receive(channel)
    Wire.send(channel, DATA_END, 0, 2, b"*IDN?")
    assert Wire.receive(channel)[:2] == (FATAL, 2)
    channel.close()


def test_a_fault_of_the_link_closes_both_channels(scope, wire):
    scope.faults.add(Fault("link closed", bytes_sent=4))
    wire.send(wire.sync, DATA_END, 0, 2, b"*IDN?")
    assert wire.receive(wire.sync)[3] == b"TEKT"
    assert (wire.sync.recv(1), wire.aside.recv(1)) == (b"", b"")


def test_service_request_in_process():
    manager = resource_manager({1: ramp}, clock=VirtualClock())
    with manager.open_resource("GPIB0::1::INSTR", read_termination="\n") as scope:
        scope.write("*CLS;*ESE 1;*SRE 32;:ACQ:STOPA SEQ;STATE RUN;*OPC")
        scope.wait_for_srq(timeout=10_000)
        assert scope.query("*ESR?") == "1"
        assert not scope.read_stb() & 64
        event, queue = pyvisa.constants.EventType.service_request, pyvisa.constants.EventMechanism.queue
        scope.enable_event(event, queue)
        assert scope.wait_on_event(event, 50, capture_timeout=True).timed_out
        scope.write("ACQ:STATE RUN;*OPC")
        assert scope.wait_on_event(event, 10_000).event.event_type == event
        assert scope.read_stb() == 64 + 32
        scope.disable_event(event, queue)
    manager.close()
