"""Doors of the simulated scope: endless messages are not kept, forgotten clients give way, a refusal is said."""

import socket
import struct
import time
from contextlib import ExitStack

import pytest
from pyvisa_py.protocols.hislip import Instrument

from instrument.simulated import SimulatedTDS2014
from instrument.simulated.links.hislip import HislipServer
from instrument.simulated.links.scope_servers import GpibAdapterServer, TcpServer


def asked(link: socket.socket, question: bytes = b"*IDN?\n") -> bytes:
    link.sendall(question)
    return link.recv(4096)


@pytest.mark.slow
def test_a_line_without_an_end_is_not_kept_by_the_adapter() -> None:
    with (
        GpibAdapterServer(SimulatedTDS2014()) as server,
        socket.create_connection((server.host, server.port), 30.0) as link,
    ):
        link.sendall(b"++ver\n")
        assert b"version" in link.recv(4096)
        resource = pytest.importorskip("resource")
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        piece = bytes(range(64, 91)) * 4000
        for _ in range(120):  # 13 MB
            link.sendall(piece)
        link.sendall(b"\n++ver\n")
        assert b"version" in link.recv(4096)
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 8_000  # kB
        link.sendall(b"*IDN?\n++read eoi\n")
        assert link.recv(4096).startswith(b"TEKTRONIX")


def test_a_refusal_is_said_and_a_forgotten_connection_gives_way() -> None:
    with TcpServer(SimulatedTDS2014()) as server, ExitStack() as held:
        clients = [
            held.enter_context(socket.create_connection((server.host, server.port), 10.0))
            for _ in range(server.clients)
        ]
        for client in clients:
            assert asked(client).startswith(b"TEKTRONIX")
        with socket.create_connection((server.host, server.port), 10.0) as refused:
            assert refused.recv(4096) == b"16 connections are open: close one\n"
            assert refused.recv(4096) == b""
        server.idle_s = 0.3
        time.sleep(0.4)
        for client in clients[1:]:  # all but the first are in use
            assert asked(client).startswith(b"TEKTRONIX")
        with socket.create_connection((server.host, server.port), 10.0) as new:
            assert asked(new).startswith(b"TEKTRONIX")
            assert clients[0].recv(4096) == b""  # hung up on
        assert asked(clients[1]).startswith(b"TEKTRONIX")


def test_sessions_of_hislip_give_way_too() -> None:
    def session(server: HislipServer) -> Instrument:
        return Instrument("127.0.0.1", port=server.port, timeout=10.0)

    def asked_there(client: Instrument) -> bytes:
        client.send(b"*IDN?")
        return bytes(client.receive())

    with HislipServer(SimulatedTDS2014()) as server, ExitStack() as held:
        sessions = [session(server) for _ in range(16)]
        for one in sessions:
            held.callback(one.close)
            assert asked_there(one).startswith(b"TEKTRONIX")
        with socket.create_connection(("127.0.0.1", server.port), 10.0) as refused:
            refused.sendall(struct.pack("!2sBBIQ", b"HS", 0, 0, 0x01005A5A, 7) + b"hislip0")
            told = refused.recv(4096)
            assert told[:4] == b"HS\x02\x04"  # fatal error: too many clients
            assert b"maximum number of clients" in told
        server.idle_s = 0.3
        time.sleep(0.4)
        for one in sessions[1:]:  # all but the first are in use
            assert asked_there(one).startswith(b"TEKTRONIX")
        new = session(server)
        held.callback(new.close)
        assert asked_there(new).startswith(b"TEKTRONIX")
        assert asked_there(sessions[1]).startswith(b"TEKTRONIX")
