"""RS-232: flow control, input errors and the break."""

import os
import re
import socket

import numpy as np
import pytest
import pyvisa
import serial
from pyvisa.constants import ControlFlow, LineState, SerialTermination

from instrument.simulated import (
    Fault,
    Faults,
    PtyServer,
    SimulatedTDS2014,
    TcpServer,
    VirtualClock,
    resource_manager,
)
from instrument.simulated.links.exchange import MessageExchange

IDENTITY = "TEKTRONIX,TDS 2014,0,CF:91.1CT FV:v4.12 TDS2CM:CMV:v1.04"
NEEDS_PTY = pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo-terminals here")
NAME = "ASRL1::INSTR"


def ramp(times):
    """Slow enough that a record holds every code from -100 to 100."""
    return 4.0 * np.sin(2 * np.pi * 400.0 * times)


@pytest.fixture
def port():
    """A program at a serial port, on virtual time."""
    scope = SimulatedTDS2014({1: ramp}, clock=VirtualClock(), noise_levels=0.0, faults=Faults(seed=3))
    manager = resource_manager(scopes={NAME: scope})
    resource = manager.open_resource(NAME, read_termination="\n", write_termination="\n", timeout=3000)
    resource.scope = scope
    yield resource
    manager.close()


def events(port):
    port.query("*ESR?")
    return [int(code) for code in re.findall(r'(\d+),"', port.query("HEADER OFF;:ALLEV?"))]


def send_slowly(port, message, pause):
    for byte in (message + "\n").encode():
        port.write_raw(bytes([byte]))
        port.scope.clock.sleep(pause)


@pytest.mark.parametrize(
    "lose_flow_control",
    [
        lambda port: setattr(port.scope.faults, "no_flow_control", True),
        lambda port: port.write("RS232:HARDFLAGGING OFF"),
    ],
    ids=["three-wire cable", "no flagging"],
)
def test_burst_without_flow_control_overruns_the_input(port, lose_flow_control):
    lose_flow_control(port)
    with pytest.raises(pyvisa.VisaIOError) as error:
        port.query("*IDN?")
    assert error.value.error_code == pyvisa.constants.StatusCode.error_timeout
    send_slowly(port, "*IDN?", 0.05)
    assert port.read() == IDENTITY
    send_slowly(port, "*ESR?", 0.05)
    assert port.read() == "136"  # power on, device error
    send_slowly(port, "ALLEV?", 0.05)
    assert "363," in port.read()


def test_a_burst_posts_one_overrun_and_drops_the_answers_on_their_way(port):
    port.write("*IDN?")
    port.scope.faults.no_flow_control = True
    port.write("CH1:SCALE 5;:CH2:SCALE 5;:CH3:SCALE 5")
    port.scope.faults.no_flow_control = False
    port.scope.clock.sleep(1.0)
    assert events(port) == [401, 363]
    assert port.query("CH1:SCALE?;:CH3:SCALE?") == "1.0E0;1.0E0"


def test_hard_flagging_loses_nothing_in_a_burst(port):
    port.write("RS232:BAUD 19200;:" + ";:".join(f"CH{n}:SCALE {n}" for n in (1, 2, 1, 2, 1, 2)))
    assert port.query("HEADER OFF;:CH1:SCALE?;:CH2:SCALE?") == "1.0E0;2.0E0"
    assert events(port) == [401]


@pytest.mark.parametrize(("kind", "code"), [("parity error", 361), ("framing error", 362), ("input overrun", 363)])
def test_input_errors_drop_everything_and_post_their_event(port, kind, code):
    port.write("*IDN?")
    fault = Fault(kind, answer=1)
    port.scope.faults.add(fault)
    port.write("CH1:SCALE 5;SCALE?")
    with pytest.raises(pyvisa.VisaIOError):
        port.read()
    assert port.scope.faults.happened == [fault]
    assert events(port) == [401, code]
    assert port.query("CH1:SCALE?") == "1.0E0"


def test_input_errors_do_not_exist_on_other_links(make_bench):
    bench = make_bench(faults=Faults(Fault("parity error")))
    assert bench.ask("HEADER?") == ":HEADER 1"
    assert bench.events() == [401]


def test_xoff_holds_the_answers_until_xon_only_with_soft_flagging(port):
    port.write("RS232:SOFTFLAGGING ON")
    port.write_raw(b"\x13*IDN?\n")
    port.timeout = 500
    with pytest.raises(pyvisa.VisaIOError):
        port.read()
    port.write_raw(b"\x11")
    assert port.read() == IDENTITY
    port.write("RS232:HARDFLAGGING ON")
    port.write_raw(b"\x13*IDN?\n")
    assert port.read() == IDENTITY


def test_flow_characters_in_a_block_lock_a_soft_flagged_line_until_a_break(port):
    port.write("RS232:SOFTFLAGGING ON;:DATA:DESTINATION REFA")
    port.write_raw(b"CURVE #15ab\x13de\n*IDN?\n")
    port.timeout = 500
    with pytest.raises(pyvisa.VisaIOError):
        port.read()
    port.break_state = LineState.asserted
    assert port.read() == "DCL"
    assert port.query("*IDN?") == IDENTITY


def test_a_program_with_xon_xoff_is_locked_by_the_bytes_of_a_curve(port):
    port.write("HEADER OFF;:CH1:PROBE 1;SCALE 1;:HOR:SCALE 2.5E-4;:RS232:SOFTFLAGGING ON")
    codes = port.query_binary_values("CURVE?", datatype="b")
    last = [code for code in codes if code in (0x11, 0x13)]
    assert {0x11, 0x13} <= set(last)
    port.flow_control = ControlFlow.xon_xoff
    port.write("DATA:STOP 1")
    port.query("CURVE?")
    port.write(f"DATA:START 1;STOP {codes.index(0x13) + 1}")
    port.timeout = 2000
    port.write("CURVE?")
    with pytest.raises(pyvisa.VisaIOError):
        port.read_bytes(len(f"#3{0:03d}") + codes.index(0x13) + 2)  # XOFF is taken out: one byte is missing
    with pytest.raises(pyvisa.VisaIOError) as error:
        port.write("*IDN?")
    assert error.value.error_code == pyvisa.constants.StatusCode.error_timeout


def test_break_at_the_end_of_a_write_clears_and_answers_dcl(port):
    port.write("RS232:TRANSMIT:TERMINATOR CRLF;:ACQ:STOPAFTER SEQ;:TRIG:MAIN:MODE NORM;:CH1:SCALE 2")
    port.write("TRIG:MAIN:LEVEL 15;:ACQ:STATE RUN;*OPC?")
    port.end_output = SerialTermination.termination_break
    port.write_raw(b"\n")
    port.end_output = SerialTermination.none
    assert port.read() == "DCL\r"
    assert port.query("CH1:SCALE?") == ":CH1:SCALE 2.0E0\r"


def test_adapter_has_the_terminator_and_the_overrun_of_rs232():
    scope = SimulatedTDS2014({1: ramp}, clock=VirtualClock(), faults=Faults())
    with TcpServer(scope, serial=True) as server, socket.create_connection((server.host, server.port)) as client:
        client.settimeout(5)
        client.sendall(b"RS232:TRANSMIT:TERMINATOR CR;*IDN?\n")
        answer = b""
        while not answer.endswith(b"\r"):
            answer += client.recv(100)
        assert answer.decode() == IDENTITY + "\r"
        scope.faults.no_flow_control = True
        client.sendall(b"RS232:TRANSMIT:TERMINATOR LF\n")
        client.settimeout(0.3)
        with pytest.raises(TimeoutError):
            client.recv(100)
        with scope.lock:
            scope.status.read_esr()
            assert [code for code, _ in scope.status.all_events()] == [401, 363]
            assert scope.panel.text("RS232:TRANSMIT:TERMINATOR") == "CR"


@pytest.mark.parametrize("server_class", [TcpServer, pytest.param(PtyServer, marks=NEEDS_PTY)])
def test_break_of_a_server_reaches_its_clients(server_class):
    scope = SimulatedTDS2014({1: ramp}, clock=VirtualClock())
    with server_class(scope) as server:
        manager = pyvisa.ResourceManager("@py")
        try:
            with manager.open_resource(server.resource_name, read_termination="\n", timeout=5000) as client:
                client.write_termination = "\n"
                assert client.query("*IDN?") == IDENTITY
                server.break_signal()
                assert client.read() == "DCL"
                assert client.query("*IDN?") == IDENTITY
        finally:
            manager.close()


@NEEDS_PTY
def test_xon_xoff_work_through_a_pseudo_terminal():
    scope = SimulatedTDS2014({1: ramp}, clock=VirtualClock())
    with PtyServer(scope) as server, serial.Serial(server.device, timeout=5) as port:
        port.write(b"RS232:SOFTFLAGGING ON;*OPC?\n")
        assert port.readline() == b"1\n"
        port.write(b"\x13*IDN?\n")
        port.timeout = 0.2
        assert port.readline() == b""
        port.write(b"\x11")
        port.timeout = 5
        assert port.readline().decode().strip() == IDENTITY


def test_slow_bytes_pass_an_unprotected_input_and_fast_ones_do_not():
    scope = SimulatedTDS2014(clock=VirtualClock(), faults=Faults())
    scope.faults.no_flow_control = True
    link = MessageExchange(scope, message_ends=False, serial=True)
    for number, byte in enumerate(b"*IDN?\n"):
        link.receive(bytes([byte]), now=10 + 0.05 * number)
    link.pump()
    assert link.take() == IDENTITY.encode() + b"\n"
    link.receive(b"*IDN?\n", now=20.0)
    link.pump()
    assert link.take() is None
