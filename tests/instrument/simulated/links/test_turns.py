"""Several clients at once: one that asks for a lot does not keep the others waiting."""

import contextlib
import socket
import threading

import numpy as np
import pytest

from instrument.simulated import SimulatedTDS2014, TcpServer
from instrument.simulated.links.exchange import MessageExchange


def test_a_burst_of_one_client_does_not_hold_up_the_other():
    carried_out, both_have_asked = [], threading.Event()
    scope = SimulatedTDS2014({1: lambda t: np.sin(6283.0 * t)})
    execute = scope.execute

    def noted(message, *, stream=False):
        if message == b"CURVE?":
            both_have_asked.wait(30)
        carried_out.append(message)
        return execute(message, stream=stream)

    scope.execute = noted
    with TcpServer(scope) as server, contextlib.ExitStack() as opened:
        at = server.host, server.port
        greedy, modest = (opened.enter_context(socket.create_connection(at, timeout=30)) for _ in range(2))
        modest.sendall(b"*OPC?\n")
        assert modest.recv(10) == b"1\n"
        greedy.sendall(b"CURVE?\n" * 200)
        modest.sendall(b"*IDN?\n")
        both_have_asked.set()
        assert modest.recv(100).startswith(b"TEKTRONIX")
    assert carried_out.index(b"*IDN?") < 40  # not behind all of them


@pytest.mark.parametrize("most", [1, 3])
def test_a_turn_carries_out_so_many_messages(most):
    link = MessageExchange(SimulatedTDS2014(), message_ends=False)
    link.receive(b"CH1:SCALE 2\n" * 5)
    link.pump(most)
    assert link.ready
    left = 5 - most
    for _ in range(left):
        assert link.ready
        link.pump(1)
    assert not link.working
