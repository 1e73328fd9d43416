"""Plain PyVISA programs on all links, through real bytes."""

import contextlib
import socket
import threading

import numpy as np
import pytest
import pyvisa
import serial

from instrument.simulated import (
    Fault,
    Faults,
    PtyServer,
    SimulatedTDS2014,
    TcpServer,
    VirtualClock,
    resource_manager,
)
from instrument.simulated.links.stream_server import Line

IDENTITY = "TEKTRONIX,TDS 2014,0,CF:91.1CT FV:v4.12 TDS2CM:CMV:v1.04"
NEEDS_PTY = pytest.mark.skipif(not hasattr(__import__("os"), "openpty"), reason="no pseudo-terminals here")


def sine(times):
    return 2.0 * np.sin(2 * np.pi * 1000.0 * times)


def make_scope(**options):
    return SimulatedTDS2014({1: sine}, clock=VirtualClock(), noise_levels=0.3, **options)


@contextlib.contextmanager
def in_process(name="GPIB0::1::INSTR", **options):
    manager = resource_manager(scopes={name: make_scope(**options)})
    try:
        yield manager, name
    finally:
        manager.close()


@contextlib.contextmanager
def served(server_class, **options):
    with server_class(make_scope(**options)) as server:
        manager = pyvisa.ResourceManager("@py")
        try:
            yield manager, server.resource_name
        finally:
            manager.close()


LINKS = [
    pytest.param(lambda **o: in_process("GPIB0::1::INSTR", **o), id="GPIB"),
    pytest.param(lambda **o: in_process("USB0::0x0699::0x0368::C010101::INSTR", **o), id="USB"),
    pytest.param(lambda **o: in_process("ASRL3::INSTR", **o), id="ASRL"),
    pytest.param(lambda **o: in_process("TCPIP0::10.0.0.1::4000::SOCKET", **o), id="SOCKET"),
    pytest.param(lambda **o: served(TcpServer, **o), id="tcp"),
    pytest.param(lambda **o: served(PtyServer, **o), id="pty", marks=NEEDS_PTY),
]


def open_plain(manager, name):
    return manager.open_resource(name, read_termination="\n", write_termination="\n", timeout=10_000)


@pytest.mark.parametrize("link", LINKS)
def test_plain_script_reads_a_record(link):
    with link() as (manager, name), open_plain(manager, name) as scope:
        assert scope.query("*IDN?") == IDENTITY
        scope.write("HEADER OFF")
        scope.write("CH1:PROBE 1;SCALE 0.5;:HOR:SCALE 5E-4")
        scope.write("DATA:SOURCE CH1;ENCDG RIBINARY;WIDTH 1;START 1;STOP 2500")
        scope.write("ACQUIRE:STOPAFTER SEQUENCE;STATE RUN")
        assert scope.query("*OPC?") == "1"
        fields = scope.query("WFMPRE?").split(";")
        codes = scope.query_binary_values("CURVE?", datatype="b", container=np.array)
        times = float(fields[10]) + float(fields[8]) * np.arange(2500)
        volts = (codes - float(fields[14])) * float(fields[12]) + float(fields[13])
        assert len(codes) == int(fields[5]) == 2500
        assert np.abs(volts - sine(times)).max() < 0.1
        # every byte value but 0x80, also LF, CR and the flow-control characters, went through
        assert {10, 13, 3} <= set(codes.tolist())
        wide = scope.query_binary_values(
            "DATA:WIDTH 2;:CURVE?", datatype="h", is_big_endian=True, container=np.array
        )
        assert np.array_equal(wide, 256 * codes.astype(int))
        assert scope.query("CH1:SCALE?;POSITION?") == "5.0E-1;0.0E0"


@pytest.mark.parametrize("link", LINKS)
def test_unknown_query_times_out_and_the_next_answers(link):
    with link() as (manager, name), open_plain(manager, name) as scope:
        scope.timeout = 150
        with pytest.raises(pyvisa.VisaIOError) as error:
            scope.query("SYST:ERR?")
        assert error.value.error_code == pyvisa.constants.StatusCode.error_timeout
        scope.timeout = 5000
        assert scope.query("*IDN?") == IDENTITY
        assert int(scope.query("*ESR?")) & 32
        assert "113," in scope.query("ALLEV?")


@pytest.mark.parametrize("link", LINKS)
def test_read_bytes_takes_exactly_what_it_asks_for(link):
    with link() as (manager, name), open_plain(manager, name) as scope:
        scope.read_termination = None
        scope.write("HEADER OFF")
        scope.write("CURVE?")
        assert scope.read_bytes(6) == b"#42500"
        assert len(scope.read_bytes(2501)) == 2501


def test_read_raw_in_chunks_gives_the_whole_message():
    with in_process() as (manager, name), manager.open_resource(name) as scope:
        scope.chunk_size = 100
        scope.write("HEADER OFF;:CURVE?")
        answer = scope.read_raw()
        assert len(answer) == 2507 and answer.endswith(b"\n")
        assert scope.query("HEADER?") == "0\n"


def test_message_link_discards_an_unread_answer_and_clear_empties_it():
    with in_process() as (manager, name), manager.open_resource(name) as scope:
        scope.timeout = 200
        scope.write("*IDN?")
        scope.write("HEADER?")
        assert scope.read() == ":HEADER 1\n"
        scope.write("*IDN?")
        scope.clear()
        with pytest.raises(pyvisa.VisaIOError):
            scope.read()
        assert scope.query("*ESR?") == "132\n"
        assert scope.query("EVENT?;EVENT?;EVENT?") == ":EVENT 401;:EVENT 410;:EVENT 420\n"


def test_stream_link_keeps_unread_answers_in_order():
    with in_process("ASRL1::INSTR") as (manager, name), open_plain(manager, name) as scope:
        scope.write("HEADER OFF")
        scope.write("CH1:SCALE?")
        scope.write("HEADER?")
        assert [scope.read(), scope.read()] == ["1.0E0", "0"]


def test_serial_terminator_follows_its_setting():
    with in_process("ASRL1::INSTR") as (manager, name):
        scope = manager.open_resource(name, read_termination="\r", write_termination="\r")
        scope.write("RS232:TRANSMIT:TERMINATOR CR")
        assert scope.query("*IDN?") == IDENTITY
        assert scope.query("RS232:TRAN:TERM?") == ":RS232:TRANSMIT:TERMINATOR CR"


def test_serial_answers_take_their_bits_on_the_virtual_clock():
    with in_process("ASRL1::INSTR") as (manager, name), open_plain(manager, name) as scope:
        clock = manager.visalib._instruments[name].clock
        scope.write("HEADER OFF")
        before = clock.now()
        scope.query_binary_values("CURVE?", datatype="b")
        assert clock.now() - before == pytest.approx(2508 * 10 / 9600, abs=0.2)
        scope.timeout = 100
        with pytest.raises(pyvisa.VisaIOError):
            scope.query_binary_values("CURVE?", datatype="b")
        scope.clear()  # the rest of it is still on the line
        scope.timeout = 2000
        scope.write("RS232:BAUD 19200")
        assert len(scope.query_binary_values("CURVE?", datatype="b")) == 2500


def test_resource_manager_lists_and_refuses():
    manager = resource_manager(sine, clock=VirtualClock())
    assert manager.list_resources() == ("GPIB0::1::INSTR", "USB0::0x0699::0x0368::C010101::INSTR")
    assert manager.list_resources("GPIB?*") == ("GPIB0::1::INSTR",)
    with pytest.raises(pyvisa.VisaIOError) as error:
        manager.open_resource("GPIB0::2::INSTR")
    assert error.value.error_code == pyvisa.constants.StatusCode.error_resource_not_found
    with manager.open_resource("gpib::1") as scope:
        assert scope.query("*IDN?").strip() == IDENTITY
        assert scope.read_stb() == 0
    other = resource_manager(clock=VirtualClock())
    assert other is not manager
    other.close()
    manager.close()


def test_switched_off_instrument_is_a_lost_one_on_a_message_link():
    with in_process() as (manager, name), manager.open_resource(name) as scope:
        manager.visalib._instruments[name].power_off()
        for attempt in (lambda: scope.query("*IDN?"), scope.clear, lambda: manager.open_resource(name)):
            with pytest.raises(pyvisa.VisaIOError):
                attempt()


def test_virtual_time_lets_a_long_wait_pass_at_once():
    with in_process() as (manager, name), manager.open_resource(name) as scope:
        scope.write("HOR:SCALE 50;:TRIG:MAIN:MODE NORMAL;EDGE:SOURCE LINE;:ACQ:STOPAFTER SEQ;STATE RUN")
        scope.timeout = 2_000_000
        assert scope.query("*OPC?") == "1\n"
        assert manager.visalib._instruments[name].clock.now() > 500


def test_tcp_serves_clients_one_after_another_and_at_once():
    with TcpServer(make_scope()) as server:
        for _ in range(5):
            with socket.create_connection((server.host, server.port), timeout=5) as client:
                client.sendall(b"*ID")
                client.sendall(b"N?\r\nHEADER?\n")
                received = b""
                while received.count(b"\n") < 2:
                    received += client.recv(1000)
                assert received == IDENTITY.encode() + b"\n:HEADER 1\n"
        with contextlib.ExitStack() as stack:
            address = (server.host, server.port)
            clients = [stack.enter_context(socket.create_connection(address, timeout=5)) for _ in range(4)]
            for number, client in enumerate(clients, start=1):
                client.sendall(f"CH{number}:COUPLING?\n".encode())
            for number, client in enumerate(clients, start=1):
                assert client.makefile("rb").readline() == f":CH{number}:COUPLING DC\n".encode()


def test_tcp_listens_on_loopback_only():
    with TcpServer(make_scope()) as server:
        assert server.host == "127.0.0.1"
        assert server.resource_name == f"TCPIP0::127.0.0.1::{server.port}::SOCKET"


def test_tcp_closes_when_the_power_goes_in_the_middle_of_a_block():
    faults = Faults(Fault("power off", shortest=2000, bytes_sent=1000))
    with TcpServer(make_scope(faults=faults)) as server:
        with socket.create_connection((server.host, server.port), timeout=5) as client:
            client.sendall(b"HEADER OFF;:CURVE?\n")
            received = b""
            while piece := client.recv(4096):
                received += piece
        assert received.startswith(b"#42500") and len(received) == 1000
        assert not server.scope.powered
        server.close()
        server.close()


@pytest.mark.parametrize("server_class", [TcpServer, pytest.param(PtyServer, marks=NEEDS_PTY)])
def test_instrument_switched_off_by_hand_hangs_up(server_class):
    with server_class(make_scope()) as server:
        manager = pyvisa.ResourceManager("@py")
        with open_plain(manager, server.resource_name) as scope:
            assert scope.query("*IDN?") == IDENTITY
            with server.scope.lock:
                server.scope.power_off()
            scope.timeout = 300
            with pytest.raises((pyvisa.VisaIOError, OSError)):
                scope.query("*IDN?")
        manager.close()


def test_closing_a_server_frees_port_and_thread():
    before = threading.active_count()
    server = TcpServer(make_scope())
    port = server.port
    server.close()
    assert threading.active_count() == before
    TcpServer(make_scope(), port=port).close()


@NEEDS_PTY
def test_pty_is_a_real_serial_port_that_passes_every_byte():
    with PtyServer(make_scope()) as server, serial.Serial(server.device, 9600, timeout=5) as port:
        port.write(b"HEADER OFF\rDATA:DEST REFA;SOURCE REFA\n:SELECT:REFA ON\r\n")
        every = bytes(range(256))
        port.write(b"DATA:STOP 256\n:CURVE #3256" + every + b"\nCURVE?\n")
        assert port.read(5 + 256 + 1) == b"#3256" + every + b"\n"


@NEEDS_PTY
def test_pty_serves_one_client_after_another():
    with PtyServer(make_scope()) as server:
        for _ in range(3):
            with serial.Serial(server.device, timeout=5) as port:
                port.write(b"*IDN?\n")
                assert port.readline().decode().strip() == IDENTITY


def test_paced_line_delivers_ten_bits_a_byte():
    line = Line(baud_rate=9600)
    line.put(bytes(960), now=100.0)
    assert line.take(100.0) == b""
    assert len(line.take(100.1)) == 96
    assert len(line.take(100.5)) == 384
    assert len(line.take(100.99)) + len(line.take(101.01)) == 480
    assert len(line) == 0
    line.put(b"later", now=200.0)
    assert line.take(200.0005) == b""


@NEEDS_PTY
def test_paced_pty_delivers_everything():
    scope = make_scope()
    with PtyServer(scope, baud_rate=115200) as server, serial.Serial(server.device, timeout=5) as port:
        port.write(b"HEADER OFF\nCURVE?\n")
        assert len(port.read(2507)) == 2507
