"""A loaded computer or a slow unit: answers that come after the driver has stopped waiting for them."""

import sys

import pytest

from instrument import TDS2014, LinkError, TransferError

on_unix = pytest.mark.skipif(sys.platform == "win32", reason="there are no ptys on Windows")
SERIAL_LINE = {"RS232:TRANSMIT:TERMINATOR": "LF", "RS232:SOFTFLAGGING": "0", "RS232:HARDFLAGGING": "1"}


class Queue:
    """Lets answers go late but in their order, as a computer does that has no time for the scope's thread."""

    def __init__(self) -> None:
        self._waiting: list[bytes] = []
        self._let_go: list[int] = []

    def let_go(self, *counts: int) -> None:
        """How many of the waiting answers go out at each of the next answers; afterwards all."""
        self._let_go += counts

    def __call__(self, line: str, answer: bytes) -> bytes:
        if not answer:
            return b""
        self._waiting.append(answer)
        count = self._let_go.pop(0) if self._let_go else len(self._waiting)
        going, self._waiting = self._waiting[:count], self._waiting[count:]
        return b"".join(going)


@pytest.fixture
def queue(line_scope) -> Queue:
    line_scope.damage = queue = Queue()
    return queue


@on_unix
def test_a_record_that_comes_behind_the_break_on_a_serial_line(peer, line_scope, queue, manager, impatient):
    # The record's bytes are no text, so the driver asks *IDN? a second time, and two identities come.
    line_scope.settings |= SERIAL_LINE
    port = peer(lambda line: line_scope.answer(line.decode()))
    with TDS2014(port.name, resource_manager=manager) as scope:
        first = scope.acquire("CH1")
        queue.let_go(0)
        # Whether the question never came or its answer came late, nobody can tell: the record may be an old one.
        with pytest.raises(TransferError, match="ask again"):
            scope.acquire("CH1")
        assert scope.acquire("CH1") == first
        assert scope.query(":TRIGGER:STATE?") == "SAVE"


@on_unix
def test_a_record_that_another_program_asked_for(peer, line_scope, manager, impatient):
    unread = [b"0;" + line_scope.preamble.encode() + b";#42500" + line_scope.codes + b"\n"]
    line_scope.settings |= SERIAL_LINE
    line_scope.damage = lambda line, answer: (unread.pop() if unread and line else b"") + answer
    port = peer(lambda line: line_scope.answer(line.decode()))
    with TDS2014(port.name, resource_manager=manager) as scope:
        assert scope.query(":TRIGGER:STATE?") == "SAVE"


@pytest.mark.slow
def test_an_identity_that_comes_when_the_next_one_is_asked_for(line_server, queue, manager, impatient):
    with TDS2014(line_server.resource_name, resource_manager=manager) as scope:
        first = scope.acquire("CH1")
        queue.let_go(0, 0)  # the record, an identity
        with pytest.raises(LinkError, match=r"and to \*IDN\? neither"):
            scope.fetch("CH1")
        assert scope.fetch("CH1") == first
        assert scope.query(":TRIGGER:STATE?") == "SAVE"


@pytest.mark.slow
def test_a_marker_that_comes_when_the_next_one_is_asked_for(line_server, queue, manager, impatient):
    with TDS2014(line_server.resource_name, resource_manager=manager) as scope:
        first = scope.acquire("CH1")
        # The record and an identity; then these with a second identity; no marker; the second identity and the
        # marker with a third identity, which goes with the second marker.
        queue.let_go(0, 0, 2, 0, 2)
        with pytest.raises(LinkError, match=r"and to \*IDN\? neither"):
            scope.fetch("CH1")
        with pytest.raises(TransferError, match="though the scope is there; ask again"):
            scope.fetch("CH1")
        assert scope.fetch("CH1") == first
        assert scope.query(":TRIGGER:STATE?") == "SAVE"
