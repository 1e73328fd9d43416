"""Bytes to and from an instrument through PyVISA, on links with and without an end of message.

GPIB, USB and VXI-11 are *framed*: a message has an end of its own, so an answer may hold any byte. RS-232
and a bare TCP socket are *streams*: only a line feed or a known length tells where an answer ends. There text
is read to its line feed and binary data by exact count.

Every time limit here is made of named ingredients: the time that the instrument takes to begin an answer, the
longest pause inside one, the bytes at the baud rate, and the time that an acquisition takes (the caller's). Each
answer has a limit as a whole too, so that one that trickles in byte by byte ends like one that stops. A limit has
passed only when a look behind it found nothing: a program that was not given the processor misses no answer.
"""

import contextlib
import math
import select
import socket
import time
from collections.abc import Iterator
from typing import Any, Self

import pyvisa
from pyvisa import constants
from pyvisa.constants import InterfaceType, StatusCode
from pyvisa.resources import SerialInstrument

from instrument import scpi
from instrument.dialogue.retry import ANSWER_TIME, ComputerClock, RetryClock
from instrument.errors import LinkError, TransferError
from instrument.pyvisa_sessions import (
    READ_AGAIN_S,
    adapter_of,
    claim_instrument,
    keep_to_oneself,
    open_instrument,
    session_of,
    socket_of,
)
from instrument.text_files import note

PAUSE_TIME = 0.5  # longest silence in s inside an answer that has begun
LINE_MARGIN = 1.5  # real time over ideal time of a serial line, for flow control and the other side's scheduling
SLICE_TIME = 0.1  # step in s in which a stream is watched for the other side hanging up

DEFAULT_BAUD_RATE = 9600
"""The scope's factory setting (user manual 071-1064-00, p. 136)."""

BITS_PER_BYTE = 10  # one start bit, eight data bits, one stop bit

GPIB_BYTES_PER_SECOND = 20_000.0
"""A tenth of the rate named in 071-1064-00, appendix E: the slowest that a framed link should ever be."""

LONGEST_PICTURE = 1_000_000  # bytes; a colour picture of 640 x 480 pixels fits
_ADAPTER_BITS_PER_SECOND = 115_200  # of the slowest stream between computer and GPIB adapter
_TEXT_BESIDE_BLOCKS = 1024  # bytes; four preambles and a margin
_BITMAP_LENGTH_END = 6  # "BM" and four bytes with the length of the file


class NoAnswer(LinkError):
    """Nothing, or nothing more, came in time. The caller finds out whether the instrument is still there."""


class Link:
    """One open link to an instrument; a context manager."""

    def __init__(
        self,
        resource_name: str,
        resource_manager: pyvisa.ResourceManager | None = None,
        baud_rate: int | None = None,
        clock: RetryClock | None = None,
    ) -> None:
        self.name = resource_name
        self.clock: RetryClock = clock or ComputerClock()
        self.closed = False
        self.answer_time = ANSWER_TIME
        """Longest time in s until an answer begins; to be set for an unusually slow unit, or a known quick one."""
        self.pause_time = PAUSE_TIME
        """Longest silence in s inside an answer that has begun."""
        self.began_after = 0.0
        """Time in s until the last answer on a stream began, beyond what its question was known to take."""
        self._timeout: float | None = None
        self._socket: DeadlineSocket | None = None
        self._line: SerialLine | None = None
        self._manager = resource_manager
        self._claim = claim_instrument(resource_name, resource_manager)
        try:
            self._resource, self._beneath = open_instrument(resource_name, resource_manager, ANSWER_TIME)
        except BaseException:  # Ctrl-C while it is opened, too
            self._claim.release()
            raise
        self._adapter = adapter_of(self._resource)
        interface = self._resource.interface_type
        self.is_serial = interface == InterfaceType.asrl
        stream = self.is_serial or resource_name.upper().rstrip().endswith("SOCKET")
        self.framed = not stream and self._adapter is None
        self.baud_rate = baud_rate or (DEFAULT_BAUD_RATE if self._adapter is None else _ADAPTER_BITS_PER_SECOND)
        self.on_bus = self.framed or self._adapter is not None
        """Whether the instrument itself is on GPIB, USB or a network, and not on RS-232."""
        self.can_clear = self.on_bus
        """Whether a clear frees an instrument that waits; a serial line learns it from the first break."""
        try:
            with self._link_errors("opening"):
                self._configure()
        except LinkError:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the link; never raises, because a link that is gone is closed as well."""
        self._hang_up()
        self._claim.release()

    def _hang_up(self) -> None:
        self.closed = True
        note(self.name, "close")
        for resource in (self._resource, self._beneath):
            with contextlib.suppress(pyvisa.Error, OSError):
                if resource is not None:
                    resource.close()

    def reopen(self) -> None:
        """Close what is left of a lost link, and open it anew. LinkError if that is not possible now."""
        # Other programs are kept from it meanwhile.
        self._hang_up()
        self._timeout = self._socket = self._line = None
        self._resource, self._beneath = open_instrument(self.name, self._manager, ANSWER_TIME)
        self._adapter = adapter_of(self._resource)
        self.closed = False
        with self._link_errors("opening"):
            self._configure()

    def line_time(self, byte_count: float) -> float:
        """Time in s that `byte_count` bytes need, at most, if nothing holds them up."""
        if self.framed:
            return byte_count / GPIB_BYTES_PER_SECOND
        return byte_count * BITS_PER_BYTE / self.baud_rate * LINE_MARGIN

    def write(self, text: str) -> None:
        """Send one message; the line feed is added here. LinkError if it cannot be sent."""
        message = text.encode("ascii") + b"\n"
        patience = self.answer_time + self.line_time(len(message))
        self._set_timeout(patience)
        try:
            with self._link_errors("writing to"):
                if self._socket is not None and not select.select([], [self._socket], [], patience)[1]:
                    raise NoAnswer  # PyVISA-py would wait for ever
                self._resource.write_raw(message)
            note(self.name, "write", message)
        except NoAnswer:
            raise LinkError(
                f"{self.name} takes no data; is the scope on, and does the cable carry the handshake wires?"
            ) from None

    def read_text(self, *, wait: float = 0.0, longest: int = 4096) -> str:
        """Read one answer of text."""
        return scpi.decode_text(self._read_message(wait, longest, blocks=0))

    def read_blocks(
        self, *, blocks: int = 1, wait: float = 0.0, longest: int
    ) -> tuple[list[tuple[str, bytes]], str]:
        """Read one answer with `blocks` binary blocks of at most `longest` bytes each."""
        # Returns what `scpi.split_blocks` does; there are fewer pieces if the answer ended before. Errors as
        # `read_text`.
        message = self._read_message(wait, longest, blocks=blocks)
        return scpi.split_blocks(message, longest=longest, blocks=blocks)

    def read_bitmap(self, *, wait: float = 0.0) -> bytes:
        """Read a BMP file that comes without block header and line end; its own header tells its length."""
        # Errors as `read_text`.
        if self.framed:
            picture = self._read_framed(wait, LONGEST_PICTURE)
            length = _bitmap_length(picture)
        else:
            answer = _Arriving(self, wait, pauses=1)
            while len(answer.data) < _BITMAP_LENGTH_END:
                answer.more(_BITMAP_LENGTH_END - len(answer.data), self.answer_time)
            length = _bitmap_length(answer.data)
            while len(answer.data) < length:
                answer.more(min(self.chunk, length - len(answer.data)), self.answer_time)
            picture = bytes(answer.data)
            self.drain()  # some units send a line end after all
        if not length <= len(picture) <= length + 2:
            raise TransferError(f"the picture has {len(picture)} bytes instead of {length}; ask again")
        return picture[:length]

    def clear(self, silence: float | None = None) -> None:
        """Bring both sides to rest: the instrument drops what it waits for, and late bytes are thrown away."""
        # GPIB, USB and VXI-11 have a device clear. On RS-232 a break does the same, and the scope answers ``DCL``
        # (071-1064-00, p. 142). A bare socket has nothing like it: there only late bytes are dropped.
        note(self.name, "clear")
        if self.on_bus:
            self._set_timeout(self.answer_time)
            with self._link_errors("clearing"):
                self._resource.clear()
        if self.framed:
            return
        if self.is_serial:
            self._send_break()
        late = self.drain(silence)
        if b"DCL" in late[-8:]:
            self.can_clear = True

    def drain(self, silence: float | None = None) -> bytes:
        """Read a stream until it is silent for so many seconds, `PAUSE_TIME` by default; returns what came."""
        # Raises LinkError if the other side keeps talking for longer than the longest answer could take.
        late = bytearray()
        began = self.clock.now()
        longest = self.answer_time + self.line_time(16_384)
        while self.clock.now() - began < longest:
            try:
                late += self.first_byte(self.pause_time if silence is None else silence)
            except NoAnswer:
                return bytes(late)
        raise LinkError(
            f"{self.name} has been sending for {self.clock.now() - began:.1f} s without being asked; is another "
            "program or device on it?"
        )

    # ------------------------------------------------------------------ reading

    @property
    def chunk(self) -> int:
        """Bytes that the line carries in about one slice, so that a lost link is seen within that time."""
        return max(16, int(SLICE_TIME * self.baud_rate / BITS_PER_BYTE))

    def first_byte(self, patience: float) -> bytes:
        """One byte of a stream, waiting in short steps so that a closed connection is noticed at once."""
        began = listened = self.clock.now()
        while True:
            over = self.clock.now() - began >= patience
            try:
                return self.read_some(1, min(SLICE_TIME, patience))
            except NoAnswer:
                if self._adapter is not None and not over and self.clock.now() - listened >= READ_AGAIN_S:
                    listened = self.clock.now()
                    with self._link_errors("reading from"):
                        self._adapter.read_again()
                if over:
                    waited = self.clock.now() - began
                    raise NoAnswer(f"{self.name} did not answer within {waited:.1f} s") from None

    def read_some(self, count: int, patience: float) -> bytes:
        """At most `count` bytes of a stream, fewer if a line feed comes first; NoAnswer if any is missing."""
        self._set_timeout(patience)
        if self._socket is not None:
            self._socket.patience(patience)
        return self._visa_read(count)[0]

    def _read_message(self, wait: float, longest: int, *, blocks: int) -> bytes:
        if self.framed:
            return self._read_framed(wait, longest * max(1, blocks))
        return self._read_stream(wait, longest, blocks)

    def _read_framed(self, wait: float, longest: int) -> bytes:
        limit = longest + _TEXT_BESIDE_BLOCKS
        began, patience = self.clock.now(), self.answer_time + wait + self.line_time(limit)
        message = bytearray()
        ended = False
        while not ended:
            waited = self.clock.now() - began
            self._set_timeout(max(SLICE_TIME, patience - waited))
            try:
                data, ended = self._visa_read(limit)
            except NoAnswer:
                waited = self.clock.now() - began
                raise NoAnswer(f"{self.name} did not answer within {waited:.1f} s") from None
            message += data
            if len(message) > limit:
                raise TransferError(f"{self.name} sent more than the {limit} bytes that were expected; ask again")
            if not ended and waited > patience:
                raise TransferError(f"{self.name} sent {len(message)} bytes in {waited:.1f} s, no end; ask again")
        return bytes(message)

    def _read_stream(self, wait: float, longest: int, blocks: int) -> bytes:
        answer = _Arriving(self, wait, pauses=1 + 2 * blocks)
        message = answer.data
        while True:
            if blocks:
                missing = scpi.bytes_missing(message, longest=longest, blocks=blocks)
            else:
                missing = 0 if message.endswith(b"\n") else 1
            if missing == 0:
                return bytes(message)
            if len(message) > longest * max(1, blocks) + _TEXT_BESIDE_BLOCKS:
                raise TransferError(f"{self.name} sent more than {len(message)} bytes without an end; ask again")
            begun, lacking = scpi.blocks_begun(message, longest=longest) if blocks else (0, 0)
            if begun and lacking >= 0:
                # Between the parts of an answer, preamble and curve for one, the scope may think again.
                pause = self.pause_time if lacking or begun == blocks else self.answer_time
                answer.more(min(lacking or 1, self.chunk), pause)
            else:
                answer.more(self.chunk, self.answer_time)

    def _visa_read(self, count: int) -> tuple[bytes, bool]:
        """One VISA read of at most `count` bytes; the flag tells whether it ended a message."""
        full = StatusCode.success_max_count_read
        with self._link_errors("reading from"), self._resource.ignore_warning(full):
            if self._line is not None:
                data, status = self._line.read(count, (self._timeout or 0.0) / 1000), full
            else:
                data, status = self._resource.visalib.read(self._resource.session, count)
        note(self.name, "read", bytes(data))
        return bytes(data), status != full

    # ------------------------------------------------------------------ set-up and errors

    def _configure(self) -> None:
        resource = self._resource
        note(self.name, "open")
        if not keep_to_oneself(resource):
            raise LinkError(f"{self.name} is in use by another program; end that program, or use it there")
        resource.write_termination = ""
        if self._adapter is not None:
            self._adapter.configure()
            self._tune_socket()
            return
        if self.framed:
            resource.read_termination = None
            return
        resource.read_termination = "\n"
        if isinstance(resource, SerialInstrument):
            resource.baud_rate = self.baud_rate
            resource.data_bits = 8
            resource.parity = constants.Parity.none
            resource.stop_bits = constants.StopBits.one
            # Hard flagging is the factory setting and the only one that passes binary data unharmed.
            resource.flow_control = constants.ControlFlow.rts_cts
            resource.end_input = constants.SerialTermination.termination_char
            port: Any = getattr(session_of(resource), "interface", None)
            self._line = SerialLine(port) if hasattr(port, "in_waiting") else None
        else:
            self._tune_socket()

    def _tune_socket(self) -> None:
        """Send without delay, and notice a closed connection; another VISA than PyVISA-py does both by itself."""
        holder: Any = session_of(self._resource) if self._adapter is None else self._adapter.holder
        peer = socket_of(holder)
        if peer is not None:
            # PyVISA-py 0.8 has no attribute for it.
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket = holder.interface = DeadlineSocket(fileno=peer.detach())

    def _send_break(self) -> None:
        if not isinstance(self._resource, SerialInstrument):
            return
        resource = self._resource
        with self._link_errors("sending a break to"):
            self._set_timeout(self.answer_time)
            resource.end_output = constants.SerialTermination.termination_break
            try:
                # The line feed first ends a half-sent command.
                resource.write_raw(b"\n")
            finally:
                resource.end_output = constants.SerialTermination.none

    def _set_timeout(self, seconds: float) -> None:
        milliseconds = max(1.0, round(seconds * 1000.0))
        if milliseconds != self._timeout:
            with self._link_errors("setting up"):
                if self._adapter is None:
                    self._resource.timeout = milliseconds
                else:
                    self._adapter.set_timeout(milliseconds)
            self._timeout = milliseconds

    @contextlib.contextmanager
    def _link_errors(self, doing: str) -> Iterator[None]:
        try:
            yield
        except pyvisa.VisaIOError as error:
            if error.error_code != StatusCode.error_timeout:
                raise LinkError(f"{doing} {self.name} failed: {error.description}") from error
            raise NoAnswer(f"{self.name} did not answer") from None
        except Overdue:
            raise NoAnswer(f"{self.name} did not answer") from None
        except HungUp:
            raise LinkError(f"{self.name} has closed the connection; switch it on and connect again") from None
        except (pyvisa.Error, OSError) as error:
            raise LinkError(f"{doing} {self.name} failed, the link is lost: {error}") from error


class _Arriving:
    """An answer on a stream while it arrives: its bytes, and how much longer it may take."""

    def __init__(self, link: Link, wait: float, *, pauses: int) -> None:
        self._link, self._thinking = link, pauses * link.answer_time
        asked = link.clock.now()
        self.data = bytearray(link.first_byte(link.answer_time + wait))
        self._began = link.clock.now()
        link.began_after = max(0.0, self._began - asked - wait)

    def more(self, count: int, pause: float) -> None:
        """Take up to `count` more bytes, fewer if a line feed comes first; TransferError if they do not come."""
        link = self._link
        longest = self._thinking + link.line_time(len(self.data) + count)
        if self._passed > longest:
            raise TransferError(f"{self._so_far} came, too slowly to be an answer; ask again")
        try:
            patience = min(pause, max(SLICE_TIME, longest - self._passed))
            self.data += link.read_some(count, patience + link.line_time(count))
        except NoAnswer:
            raise TransferError(f"{self._so_far} came and no more: bytes were lost; ask again") from None

    @property
    def _passed(self) -> float:
        return self._link.clock.now() - self._began

    @property
    def _so_far(self) -> str:
        return f"from {self._link.name} about {len(self.data)} bytes in {self._passed:.1f} s"


def _bitmap_length(picture: bytes | bytearray) -> int:
    length = int.from_bytes(picture[2:_BITMAP_LENGTH_END], "little")
    if picture[:2] != b"BM" or not _BITMAP_LENGTH_END < length <= LONGEST_PICTURE:
        raise TransferError(f"a picture was expected, but {bytes(picture[:20])!r} came; ask again")
    return length


# --------------------
# A serial line and a TCP socket where PyVISA-py takes bytes one by one, or waits over what they notice


class HungUp(ConnectionError):
    """The other side has closed the connection."""


class Overdue(Exception):
    """Bytes go on coming one by one, and not all that were asked for are there in time."""


class SerialLine:
    """Bytes of a serial port of PyVISA-py, as many at a time as have come; it takes them one by one itself."""

    def __init__(self, port: Any) -> None:
        self._port, self._ahead = port, bytearray()

    def read(self, count: int, seconds: float) -> bytes:
        """Read up to a line feed, `count` bytes at most; Overdue if one is missing, and what came is dropped."""
        ends_at, looked_behind = time.monotonic() + seconds, False
        while True:
            size = self._ahead.find(b"\n", 0, count) + 1 or (count if len(self._ahead) >= count else 0)
            if size:
                data = bytes(self._ahead[:size])
                del self._ahead[:size]
                return data
            if looked_behind:
                self._ahead.clear()
                raise Overdue
            late = time.monotonic() > ends_at
            # waits for the first of them as long as the port's own limit says, which is that of the link
            self._ahead += (came := self._port.read(max(1, self._port.in_waiting)))
            looked_behind = late or not came


class DeadlineSocket(socket.socket):
    """A socket that notices what PyVISA-py waits over: the other side's hanging up, and its trickling."""

    _ends_at = math.inf
    _looked_behind = False

    def patience(self, seconds: float) -> None:
        """Let one read take so long in all."""
        self._ends_at, self._looked_behind = time.monotonic() + seconds, False

    def recv(self, bufsize: int, flags: int = 0, /) -> bytes:
        """Receive as a socket does; HungUp and Overdue beside its own errors."""
        if self._looked_behind:
            raise Overdue
        self._looked_behind = time.monotonic() > self._ends_at
        data = super().recv(bufsize, flags)
        if not data and bufsize > 0:
            raise HungUp
        return data
