"""One client of the HiSLIP server: its two channels, the messages that wait, and what it is told.

The server works in synchronised mode: one message is carried out after the other, and a message that comes before
the answer to the last one was read interrupts it (event 410). Source: IVI-6.1, version 1.1, sections 3 and 6.
"""

from __future__ import annotations

import math
import struct
from collections import deque

from instrument.simulated.links.exchange import MessageExchange
from instrument.simulated.links.hislip.frames import Frame, Kind, Mistake, mistake
from instrument.simulated.links.hislip.locks import LockAnswer, Locks
from instrument.simulated.links.stream_server import Port
from instrument.simulated.scope import SimulatedTDS2014

LARGEST_MESSAGE = 1 << 20  # bytes of a payload that the server takes
_SMALLEST_MESSAGE = 64  # bytes, whatever a client says
_HEADER = 16
_DELIVERED = 1  # bit of the control code: the client's program has read the whole last answer
_REMOTE_CODES = range(7)
_INTERRUPTED = 410
# s that a service request is held back, so that a client that polls learns of it by its poll: PyVISA-py takes a
# request that comes by itself for the answer to its next question
_HELD_BACK = 0.05
_TURN = 4  # messages before the next client has its turn
_POLLING = 1.0  # s after a poll, in which a client counts as one that polls
_SIZE = struct.Struct("!Q")


class Session:
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

    def tell(self, frame: Frame, now: float, *, aside: bool = False) -> None:
        """Send a frame on the synchronous channel, or `aside` on the other one."""
        port = self.asynchronous if aside else self.sync
        if port is not None:
            port.outgoing.put(frame.encoded(), now)

    # What comes in on the synchronous channel

    def hear(self, frame: Frame, now: float) -> None:
        """Take a frame of the synchronous channel."""
        match frame.kind:
            case Kind.DEVICE_CLEAR_COMPLETE:
                self._clearing = False
                self.tell(Frame(Kind.DEVICE_CLEAR_ACKNOWLEDGE), now)
            case _ if self._clearing:
                return  # under way when the client cleared
            case Kind.DATA | Kind.DATA_END | Kind.TRIGGER if frame.control & ~_DELIVERED:
                self.tell(mistake(Mistake.UNKNOWN_CONTROL_CODE), now)
            case Kind.DATA:
                self._note(frame, now)
                self._parts += frame.payload
            case Kind.DATA_END | Kind.TRIGGER:
                self._note(frame, now)
                message = b"*TRG" if frame.kind == Kind.TRIGGER else bytes(self._parts) + frame.payload
                self._parts.clear()
                self._waiting.append((frame.parameter, message))
            case _:
                self.tell(mistake(Mistake.UNKNOWN_KIND), now)

    def _note(self, frame: Frame, now: float) -> None:
        """A new message: was the last answer read?"""
        if frame.control & _DELIVERED:
            self.exchange.unread = False
        elif self.exchange.unread:
            self._interrupt(frame.parameter, now)

    def _interrupt(self, by: int, now: float) -> None:
        """An answer is lost because a new message came before it was read."""
        self.exchange.drop_answers(_INTERRUPTED)
        self.tell(Frame(Kind.INTERRUPTED, 0, by), now)
        self.tell(Frame(Kind.ASYNC_INTERRUPTED, 0, by), now, aside=True)

    # What comes in on the asynchronous channel

    def hear_aside(self, frame: Frame, now: float) -> None:
        """Take a frame of the asynchronous channel."""
        match frame.kind:
            case Kind.ASYNC_MAXIMUM_MESSAGE_SIZE if len(frame.payload) == _SIZE.size:
                (size,) = _SIZE.unpack(frame.payload)
                self._largest = max(_SMALLEST_MESSAGE, size - _HEADER)
                answer = Frame(Kind.ASYNC_MAXIMUM_MESSAGE_SIZE_RESPONSE, 0, 0, _SIZE.pack(LARGEST_MESSAGE))
            case Kind.ASYNC_DEVICE_CLEAR:
                self._clear()
                answer = Frame(Kind.ASYNC_DEVICE_CLEAR_ACKNOWLEDGE)
            case Kind.ASYNC_STATUS_QUERY:
                if frame.control & _DELIVERED:
                    self.exchange.unread = False
                self.work(now)  # what came before on the other channel
                self._polled_at, self.request_at = now, math.inf
                answer = Frame(Kind.ASYNC_STATUS_RESPONSE, self.exchange.serial_poll())
            case Kind.ASYNC_LOCK if frame.control in (0, 1):
                self._lock(frame, now)
                return
            case Kind.ASYNC_LOCK_INFO:
                answer = Frame(Kind.ASYNC_LOCK_INFO_RESPONSE, int(self._locks.exclusive), self._locks.holders)
            case Kind.ASYNC_REMOTE_LOCAL_CONTROL if frame.control in _REMOTE_CODES:
                answer = Frame(Kind.ASYNC_REMOTE_LOCAL_RESPONSE)
            case Kind.ASYNC_LOCK | Kind.ASYNC_REMOTE_LOCAL_CONTROL:
                answer = mistake(Mistake.UNKNOWN_CONTROL_CODE)
            case _:
                answer = mistake(Mistake.UNKNOWN_KIND)
        self.tell(answer, now, aside=True)

    def _clear(self) -> None:
        """Device clear: nothing that was under way counts, until the client says that its channel is empty."""
        self._clearing = True
        self._parts.clear()
        self._waiting.clear()
        self.exchange.clear()
        self.exchange.unread = False

    def _lock(self, frame: Frame, now: float) -> None:
        """Ask for a lock (the parameter is a time-out in ms), or give it back when what came before is done."""
        if not frame.control:
            self._releases.append(True)
            return
        answer = self._locks.request(self, frame.payload, now + frame.parameter / 1000)
        if answer is not None:
            self.answer_lock(answer, now)

    def answer_lock(self, answer: LockAnswer, now: float) -> None:
        """Tell what became of a request for a lock."""
        self.tell(Frame(Kind.ASYNC_LOCK_RESPONSE, answer), now, aside=True)

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
            self.tell(Frame(Kind.ASYNC_SERVICE_REQUEST, self.exchange.status_byte()), now, aside=True)

    def _send(self, answer: bytes, now: float) -> None:
        """An answer in pieces that the client takes; one that is late for the next message is not sent."""
        if self._waiting:
            self._interrupt(self._waiting[0][0], now)
            return
        for start in range(0, len(answer), self._largest):
            piece = answer[start : start + self._largest]
            kind = Kind.DATA_END if start + self._largest >= len(answer) else Kind.DATA
            self.tell(Frame(kind, 0, self._at_work, piece), now)
        self.exchange.unread = True
