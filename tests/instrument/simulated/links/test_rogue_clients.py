"""What a client can do to a simulated instrument that is served: nothing but get an error itself."""

import os
import resource
import socket
import time
from contextlib import suppress

import pytest

from instrument.simulated import SimulatedTDS2014, TcpServer

pytestmark = pytest.mark.skipif(os.name != "posix", reason="limits of descriptors are those of POSIX")


def connected(server: TcpServer) -> socket.socket:
    return socket.create_connection((server.host, server.port), timeout=10)


def asked(client: socket.socket, question: bytes) -> bytes:
    client.sendall(question + b"\n")
    answer = b""
    while not answer.endswith(b"\n"):
        piece = client.recv(4096)
        if not piece:
            raise ConnectionError("the server has hung up")
        answer += piece
    return answer


def test_only_so_many_clients_are_taken_and_the_others_are_hung_up_on() -> None:
    with TcpServer(SimulatedTDS2014()) as server:
        clients = [connected(server) for _ in range(16)]
        assert all(asked(client, b"*IDN?").startswith(b"TEKTRONIX") for client in clients)
        late = connected(server)
        assert late.recv(4096).endswith(b"connections are open: close one\n")
        assert late.recv(1) == b""
        late.close()
        clients.pop().close()
        again = connected(server)
        while True:  # until the server has seen that one has gone
            with suppress(ConnectionError):
                if asked(again, b"*IDN?").startswith(b"TEKTRONIX"):
                    break
            again.close()
            again = connected(server)
        for client in [*clients, again]:
            client.close()


def test_without_a_free_descriptor_the_server_neither_spins_nor_ends() -> None:
    with TcpServer(SimulatedTDS2014()) as server:
        first = connected(server)
        assert asked(first, b"*IDN?").startswith(b"TEKTRONIX")
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        lowest = os.dup(first.fileno())  # the next descriptor that would be given
        os.close(lowest)
        waiting = socket.socket()
        resource.setrlimit(resource.RLIMIT_NOFILE, (lowest + 1, hard))
        try:
            waiting.connect((server.host, server.port))
            before, began = time.process_time(), time.monotonic()
            time.sleep(1.5)
            share = (time.process_time() - before) / (time.monotonic() - began)
            assert asked(first, b"*IDN?").startswith(b"TEKTRONIX")
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        waiting.settimeout(10)
        assert asked(waiting, b"*IDN?").startswith(b"TEKTRONIX")
        assert share < 0.5  # of one core; it was all of it
        first.close()
        waiting.close()


def test_a_client_that_asks_without_reading_is_not_listened_to() -> None:
    with TcpServer(SimulatedTDS2014()) as server:
        greedy = connected(server)
        greedy.setblocking(False)
        sent, idle = 0, 0
        while idle < 40 and sent < 200e6:
            try:
                sent += greedy.send(b"CURVE?\n" * 10_000)
                idle = 0
            except BlockingIOError:
                idle += 1
                time.sleep(0.05)
        assert sent < 50e6  # what the system's buffers and ours hold
        held = sum(len(port.incoming) + len(port.outgoing) for port in server._ports)
        assert held < 10e6
        other = connected(server)
        assert asked(other, b"*IDN?").startswith(b"TEKTRONIX")
        other.close()
        greedy.close()
