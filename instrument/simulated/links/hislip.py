"""Simulated oscilloscopes as HiSLIP instruments on one TCP port: `TCPIP0::host::hislip0,port::INSTR`."""

from __future__ import annotations

import itertools
import math
import struct
import time
from collections import deque
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import partial

from instrument.simulated.links.exchange import MessageExchange
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
        self._readers: dict[Port, HislipReader] = {}
        self._sessions: dict[Port, HislipClient] = {}  # by either channel
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
        self._readers[port] = HislipReader(LARGEST_MESSAGE)
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

    def _heard_at(self, port: Port) -> float:
        session = self._sessions.get(port)
        channels = (port,) if session is None else (session.sync, session.asynchronous)
        return max(channel.heard_at for channel in channels if channel is not None)

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
                if isinstance(client, HislipClient):
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

    def _hear(self, port: Port, frame: HislipFrame, now: float) -> None:
        """Where a frame belongs."""
        session = self._sessions.get(port)
        if session is None:
            self._open(port, frame, now)
            return
        aside = port is session.asynchronous
        answer = partial(session.tell, now=now, aside=aside)
        if frame.kind in (MessageType.FATAL_ERROR, MessageType.ERROR):
            if frame.kind == MessageType.FATAL_ERROR:
                self._drop(port)
        elif frame.too_large:
            answer(mistake(Mistake.TOO_LARGE))
        elif frame.kind in VENDOR_KINDS:
            answer(mistake(Mistake.UNKNOWN_VENDOR_KIND))
        elif frame.kind in (MessageType.INITIALIZE, MessageType.ASYNC_INITIALIZE):
            self._refuse(port, Fatal.BAD_INITIALIZATION, now)
        elif session.asynchronous is None:
            self._refuse(port, Fatal.CHANNEL_MISSING, now)
        elif aside:
            session.hear_aside(frame, now)
        else:
            session.hear(frame, now)

    def _open(self, port: Port, frame: HislipFrame, now: float) -> None:
        """The first frame of a connection: a new session, or the second channel of one."""
        if frame.kind == MessageType.INITIALIZE:
            self._open_session(port, frame, now)
            return
        waiting = {s.number: s for s in self._sessions.values() if s.asynchronous is None}
        session = waiting.get(frame.parameter)
        if frame.kind != MessageType.ASYNC_INITIALIZE or session is None:
            known = frame.kind in (MessageType.ASYNC_INITIALIZE, MessageType.FATAL_ERROR, MessageType.ERROR)
            self._refuse(port, Fatal.BAD_INITIALIZATION if known else Fatal.CHANNEL_MISSING, now)
            return
        session.asynchronous = port
        self._sessions[port] = session
        session.tell(HislipFrame(MessageType.ASYNC_INITIALIZE_RESPONSE, 0, _VENDOR), now, aside=True)

    def _open_session(self, port: Port, frame: HislipFrame, now: float) -> None:
        name = frame.payload.decode("ascii", errors="replace").lower() or f"{_NAME}0"
        digits = name.removeprefix(_NAME)
        if not (name.startswith(_NAME) and digits.isdigit() and int(digits) < len(self.scopes)):
            self._refuse(port, Fatal.BAD_INITIALIZATION, now)
            return
        full = len(set(self._sessions.values())) >= _CLIENTS and not self._make_room()
        if full or not self.scopes[int(digits)].powered:
            self._refuse(port, Fatal.TOO_MANY_CLIENTS, now)
            return
        taken = {session.number for session in self._sessions.values()}
        number = next(number for number in self._numbers if number not in taken)
        session = HislipClient(number, self.scopes[int(digits)], self._locks[int(digits)], port)
        self._sessions[port] = session
        version = min(_VERSION, frame.parameter >> 16)
        session.tell(HislipFrame(MessageType.INITIALIZE_RESPONSE, 0, version << 16 | number), now)


# --------------------
# One client of the HiSLIP server: its two channels, the messages that wait, and what it is told.
#
# The server works in synchronised mode: one message is carried out after the other, and a message that comes
# before the answer to the last one was read interrupts it (event 410). Source: IVI-6.1, version 1.1, sections 3
# and 6


LARGEST_MESSAGE = 1 << 20  # bytes of a payload that the server takes
_SMALLEST_MESSAGE = 64  # bytes, whatever a client says
_HEADER_BYTES = 16
_DELIVERED = 1  # bit of the control code: the client's program has read the whole last answer
_REMOTE_CODES = range(7)
_INTERRUPTED = 410
# s that a service request is held back, so that a client that polls learns of it by its poll: PyVISA-py takes a
# request that comes by itself for the answer to its next question
_HELD_BACK = 0.05
_TURN = 4  # messages before the next client has its turn
_POLLING = 1.0  # s after a poll, in which a client counts as one that polls
_SIZE = struct.Struct("!Q")


class HislipClient:
    """A client."""

    def __init__(self, number: int, scope: SimulatedTDS2014, locks: Locks, sync: Port) -> None:
        self.number, self.sync = number, sync
        self.asynchronous: Port | None = None
        self.exchange = MessageExchange(scope, message_ends=True)
        self._locks = locks
        self._largest = LARGEST_MESSAGE
        self._parts = bytearray()  # of a message whose end has not come
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._at_work = 0  # identifier of the message that is carried out
        self._clearing = False
        self._releases: deque[bool] = deque()
        self._polled_at = -math.inf
        self.request_at = math.inf

    @property
    def ready(self) -> bool:
        """True while a message waits and could be carried out now."""
        idle = not (self.exchange.working or self.exchange.answering or self.exchange.closed)
        return idle and bool(self._waiting) and self._locks.may_talk(self)

    def tell(self, frame: HislipFrame, now: float, *, aside: bool = False) -> None:
        """Send a frame on the synchronous channel, or `aside` on the other one."""
        port = self.asynchronous if aside else self.sync
        if port is not None:
            port.outgoing.put(frame.encoded(), now)

    # What comes in on the synchronous channel

    def hear(self, frame: HislipFrame, now: float) -> None:
        """Take a frame of the synchronous channel."""
        match frame.kind:
            case MessageType.DEVICE_CLEAR_COMPLETE:
                self._clearing = False
                self.tell(HislipFrame(MessageType.DEVICE_CLEAR_ACKNOWLEDGE), now)
            case _ if self._clearing:
                return  # under way when the client cleared
            case MessageType.DATA | MessageType.DATA_END | MessageType.TRIGGER if frame.control & ~_DELIVERED:
                self.tell(mistake(Mistake.UNKNOWN_CONTROL_CODE), now)
            case MessageType.DATA:
                self._note(frame, now)
                self._parts += frame.payload
            case MessageType.DATA_END | MessageType.TRIGGER:
                self._note(frame, now)
                message = b"*TRG" if frame.kind == MessageType.TRIGGER else bytes(self._parts) + frame.payload
                self._parts.clear()
                self._waiting.append((frame.parameter, message))
            case _:
                self.tell(mistake(Mistake.UNKNOWN_KIND), now)

    def _note(self, frame: HislipFrame, now: float) -> None:
        """A new message: was the last answer read?"""
        if frame.control & _DELIVERED:
            self.exchange.unread = False
        elif self.exchange.unread:
            self._interrupt(frame.parameter, now)

    def _interrupt(self, by: int, now: float) -> None:
        """An answer is lost because a new message came before it was read."""
        self.exchange.drop_answers(_INTERRUPTED)
        self.tell(HislipFrame(MessageType.INTERRUPTED, 0, by), now)
        self.tell(HislipFrame(MessageType.ASYNC_INTERRUPTED, 0, by), now, aside=True)

    # What comes in on the asynchronous channel

    def hear_aside(self, frame: HislipFrame, now: float) -> None:
        """Take a frame of the asynchronous channel."""
        match frame.kind:
            case MessageType.ASYNC_MAXIMUM_MESSAGE_SIZE if len(frame.payload) == _SIZE.size:
                (size,) = _SIZE.unpack(frame.payload)
                self._largest = max(_SMALLEST_MESSAGE, size - _HEADER_BYTES)
                answer = HislipFrame(
                    MessageType.ASYNC_MAXIMUM_MESSAGE_SIZE_RESPONSE, 0, 0, _SIZE.pack(LARGEST_MESSAGE)
                )
            case MessageType.ASYNC_DEVICE_CLEAR:
                self._clearing = True
                self._parts.clear()
                self._waiting.clear()
                self.exchange.clear()
                self.exchange.unread = False
                answer = HislipFrame(MessageType.ASYNC_DEVICE_CLEAR_ACKNOWLEDGE)
            case MessageType.ASYNC_STATUS_QUERY:
                if frame.control & _DELIVERED:
                    self.exchange.unread = False
                self.work(now)  # what came before on the other channel
                self._polled_at, self.request_at = now, math.inf
                answer = HislipFrame(MessageType.ASYNC_STATUS_RESPONSE, self.exchange.serial_poll())
            case MessageType.ASYNC_LOCK if frame.control in (0, 1):
                self._lock(frame, now)
                return
            case MessageType.ASYNC_LOCK_INFO:
                answer = HislipFrame(
                    MessageType.ASYNC_LOCK_INFO_RESPONSE, int(self._locks.exclusive), self._locks.holders
                )
            case MessageType.ASYNC_REMOTE_LOCAL_CONTROL if frame.control in _REMOTE_CODES:
                answer = HislipFrame(MessageType.ASYNC_REMOTE_LOCAL_RESPONSE)
            case MessageType.ASYNC_LOCK | MessageType.ASYNC_REMOTE_LOCAL_CONTROL:
                answer = mistake(Mistake.UNKNOWN_CONTROL_CODE)
            case _:
                answer = mistake(Mistake.UNKNOWN_KIND)
        self.tell(answer, now, aside=True)

    def _lock(self, frame: HislipFrame, now: float) -> None:
        """Ask for a lock (the parameter is a time-out in ms), or give it back when what came before is done."""
        if not frame.control:
            self._releases.append(True)
            return
        answer = self._locks.request(self, frame.payload, now + frame.parameter / 1000)
        if answer is not None:
            self.answer_lock(answer, now)

    def answer_lock(self, answer: LockAnswer, now: float) -> None:
        """Tell what became of a request for a lock."""
        self.tell(HislipFrame(MessageType.ASYNC_LOCK_RESPONSE, answer), now, aside=True)

    # What the instrument does

    def work(self, now: float) -> None:
        """Carry out messages and send answers, as far as clock and locks allow."""
        for _ in range(_TURN):
            self.exchange.pump()
            answers = []
            while (answer := self.exchange.take()) is not None:
                answers.append(answer)
            if answers:
                self._send(b"".join(answers), now)
            if self.exchange.working or self.exchange.answering or self.exchange.closed:
                break
            if not self.ready:
                break
            self._at_work, message = self._waiting.popleft()
            self.exchange.receive(message)
        if self._releases and not self._waiting and not self.exchange.working:
            self._releases.popleft()
            self.answer_lock(self._locks.release(self), now)
        if self.exchange.requests_service():
            self.request_at = max(now + _HELD_BACK, self._polled_at + _POLLING)
        if now >= self.request_at:
            self.request_at = math.inf
            self.tell(HislipFrame(MessageType.ASYNC_SERVICE_REQUEST, self.exchange.status_byte()), now, aside=True)

    def _send(self, answer: bytes, now: float) -> None:
        """An answer in pieces that the client takes; one that is late for the next message is not sent."""
        if self._waiting:
            self._interrupt(self._waiting[0][0], now)
            return
        for start in range(0, len(answer), self._largest):
            piece = answer[start : start + self._largest]
            kind = MessageType.DATA_END if start + self._largest >= len(answer) else MessageType.DATA
            self.tell(HislipFrame(kind, 0, self._at_work, piece), now)
        self.exchange.unread = True


# --------------------
# The frames of HiSLIP: a header of 16 bytes (prologue, type, control code, parameter, length) and a payload.
#
# Source: IVI-6.1, High-Speed LAN Instrument Protocol, version 1.1, tables 2 to 4 and 12 to 14


_PROLOGUE = b"HS"
_HEADER = struct.Struct("!2sBBIQ")


class MessageType(IntEnum):
    """Type of a frame."""

    INITIALIZE = 0
    INITIALIZE_RESPONSE = 1
    FATAL_ERROR = 2
    ERROR = 3
    ASYNC_LOCK = 4
    ASYNC_LOCK_RESPONSE = 5
    DATA = 6
    DATA_END = 7
    DEVICE_CLEAR_COMPLETE = 8
    DEVICE_CLEAR_ACKNOWLEDGE = 9
    ASYNC_REMOTE_LOCAL_CONTROL = 10
    ASYNC_REMOTE_LOCAL_RESPONSE = 11
    TRIGGER = 12
    INTERRUPTED = 13
    ASYNC_INTERRUPTED = 14
    ASYNC_MAXIMUM_MESSAGE_SIZE = 15
    ASYNC_MAXIMUM_MESSAGE_SIZE_RESPONSE = 16
    ASYNC_INITIALIZE = 17
    ASYNC_INITIALIZE_RESPONSE = 18
    ASYNC_DEVICE_CLEAR = 19
    ASYNC_SERVICE_REQUEST = 20
    ASYNC_STATUS_QUERY = 21
    ASYNC_STATUS_RESPONSE = 22
    ASYNC_DEVICE_CLEAR_ACKNOWLEDGE = 23
    ASYNC_LOCK_INFO = 24
    ASYNC_LOCK_INFO_RESPONSE = 25


VENDOR_KINDS = range(128, 256)


class Fatal(IntEnum):
    """Why a connection cannot go on."""

    POOR_HEADER = 1
    CHANNEL_MISSING = 2
    BAD_INITIALIZATION = 3
    TOO_MANY_CLIENTS = 4


class Mistake(IntEnum):
    """Why one frame is not carried out."""

    UNKNOWN_KIND = 1
    UNKNOWN_CONTROL_CODE = 2
    UNKNOWN_VENDOR_KIND = 3
    TOO_LARGE = 4


_WORDS = {  # by name: the numbers of both are the same
    "POOR_HEADER": b"Poorly formed message header",
    "CHANNEL_MISSING": b"Attempt to use connection without both channels established",
    "BAD_INITIALIZATION": b"Invalid initialization sequence",
    "TOO_MANY_CLIENTS": b"Server refused connection due to maximum number of clients exceeded",
    "UNKNOWN_KIND": b"Unrecognized message type",
    "UNKNOWN_CONTROL_CODE": b"Unrecognized control code",
    "UNKNOWN_VENDOR_KIND": b"Unrecognized vendor defined message",
    "TOO_LARGE": b"Message too large",
}


class PoorHeader(Exception):
    """What came is no HiSLIP; the stream cannot be understood from here on."""


@dataclass(frozen=True)
class HislipFrame:
    """One frame."""

    kind: int  # A `MessageType`, or a number that none of them has
    control: int = 0  # their meaning depends on the kind
    parameter: int = 0
    payload: bytes = b""
    too_large: bool = False  # it announced a longer payload than is taken; that was thrown away

    def encoded(self) -> bytes:
        """The bytes that travel."""
        header = _HEADER.pack(_PROLOGUE, self.kind, self.control, self.parameter, len(self.payload))
        return header + self.payload


def fatal(reason: Fatal) -> HislipFrame:
    """The last frame of a connection."""
    return HislipFrame(MessageType.FATAL_ERROR, reason, 0, _WORDS[reason.name])


def mistake(reason: Mistake) -> HislipFrame:
    """The answer to a frame that is not carried out."""
    return HislipFrame(MessageType.ERROR, reason, 0, _WORDS[reason.name])


class HislipReader:
    """Cuts a stream of bytes into frames; `largest` is the longest payload that it collects."""

    def __init__(self, largest: int) -> None:
        self._largest = largest
        self._buffer = bytearray()
        self._skipping = 0

    def feed(self, data: bytes) -> Iterator[HislipFrame]:
        """Take in bytes and give the frames that they complete; PoorHeader where there is no header."""
        self._buffer += data
        while True:
            if self._skipping:
                skipped = min(self._skipping, len(self._buffer))
                del self._buffer[:skipped]
                self._skipping -= skipped
            if self._buffer and not _PROLOGUE.startswith(bytes(self._buffer[:2])):
                raise PoorHeader
            if self._skipping or len(self._buffer) < _HEADER.size:
                return
            _, kind, control, parameter, length = _HEADER.unpack_from(self._buffer)
            if length > self._largest:
                del self._buffer[: _HEADER.size]
                self._skipping = length
                yield HislipFrame(kind, control, parameter, too_large=True)
                continue
            if len(self._buffer) < _HEADER.size + length:
                return
            payload = bytes(self._buffer[_HEADER.size : _HEADER.size + length])
            del self._buffer[: _HEADER.size + length]
            yield HislipFrame(kind, control, parameter, payload)


# --------------------
# Who may talk to the instrument: an exclusive lock, and a shared one that all have who know its string.
#
# Source: IVI-6.1, version 1.1, section 6.5


class LockAnswer(IntEnum):
    """Control code of the answer to a request or a release."""

    FAILURE = 0
    EXCLUSIVE = 1  # granted (of either kind), or the exclusive one released
    SHARED = 2  # the shared one released
    ERROR = 3


@dataclass
class _Request:
    client: Hashable
    key: bytes
    deadline: float


class Locks:
    """The locks of one instrument. Clients are anything hashable; the empty key asks for the exclusive lock."""

    def __init__(self) -> None:
        self._exclusive: Hashable | None = None
        self._shared: set[Hashable] = set()
        self._key = b""
        self._waiting: list[_Request] = []

    @property
    def exclusive(self) -> bool:
        """Whether somebody has the exclusive lock."""
        return self._exclusive is not None

    @property
    def holders(self) -> int:
        """Number of clients that hold a lock."""
        return len(self._shared | ({self._exclusive} if self.exclusive else set()))

    def may_talk(self, client: Hashable) -> bool:
        """Whether messages of a client are carried out now."""
        if self._exclusive is not None:
            return self._exclusive == client
        return not self._shared or client in self._shared

    def request(self, client: Hashable, key: bytes, deadline: float) -> LockAnswer | None:
        """Ask for a lock; None while it has to be waited for, until the deadline (s) at most."""
        if client == self._exclusive or (key and client in self._shared):
            return LockAnswer.ERROR
        if self._grant(client, key):
            return LockAnswer.EXCLUSIVE
        self._waiting.append(_Request(client, key, deadline))
        return None

    def release(self, client: Hashable) -> LockAnswer:
        """Give a lock back, the exclusive one first."""
        if self._exclusive == client:
            self._exclusive = None
            return LockAnswer.EXCLUSIVE
        if client in self._shared:
            self._shared.discard(client)
            return LockAnswer.SHARED
        return LockAnswer.ERROR

    def forget(self, client: Hashable) -> None:
        """A client is gone, and all of its locks and requests."""
        self._waiting = [request for request in self._waiting if request.client != client]
        self._shared.discard(client)
        if self._exclusive == client:
            self._exclusive = None

    def settle(self, now: float) -> list[tuple[Hashable, LockAnswer]]:
        """Grant what can be granted now (s), in the order of the requests, and refuse what is too late."""
        answers, still = [], []
        for request in self._waiting:
            if self._grant(request.client, request.key):
                answers.append((request.client, LockAnswer.EXCLUSIVE))
            elif now >= request.deadline:
                answers.append((request.client, LockAnswer.FAILURE))
            else:
                still.append(request)
        self._waiting = still
        return answers

    def next_deadline(self) -> float:
        """Time (s) at which the first request is too late; inf without one."""
        return min((request.deadline for request in self._waiting), default=float("inf"))

    def _grant(self, client: Hashable, key: bytes) -> bool:
        if self._exclusive is not None:
            return False
        if not key:
            if self._shared and client not in self._shared:
                return False
            self._exclusive = client
            return True
        if self._shared and key != self._key:
            return False
        self._key = key
        self._shared.add(client)
        return True
