"""Bytes to and from an instrument through PyVISA, on links with and without an end of message.

GPIB, USB and VXI-11 are *framed*: a message has an end of its own, so an answer may hold any byte. RS-232
and a bare TCP socket are *streams*: only a line feed or a known length tells where an answer ends. There text
is read to its line feed and binary data by exact count.

Every time limit here is made of named ingredients: the time that the instrument takes to begin an answer, the
longest pause inside one, the bytes at the baud rate, and the time that an acquisition takes (the caller's).
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterator

import pyvisa
from pyvisa import constants
from pyvisa.constants import InterfaceType, StatusCode
from pyvisa.resources import MessageBasedResource, SerialInstrument

from instrument import scpi
from instrument.errors import LinkError, TransferError

ANSWER_TIME = 3.0
"""Longest time in s until an answer begins: twice the 1.5 s that units of this family were seen to take."""

PAUSE_TIME = 0.5
"""Longest silence in s inside an answer that has begun."""

LINE_MARGIN = 1.5
"""Real time over ideal time of a serial line, for flow control and the other side's scheduling."""

SLICE_TIME = 0.1
"""Step in s in which a stream is watched for the other side hanging up."""

DEFAULT_BAUD_RATE = 9600
"""The scope's factory setting (user manual 071-1064-00, p. 136)."""

BITS_PER_BYTE = 10
"""One start bit, eight data bits, one stop bit."""

GPIB_BYTES_PER_SECOND = 20_000.0
"""A tenth of the rate named in 071-1064-00, appendix E: the slowest that a framed link should ever be."""

LONGEST_PICTURE = 1_000_000
"""Bytes; a colour picture of 640 x 480 pixels fits."""

_TEXT_BESIDE_BLOCKS = 1024  # bytes; four preambles and a margin

_BITMAP_LENGTH_END = 6  # "BM" and four bytes with the length of the file


class NoAnswer(LinkError):
    """Nothing, or nothing more, came in time. The caller finds out whether the instrument is still there."""


class Link:
    """One open link to an instrument; a context manager.

    Parameters
    ----------
    resource_name : str
        VISA resource name, for example ``"GPIB0::1::INSTR"`` or ``"ASRL/dev/ttyUSB0::INSTR"``.
    resource_manager : pyvisa.ResourceManager, optional
        Default: PyVISA's own choice (a vendor's VISA if there is one, else PyVISA-py).
    baud_rate : int, optional
        Speed of the serial line. For a TCP socket it is the speed behind the serial-to-Ethernet converter;
        it only lengthens time limits there.

    Raises
    ------
    LinkError
        If it cannot be opened; the text says why.
    """

    def __init__(
        self,
        resource_name: str,
        resource_manager: pyvisa.ResourceManager | None = None,
        baud_rate: int | None = None,
    ) -> None:
        self.name = resource_name
        self.closed = False
        self.answer_time = ANSWER_TIME
        """May be raised for an unusually slow unit."""
        self._timeout: float | None = None
        self._resource = _open(resource_name, resource_manager)
        interface = self._resource.interface_type
        self.is_serial = interface == InterfaceType.asrl
        self.framed = not self.is_serial and not resource_name.upper().rstrip().endswith("SOCKET")
        self.baud_rate = baud_rate or DEFAULT_BAUD_RATE
        self.can_clear = self.framed
        """Whether a clear frees an instrument that waits; a serial line learns it from the first break."""
        try:
            with self._link_errors("opening"):
                self._configure()
        except LinkError:
            self.close()
            raise

    def __enter__(self) -> Link:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the link; never raises, because a link that is gone is closed as well."""
        self.closed = True
        with contextlib.suppress(pyvisa.Error, OSError):
            self._resource.close()

    def line_time(self, byte_count: float) -> float:
        """Time in s that `byte_count` bytes need, at most, if nothing holds them up."""
        if self.framed:
            return byte_count / GPIB_BYTES_PER_SECOND
        return byte_count * BITS_PER_BYTE / self.baud_rate * LINE_MARGIN

    def write(self, text: str) -> None:
        """Send one message; the line feed is added here. LinkError if it cannot be sent."""
        message = text.encode("ascii") + b"\n"
        self._set_timeout(self.answer_time + self.line_time(len(message)))
        try:
            with self._link_errors("writing to"):
                self._resource.write_raw(message)
        except NoAnswer:
            raise LinkError(
                f"{self.name} takes no data; is the scope on, and does the cable carry the handshake wires?"
            ) from None

    def read_text(self, *, wait: float = 0.0, longest: int = 4096) -> str:
        """Read one answer of text.

        Parameters
        ----------
        wait : float
            Time in s that the instrument may need before it can answer (an acquisition, for example), beyond
            `ANSWER_TIME`.
        longest : int
            Longest answer in bytes that can be meant.

        Raises
        ------
        NoAnswer
            If nothing came.
        TransferError
            If it began and did not end, is longer than `longest`, or is not text.
        """
        return scpi.decode_text(self._read_message(wait, longest, blocks=0))

    def read_blocks(
        self, *, blocks: int = 1, wait: float = 0.0, longest: int
    ) -> tuple[list[tuple[str, bytes]], str]:
        """Read one answer with `blocks` binary blocks of at most `longest` bytes each.

        Returns what `scpi.split_blocks` does; there are fewer pieces if the answer ended before. Errors as
        `read_text`.
        """
        message = self._read_message(wait, longest, blocks=blocks)
        return scpi.split_blocks(message, longest=longest, blocks=blocks)

    def read_bitmap(self, *, wait: float = 0.0) -> bytes:
        """Read a BMP file that comes without block header and line end; its own header tells its length.

        Errors as `read_text`.
        """
        if self.framed:
            picture = self._read_framed(wait, LONGEST_PICTURE)
            length = _bitmap_length(picture)
        else:
            begun = bytearray(self._first_byte(self.answer_time + wait))
            self._fill(begun, _BITMAP_LENGTH_END)
            length = _bitmap_length(begun)
            self._fill(begun, length)
            picture = bytes(begun)
            self.drain()  # some units send a line end after all
        if not length <= len(picture) <= length + 2:
            raise TransferError(f"the picture has {len(picture)} bytes instead of {length}; ask again")
        return picture[:length]

    def _fill(self, message: bytearray, length: int) -> None:
        chunk = max(16, int(SLICE_TIME * self.baud_rate / BITS_PER_BYTE))
        while len(message) < length:
            message += self._more(min(chunk, length - len(message)), self.answer_time, len(message))

    def clear(self) -> None:
        """Bring both sides to rest: the instrument drops what it waits for, and late bytes are thrown away.

        GPIB, USB and VXI-11 have a device clear. On RS-232 a break does the same, and the scope answers
        ``DCL`` (071-1064-00, p. 142). A bare socket has nothing like it: there only late bytes are dropped.
        """
        if self.framed:
            self._set_timeout(self.answer_time)
            with self._link_errors("clearing"):
                self._resource.clear()
            return
        if self.is_serial:
            self._send_break()
        late = self.drain()
        if b"DCL" in late[-8:]:
            self.can_clear = True

    def drain(self) -> bytes:
        """Read a stream until it is silent for `PAUSE_TIME`; returns what came.

        Raises LinkError if the other side keeps talking for longer than the longest answer could take.
        """
        late = bytearray()
        deadline = time.monotonic() + self.answer_time + self.line_time(16_384)
        while time.monotonic() < deadline:
            try:
                late += self._first_byte(PAUSE_TIME)
            except NoAnswer:
                return bytes(late)
        raise LinkError(f"{self.name} keeps sending without being asked; is another program or device on it?")

    # ------------------------------------------------------------------ reading

    def _read_message(self, wait: float, longest: int, *, blocks: int) -> bytes:
        if self.framed:
            return self._read_framed(wait, longest * max(1, blocks))
        return self._read_stream(wait, longest, blocks)

    def _read_framed(self, wait: float, longest: int) -> bytes:
        limit = longest + _TEXT_BESIDE_BLOCKS
        self._set_timeout(self.answer_time + wait + self.line_time(limit))
        message = bytearray()
        ended = False
        while not ended:
            data, ended = self._visa_read(limit)
            message += data
            if len(message) > limit:
                raise TransferError(f"{self.name} sent more than the {limit} bytes that were expected; ask again")
        return bytes(message)

    def _read_stream(self, wait: float, longest: int, blocks: int) -> bytes:
        # A chunk is what the line carries in about one slice, so that a lost link is seen within that time.
        chunk = max(16, int(SLICE_TIME * self.baud_rate / BITS_PER_BYTE))
        message = bytearray(self._first_byte(self.answer_time + wait))
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
                pause = PAUSE_TIME if lacking or begun == blocks else self.answer_time
                message += self._more(min(lacking or 1, chunk), pause, len(message))
            else:
                message += self._more(chunk, self.answer_time, len(message))

    def _more(self, count: int, pause: float, have: int) -> bytes:
        """Up to `count` more bytes of an answer that has begun; fewer if a line feed comes first."""
        try:
            first = self._first_byte(pause)
            if count == 1 or first == b"\n":
                return first
            self._set_timeout(pause + self.line_time(count))
            rest, _ = self._visa_read(count - 1)
        except NoAnswer:
            raise TransferError(
                f"an answer from {self.name} stopped after about {have} bytes: bytes were lost; ask again"
            ) from None
        return first + rest

    def _first_byte(self, patience: float) -> bytes:
        """One byte of a stream, waiting in short steps so that a closed connection is noticed at once."""
        deadline = time.monotonic() + patience
        while True:
            self._set_timeout(min(SLICE_TIME, patience))
            try:
                return self._visa_read(1)[0]
            except NoAnswer:
                if time.monotonic() >= deadline:
                    raise

    def _visa_read(self, count: int) -> tuple[bytes, bool]:
        """One VISA read of at most `count` bytes; the flag tells whether it ended a message."""
        full = StatusCode.success_max_count_read
        with self._link_errors("reading from"), self._resource.ignore_warning(full):
            data, status = self._resource.visalib.read(self._resource.session, count)
        return bytes(data), status != full

    # ------------------------------------------------------------------ set-up and errors

    def _configure(self) -> None:
        resource = self._resource
        resource.write_termination = ""
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
        else:
            self._tune_socket()

    def _tune_socket(self) -> None:
        """Send without delay, and notice a closed connection; another VISA than PyVISA-py does both by itself."""
        sessions = getattr(self._resource.visalib, "sessions", None)
        session = sessions.get(self._resource.session) if isinstance(sessions, dict) else None
        peer = getattr(session, "interface", None)
        if session is not None and isinstance(peer, socket.socket):
            # PyVISA-py 0.8 has no attribute for it.
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            session.interface = _WatchfulSocket(fileno=peer.detach())

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
                self._resource.timeout = milliseconds
            self._timeout = milliseconds

    @contextlib.contextmanager
    def _link_errors(self, doing: str) -> Iterator[None]:
        try:
            yield
        except pyvisa.VisaIOError as error:
            if error.error_code != StatusCode.error_timeout:
                raise LinkError(f"{doing} {self.name} failed: {error.description}") from error
            raise NoAnswer(f"{self.name} did not answer within {(self._timeout or 0) / 1000:g} s") from None
        except _HungUp:
            raise LinkError(f"{self.name} has closed the connection; switch it on and connect again") from None
        except (pyvisa.Error, OSError) as error:
            raise LinkError(f"{doing} {self.name} failed, the link is lost: {error}") from error


class _HungUp(ConnectionError):
    """The other side has closed the connection."""


class _WatchfulSocket(socket.socket):
    """A socket that raises where an ended connection would read as silence, over and over, in PyVISA-py."""

    def recv(self, bufsize: int, flags: int = 0, /) -> bytes:
        data = super().recv(bufsize, flags)
        if not data and bufsize > 0:
            raise _HungUp
        return data


def _bitmap_length(picture: bytes | bytearray) -> int:
    length = int.from_bytes(picture[2:_BITMAP_LENGTH_END], "little")
    if picture[:2] != b"BM" or not _BITMAP_LENGTH_END < length <= LONGEST_PICTURE:
        raise TransferError(f"a picture was expected, but {bytes(picture[:20])!r} came; ask again")
    return length


def _open(name: str, manager: pyvisa.ResourceManager | None) -> MessageBasedResource:
    try:
        if manager is None:
            manager = pyvisa.ResourceManager()
        resource = manager.open_resource(name, open_timeout=round(ANSWER_TIME * 1000))
    except Exception as error:  # PyVISA-py raises whatever its transport does, down to bare Exception
        raise LinkError(f"cannot open {name}: {_reason(error)}") from error
    if not isinstance(resource, MessageBasedResource):
        resource.close()
        raise LinkError(f"{name} is not an instrument that takes text messages; check the resource name")
    return resource


def _reason(error: Exception) -> str:
    if isinstance(error, pyvisa.VisaIOError):
        return f"{error.description} Check the name with 'gyrolock list'"
    text = " ".join(str(error).split())
    return text or type(error).__name__
