"""The driver behind a GPIB adapter of Prologix' kind, on TCP and on a terminal; plain names and advice."""

import socket
import sys

import numpy as np
import pytest
import pyvisa

from instrument import TDS2014
from instrument.claims import USB_RULE, advice
from instrument.errors import LinkError
from instrument.simulated import PtyServer, SimulatedTDS2014
from instrument.simulated.links.scope_servers import GpibAdapterServer

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="there are serial terminals on POSIX only")
LINE_FEED = 10


def ramp(times):
    return 0.9 * (2 * ((200.0 * times) % 1.0) - 1)


@pytest.fixture(params=["tcp", pytest.param("terminal", marks=POSIX)])
def server(request):
    scope = SimulatedTDS2014({1: ramp, 2: lambda t: np.full_like(t, LINE_FEED * 0.02)}, noise_levels=0.0)
    with GpibAdapterServer(scope, address=7, terminal=request.param == "terminal") as server:
        yield server


@pytest.fixture
def scope(server):
    with TDS2014(server.resource_name) as scope:
        for channel in (1, 2):
            scope.set_channel(channel, probe=1, scale=0.5)
        yield scope


def test_records_with_any_byte_and_of_line_feeds_only(scope):
    assert scope.identity.model == "TDS 2014"
    scope.set_timebase(5e-4)
    record, flat = scope.acquire(("CH1", "CH2"))
    assert LINE_FEED in record.codes and np.ptp(record.volts) == pytest.approx(1.8, rel=0.05)
    assert set(flat.codes) == {LINE_FEED}


def test_an_instrument_that_another_program_has_put_behind_an_adapter(server):
    """The way of PyVISA-py's own documentation: the adapter first, then GPIB."""
    manager = pyvisa.ResourceManager("@py")
    adapter = manager.open_resource(server.interface_name)
    with TDS2014("GPIB0::7::INSTR", resource_manager=manager) as scope:
        scope.set_channel("CH2", probe=1, scale=0.5)
        assert set(scope.acquire("CH2").codes) == {LINE_FEED}
    adapter.close()
    manager.close()


@pytest.mark.slow
def test_an_acquisition_that_takes_longer_than_the_adapter_listens(monkeypatch):
    monkeypatch.setattr("instrument.pyvisa_sessions.READ_TIME_MS", 200)
    monkeypatch.setattr("instrument.pyvisa_sessions.READ_AGAIN_S", 0.3)
    with GpibAdapterServer(SimulatedTDS2014({1: ramp})) as server, TDS2014(server.resource_name) as scope:
        scope.set_timebase(5e-2)
        scope.set_trigger(source="CH1", level=0.0, mode="NORMAL")
        assert len(scope.acquire("CH1")) == 2500  # half a second before the first byte


def test_another_address_and_no_adapter(impatient):
    with GpibAdapterServer(SimulatedTDS2014()) as server, pytest.raises(LinkError, match="did not answer"):
        TDS2014(server.resource_name.replace("::1::INSTR", "::8::INSTR"))
    with pytest.raises(LinkError, match="cannot open"):
        TDS2014("PRLGX-TCPIP0::127.0.0.1::1::GPIB0::7::INSTR")


@POSIX
def test_a_serial_port_by_its_plain_name():
    with PtyServer(SimulatedTDS2014({1: ramp})) as server, TDS2014(server.device) as scope:
        assert scope.identity.model == "TDS 2014"


def test_what_to_do_about_a_name_that_does_not_open():
    assert USB_RULE in advice(
        "USB0::0x0699::0x0368::C1::INSTR", "[Errno 13] Access denied (insufficient permissions)"
    )
    assert "dialout" in advice("/dev/ttyUSB0", "could not open port: [Errno 13] Permission denied")
    assert "dialout" not in advice("USB0::0x0699::0x0368::C1::INSTR", "Permission denied")
    assert advice("TCPIP0::1.2.3.4::5::SOCKET", "timed out") == ""
    pytest.importorskip("pyvisa_py")
    with pytest.raises(LinkError, match=r"driver.*PRLGX"):
        TDS2014("GPIB0::1::INSTR", resource_manager=pyvisa.ResourceManager("@py"))


def test_a_program_that_reads_to_a_line_feed_gets_a_curve_of_them_piece_by_piece():
    """By the adapter's own orders: what `++read 10` leaves is there for the next read."""
    flat = SimulatedTDS2014({1: lambda times: np.full_like(times, LINE_FEED * 0.02)}, noise_levels=0.0)
    with GpibAdapterServer(flat) as server, socket.create_connection((server.host, server.port), 5.0) as link:
        lines = link.makefile("rwb")

        def send(*orders):
            lines.write(b"".join(order + b"\n" for order in orders))
            lines.flush()

        send(b"++addr 1", b"++auto 0", b"*CLS;HEADER OFF;:CH1:PROBE 1;SCALE 0.5;:DATA:STOP 5")
        send(b"CURVE?", b"++read 10")
        assert lines.read(4) == b"#15\n"
        send(b"++read 10")
        assert lines.read(1) == b"\n"
        send(b"++read eoi")
        assert lines.read(4) == b"\n" * 4  # three points and the end
        send(b"++read eoi", b"*ESR?;:EVENT?", b"++read eoi")  # nothing was asked: query error
        assert lines.readline() == b"4;420\n"
