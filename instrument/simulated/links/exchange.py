"""Program messages in, answers out, one after the other; what RS-232 does to them on their way in.

Two worlds use it. On links with message ends (GPIB, USB, in-process) a new message throws away an answer
that nobody has read (event 410), and reading without a question is an error (420). On streams (RS-232, TCP)
answers leave at once. Source: programmer manual 071-1075-04, pp. 2-8, 3-6 and 3-23.
"""

import math
from collections import deque
from collections.abc import Iterator

from instrument.simulated.faults import Delivery, Faults
from instrument.simulated.panel.panel import Panel
from instrument.simulated.panel.parsing import StreamSplitter
from instrument.simulated.scope import Picture, SimulatedTDS2014

_MOST_WAITING = 1000
_MASTER_SUMMARY = 64
_VIRTUAL_POLL = 0.001  # s of real time between two jumps of a virtual clock
_TERMINATORS = {"LF": b"\n", "CR": b"\r", "CRLF": b"\r\n", "LFCR": b"\n\r"}


class MessageExchange:
    """Input buffer, the message at work, and output queue of one link."""

    def __init__(self, scope: SimulatedTDS2014, *, message_ends: bool, serial: bool = False) -> None:
        self.scope = scope
        self._message_ends, self._serial = message_ends, serial
        self._input = SerialInput(scope.panel, scope.faults) if serial else None
        self._splitter = StreamSplitter()
        self._waiting: deque[bytes] = deque()
        self._running: Iterator[bytes | None] | None = None
        self._answers: deque[Delivery] = deque()
        self._service_reasons = 0  # bits of the status byte that a service was requested for
        self._requested = False  # bit 6 of a serial poll
        self.unread = False  # an answer has left that nobody has read yet, where the link tells
        self.closed = False  # a fault closed the link
        self.output_dropped = False  # a server has to drop what it holds, too

    def receive(self, data: bytes, now: float | None = None) -> None:
        """Take in bytes: a whole message where messages have ends, any piece of one on a stream."""
        # `now` is the time in s for the pauses between pieces on RS-232, if not that of the instrument's clock.
        with self.scope.lock:
            if self.scope.faults.swallows(data):
                return
            if self._input is not None:
                data, event = self._input.receive(data, self.scope.clock.now() if now is None else now)
                if event:
                    self._drop(event)
            self._waiting.extend(self._splitter.feed(data, end=self._message_ends))

    def clear(self) -> None:
        """Device clear (or break): forget input, output and the message at work."""
        with self.scope.lock:
            self._splitter.clear()
            self._waiting.clear()
            self._answers.clear()
            self._running = None
            self.scope.message_available = False

    def _drop(self, event: int) -> None:
        """An input error: everything on its way in or out is lost."""
        self.clear()
        self.output_dropped = True
        self.scope.status.post(event)

    def break_signal(self) -> None:
        """A break on RS-232: all is dropped and the unit answers `DCL`."""
        with self.scope.lock:
            self.clear()
            if self._input is not None:
                self._input.clear()
            self.output_dropped = True
            self._answers.append(Delivery(b"DCL" + self._terminator()))

    @property
    def stopped(self) -> bool:
        """True while an XOFF from the computer holds the answers back."""
        return self._input is not None and self._input.output_stopped

    @property
    def full(self) -> bool:
        """True while so many messages wait for the one at work that no more should be sent."""
        return len(self._waiting) > _MOST_WAITING

    @property
    def working(self) -> bool:
        """True while a message waits or is at work."""
        return self._running is not None or bool(self._waiting)

    @property
    def ready(self) -> bool:
        """True while a message waits and could be carried out now."""
        able = self.scope.powered and not self.scope.faults.hung
        return able and self._running is None and bool(self._waiting)

    def pump(self, most: float = math.inf) -> None:
        """Carry out what has come in, as far as the clock allows: `most` messages, then others have their turn."""
        with self.scope.lock:
            while most > 0 and self.scope.powered and not self.scope.faults.hung and self._advance():
                most -= 1

    def let_time_pass(self, most: float = math.inf) -> None:
        """Carry out what has come in; a virtual clock then jumps to where there is more to do."""
        self.pump(most)
        if self.scope.clock.virtual and self.next_change() < math.inf:
            with self.scope.lock:
                self.scope.clock.sleep(self.next_change() - self.scope.clock.now() + 1e-9)

    def pause(self) -> float:
        """Seconds of real time after which there may be more to do; inf if only new bytes help."""
        change = self.next_change()
        if change == math.inf:
            return change
        return _VIRTUAL_POLL if self.scope.clock.virtual else max(0.0, change - self.scope.clock.now())

    def take(self) -> bytes | None:
        """The oldest answer whose time has come; sets `closed` if the link breaks with it."""
        with self.scope.lock:
            if not self._answers or self.stopped or self._answers[0].due > self.scope.clock.now():
                return None
            delivery = self._answers.popleft()
            self.scope.message_available = bool(self._answers)
            if self.scope.faults.unplugged:
                return None
            if delivery.command:
                self.scope.turn_knob(delivery.command)
            if delivery.closes_link:
                self.clear()
                self.closed = True
            if delivery.power:
                self.scope.power_off()
            if delivery.power == "cycle":
                self.scope.power_on()
            return delivery.data

    def put_back(self, rest: bytes) -> None:
        """Keep the unread rest of an answer."""
        self._answers.appendleft(Delivery(rest))
        self.scope.message_available = True

    @property
    def answering(self) -> bool:
        """True while an answer waits for its time."""
        return bool(self._answers)

    def drop_answers(self, event: int) -> None:
        """Answers are lost, and an event says why."""
        with self.scope.lock:
            self._answers.clear()
            self.unread = self.scope.message_available = False
            self.scope.status.post(event)

    def status_byte(self) -> int:
        """What a serial poll would give; with it the request stays (bit 6)."""
        with self.scope.lock:
            self.scope.settle()
            status = self.scope.status
            available = self.answering or self.unread
            summary = status.status_byte(message_available=available) & ~_MASTER_SUMMARY
            reasons = summary & status.service_mask
            self._requested = bool(reasons) and (self._requested or bool(reasons & ~self._service_reasons))
            self._service_reasons = reasons
            return summary | (_MASTER_SUMMARY if self._requested else 0)

    def requests_service(self) -> bool:
        """True once for each new reason to request service (*SRE)."""
        before = self._requested
        return bool(self.status_byte() & _MASTER_SUMMARY) and not before

    def serial_poll(self) -> int:
        """The status byte; bit 6 tells once that service was requested, and is cleared by the poll."""
        value = self.status_byte()
        self._requested = False
        return value

    def next_change(self) -> float:
        """Clock time in s at which `pump` or `take` may have more to do; inf if only new bytes help."""
        times = [math.inf]
        if self.scope.faults.hung:
            return math.inf
        if self._answers and not self.stopped:
            times.append(self._answers[0].due)
        if self._running is not None:
            times.append(self.scope.acquisition.next_change())
        return min(times)

    def wait_for_answer(self, timeout: float) -> bytes | None:
        """The next answer, or None after `timeout` s on the instrument's clock."""
        # Where messages have ends, asking for an answer to nothing posts event 420.
        clock = self.scope.clock
        deadline = clock.now() + timeout
        blamed = not self._message_ends
        while True:
            self.pump()
            answer = self.take()
            if answer is not None:
                return answer
            if not blamed and not self.working and not self._answers:
                blamed = True
                with self.scope.lock:
                    self.scope.status.post(420)
            now = clock.now()
            if now >= deadline:
                return None
            clock.sleep(min(deadline, self.next_change()) - now + 1e-9)

    def wait_for_service(self, timeout: float) -> bool:
        """Let the instrument work until it requests service; False after `timeout` s on its clock."""
        clock = self.scope.clock
        deadline = clock.now() + timeout
        while True:
            self.pump()
            if self.status_byte() & _MASTER_SUMMARY:
                return True
            now = clock.now()
            if now >= deadline:
                return False
            # an operation that *OPC waits for ends without a message at work
            change = min(self.next_change(), self.scope.acquisition.next_change())
            clock.sleep(min(deadline, change) - now + 1e-9)

    def _advance(self) -> bool:
        """One step of the message at work; False when it has to wait or nothing is left."""
        if self._running is None:
            if not self._waiting:
                return False
            if self._message_ends and self._answers:
                self._answers.clear()
                self.scope.status.post(410)
            self.scope.message_available = bool(self._answers)
            message = self._waiting.popleft()
            self._running = self.scope.execute(message, stream=not self._message_ends)
        for answer in self._running:
            if answer is None:
                return False
            now = self.scope.clock.now()
            whole = answer if isinstance(answer, Picture) else answer + self._terminator()
            self._answers.append(self.scope.faults.deliver(whole, now))
            self.scope.message_available = True
        self._running = None
        return True

    def _terminator(self) -> bytes:
        if not self._serial:
            return b"\n"
        return _TERMINATORS[self.scope.panel.text("RS232:TRANSMIT:TERMINATOR")]


# --------------------
# The RS-232 input of the communications module: flow control, and what happens without it.
#
# With hard flagging the unit holds the computer back by RTS, with soft flagging by XOFF, and nothing is lost. A
# program or a cable that heeds neither sends faster than the processor fetches the bytes: a burst overruns the
# input (event 363), all input and output is dropped, and the unit is deaf for the rest of the burst. Sent one by
# one, 50 ms apart, all bytes arrive. Source: programmer manual 071-1075-04, pp. 2-186 to 2-189 and 3-8


XON, XOFF = 0x11, 0x13
OVERRUN = 363
READ_TIME = 0.02  # s that the processor needs for a byte without flow control (a guess; 50 ms are enough)
HELD_BYTES = 4  # bytes that wait for it (a guess; `*IDN?` in one burst is too long)


class SerialInput:
    """What becomes of bytes on their way from the line into the input buffer."""

    def __init__(self, panel: Panel, faults: Faults) -> None:
        self._panel, self._faults = panel, faults
        self.clear()

    def clear(self) -> None:
        """Forget what is under way."""
        self.output_stopped = False
        self._deaf = False
        self._arrived_at = self._idle_at = 0.0

    def receive(self, data: bytes, now: float) -> tuple[bytes, int]:
        """Pass bytes on."""
        event = self._faults.input_error(data)
        if event:
            return b"", event
        soft = self._panel.flag("RS232:SOFTFLAGGING")
        if not self._faults.no_flow_control and (soft or self._panel.flag("RS232:HARDFLAGGING")):
            return self._without_flow_characters(data) if soft else data, 0
        return self._unprotected(data, now)

    def _without_flow_characters(self, data: bytes) -> bytes:
        """Obey and take out XON and XOFF, also those that were meant as data."""
        for byte in data:
            if byte in (XON, XOFF):
                self.output_stopped = byte == XOFF
        return data.translate(None, bytes((XON, XOFF)))

    def _unprotected(self, data: bytes, now: float) -> tuple[bytes, int]:
        """Bytes that come whether the processor has time or not."""
        received, event = bytearray(), 0
        byte_time = 10 / self._panel.number("RS232:BAUD")
        self._arrived_at = max(self._arrived_at, now)
        for byte in data:
            self._arrived_at += byte_time
            if self._arrived_at >= self._idle_at:
                self._deaf = False
            elif self._deaf or self._idle_at - self._arrived_at > HELD_BYTES * READ_TIME:
                received.clear()
                event = event if self._deaf else OVERRUN
                self._deaf = True
                continue
            self._idle_at = max(self._idle_at, self._arrived_at) + READ_TIME
            received.append(byte)
        return bytes(received), event
