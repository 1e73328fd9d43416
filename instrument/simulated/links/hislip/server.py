"""Simulated oscilloscopes as HiSLIP instruments on one TCP port: `TCPIP0::host::hislip0,port::INSTR`."""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from functools import partial

from instrument.simulated.links.hislip.frames import (
    VENDOR_KINDS,
    Fatal,
    Frame,
    FrameReader,
    Kind,
    Mistake,
    PoorHeader,
    fatal,
    mistake,
)
from instrument.simulated.links.hislip.locks import Locks
from instrument.simulated.links.hislip.session import LARGEST_MESSAGE, Session
from instrument.simulated.links.stream_server import FULL, LOOK_UP, Port, StreamServer
from instrument.simulated.scope import SimulatedTDS2014

STANDARD_PORT = 4880
_VERSION = 0x0100  # 1.0: everything that this server does is in it
_VENDOR = int.from_bytes(b"GY")
_NAME = "hislip"
_UNSENT = 0.001  # s after which a client that has not taken everything is sent more
_CLIENTS = 16  # sessions, of two connections each


class HislipServer(StreamServer):
    """Serves instruments by HiSLIP until it is closed.

    Several clients may be connected; each has its own answers and its own device clear, all see the same
    instrument, and locks are between them.

    Parameters
    ----------
    scopes : SimulatedTDS2014 or sequence of them
        The instruments: `hislip0`, `hislip1` and so on.
    host, port
        As of `TcpServer`, and the same error; VISA's own port is 4880.

    Examples
    --------
    >>> with HislipServer(SimulatedTDS2014()) as server:
    ...     server.resource_name.startswith("TCPIP0::127.0.0.1::hislip0,")
    True
    """

    def __init__(
        self, scopes: SimulatedTDS2014 | Sequence[SimulatedTDS2014], host: str = "127.0.0.1", port: int = 0
    ) -> None:
        super().__init__()
        self.clients = 2 * _CLIENTS + 1  # one more, to be told that it is too many
        self.scopes = (scopes,) if isinstance(scopes, SimulatedTDS2014) else tuple(scopes)
        self._locks = [Locks() for _ in self.scopes]
        self._readers: dict[Port, FrameReader] = {}
        self._sessions: dict[Port, Session] = {}  # by either channel
        self._numbers = itertools.cycle(range(1, 1 << 16))
        self._leaving: set[Port] = set()  # hung up on as soon as the last frame is out
        self.host, self.port = self._listen(host, port)
        self._thread.start()

    @property
    def resource_name(self) -> str:
        """VISA resource name of the first instrument for clients on this computer."""
        return self.resource_names[0]

    @property
    def resource_names(self) -> tuple[str, ...]:
        """Of all of them."""
        port = "" if self.port == STANDARD_PORT else f",{self.port}"
        return tuple(f"TCPIP0::{self.host}::{_NAME}{n}{port}::INSTR" for n in range(len(self.scopes)))

    # Connections

    def _add(self, port: Port) -> None:
        self._readers[port] = FrameReader(LARGEST_MESSAGE)
        super()._add(port)

    def _drop(self, port: Port) -> None:
        """One channel is gone: the other one, its locks and its messages go with it."""
        self._readers.pop(port, None)
        self._leaving.discard(port)
        session = self._sessions.pop(port, None)
        super()._drop(port)
        if session is None:
            return
        session.exchange.clear()
        for locks in self._locks:
            locks.forget(session)
        for other in (session.sync, session.asynchronous):
            if other is not None and other is not port:
                self._drop(other)

    def _refuse(self, port: Port, reason: Fatal, now: float) -> None:
        port.outgoing.put(fatal(reason).encoded(), now)
        self._leaving.add(port)

    # The loop

    def _pause(self) -> float:
        pauses = [LOOK_UP]
        for port in self._ports:
            if len(port.outgoing):
                pauses.append(_UNSENT)
        for session in set(self._sessions.values()):
            able = session.ready or session.exchange.ready
            pauses.append(0.0 if able else session.request_at - time.monotonic())
            pauses.append(session.exchange.pause())
        return max(0.0, min(*pauses, *(locks.next_deadline() - time.monotonic() for locks in self._locks)))

    def _advance(self) -> None:
        super()._advance()
        now = time.monotonic()
        for locks in self._locks:
            for client, answer in locks.settle(now):
                if isinstance(client, Session):
                    client.answer_lock(answer, now)
        for session in list(dict.fromkeys(self._sessions.values())):
            if not session.exchange.scope.powered:
                self._drop(session.sync)
                continue
            session.exchange.let_time_pass()
            session.work(now)
            if session.exchange.closed:
                self._leaving.add(session.sync)
        for port in list(self._ports):
            self._send(port, now)
            if port in self._leaving and not len(port.outgoing):
                self._drop(port)

    def _serve(self, port: Port) -> None:
        now = time.monotonic()
        if port in self._leaving or len(port.outgoing) >= FULL:
            return
        try:
            for frame in self._readers[port].feed(port.incoming.take(now)):
                self._hear(port, frame, now)
                if port in self._leaving or port not in self._readers:
                    return
        except PoorHeader:
            self._refuse(port, Fatal.POOR_HEADER, now)

    def _hear(self, port: Port, frame: Frame, now: float) -> None:
        """Where a frame belongs."""
        session = self._sessions.get(port)
        if session is None:
            self._open(port, frame, now)
            return
        aside = port is session.asynchronous
        answer = partial(session.tell, now=now, aside=aside)
        if frame.kind in (Kind.FATAL_ERROR, Kind.ERROR):
            if frame.kind == Kind.FATAL_ERROR:
                self._drop(port)
        elif frame.too_large:
            answer(mistake(Mistake.TOO_LARGE))
        elif frame.kind in VENDOR_KINDS:
            answer(mistake(Mistake.UNKNOWN_VENDOR_KIND))
        elif frame.kind in (Kind.INITIALIZE, Kind.ASYNC_INITIALIZE):
            self._refuse(port, Fatal.BAD_INITIALIZATION, now)
        elif session.asynchronous is None:
            self._refuse(port, Fatal.CHANNEL_MISSING, now)
        elif aside:
            session.hear_aside(frame, now)
        else:
            session.hear(frame, now)

    def _open(self, port: Port, frame: Frame, now: float) -> None:
        """The first frame of a connection: a new session, or the second channel of one."""
        if frame.kind == Kind.INITIALIZE:
            self._open_session(port, frame, now)
            return
        waiting = {s.number: s for s in self._sessions.values() if s.asynchronous is None}
        session = waiting.get(frame.parameter)
        if frame.kind != Kind.ASYNC_INITIALIZE or session is None:
            known = frame.kind in (Kind.ASYNC_INITIALIZE, Kind.FATAL_ERROR, Kind.ERROR)
            self._refuse(port, Fatal.BAD_INITIALIZATION if known else Fatal.CHANNEL_MISSING, now)
            return
        session.asynchronous = port
        self._sessions[port] = session
        session.tell(Frame(Kind.ASYNC_INITIALIZE_RESPONSE, 0, _VENDOR), now, aside=True)

    def _open_session(self, port: Port, frame: Frame, now: float) -> None:
        name = frame.payload.decode("ascii", errors="replace").lower() or f"{_NAME}0"
        digits = name.removeprefix(_NAME)
        if not (name.startswith(_NAME) and digits.isdigit() and int(digits) < len(self.scopes)):
            self._refuse(port, Fatal.BAD_INITIALIZATION, now)
            return
        if len(set(self._sessions.values())) >= _CLIENTS or not self.scopes[int(digits)].powered:
            self._refuse(port, Fatal.TOO_MANY_CLIENTS, now)
            return
        taken = {session.number for session in self._sessions.values()}
        number = next(number for number in self._numbers if number not in taken)
        session = Session(number, self.scopes[int(digits)], self._locks[int(digits)], port)
        self._sessions[port] = session
        version = min(_VERSION, frame.parameter >> 16)
        session.tell(Frame(Kind.INITIALIZE_RESPONSE, 0, version << 16 | number), now)
