"""The simulated oscilloscope behind a TCP socket, a pseudo-terminal, or a GPIB adapter.

A pseudo-terminal has no modem lines and carries no break, so RTS/CTS flagging always looks ready and the
break that makes a real unit answer `DCL` does not arrive; call `break_signal` in its place. XON and XOFF work on
both sides when RS232:SOFTFlagging is on and the program opens the port with them.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from instrument.simulated.links.exchange import MessageExchange
from instrument.simulated.links.stream_server import FULL, LOOK_UP, Line, Port, StreamServer
from instrument.simulated.panel.parsing import LONGEST_MESSAGE
from instrument.simulated.scope import SimulatedTDS2014

_TURN = 4  # messages of one client before the next one has its turn
_AT_ONCE = 4096  # bytes whose questions are taken before answers are sent
_PACE = 0.004  # s of line time that travel in one piece


class ScopeServer(StreamServer):
    """An oscilloscope and the exchange of messages with each of its clients."""

    def __init__(self, scope: SimulatedTDS2014, *, serial: bool, baud_rate: float | None) -> None:
        super().__init__()
        self.scope = scope
        self._serial, self._baud_rate = serial, baud_rate
        self._exchanges: dict[Port, MessageExchange] = {}

    def break_signal(self) -> None:
        """Stand in for a break on the line, which these links cannot carry: every client is sent `DCL`."""
        for exchange in list(self._exchanges.values()):
            exchange.break_signal()
        self._wake()

    def _welcomes(self) -> bool:
        return self.scope.powered

    def _add(self, port: Port) -> None:
        port.incoming, port.outgoing = Line(self._baud_rate), Line(self._baud_rate)
        self._exchanges[port] = MessageExchange(self.scope, message_ends=False, serial=self._serial)
        super()._add(port)

    def _drop(self, port: Port) -> None:
        if port in self._exchanges:
            self._exchanges.pop(port).clear()
        super()._drop(port)

    def _pause(self) -> float:
        pauses = [LOOK_UP]
        for port in self._ports:
            if len(port.outgoing) or len(port.incoming):
                pauses.append(_PACE)
            if self._exchanges[port].ready:
                pauses.append(0.0)
            pauses.append(self._exchanges[port].pause())
        return min(pauses)

    def _serve(self, port: Port) -> None:
        if not self.scope.powered:
            self._drop(port)
            return
        exchange, now = self._exchanges[port], time.monotonic()
        takes = len(port.outgoing) < FULL and not exchange.full
        if takes and (arrived := port.incoming.take(now, _AT_ONCE)):
            exchange.receive(arrived, now)
        if exchange.output_dropped:
            exchange.output_dropped = False
            port.outgoing.clear()
        exchange.let_time_pass(_TURN)
        exchange.pump(_TURN)
        while (answer := exchange.take()) is not None:
            port.outgoing.put(answer, now)
        self._send(port, now)
        if exchange.closed and not len(port.outgoing):
            self._drop(port)


class TcpServer(ScopeServer):
    """Serves an instrument on a TCP port until it is closed.

    Several clients may be connected; each has its own answers, all see the same instrument.

    Parameters
    ----------
    scope : SimulatedTDS2014
        The instrument.
    host : str
        Address to listen on; only this computer unless told otherwise.
    port : int
        0 takes any free port.
    serial : bool
        True for an adapter between Ethernet and RS-232: the terminator, flow control and input errors of RS-232.
    baud_rate : float, optional
        Bytes take their time on that RS-232 line. Without it they are there at once.

    Raises
    ------
    OSError
        If the port cannot be had.

    Examples
    --------
    >>> with TcpServer(SimulatedTDS2014()) as server:
    ...     server.resource_name.startswith("TCPIP0::127.0.0.1::")
    True
    """

    def __init__(
        self,
        scope: SimulatedTDS2014,
        host: str = "127.0.0.1",
        port: int = 0,
        *,
        serial: bool = False,
        baud_rate: float | None = None,
    ) -> None:
        super().__init__(scope, serial=serial, baud_rate=baud_rate)
        self.host, self.port = self._listen(host, port)
        self._thread.start()

    @property
    def resource_name(self) -> str:
        """VISA resource name for clients on this computer."""
        return f"TCPIP0::{self.host}::{self.port}::SOCKET"


class PtyServer(ScopeServer):
    """Serves an instrument on a pseudo-terminal until it is closed.

    Parameters
    ----------
    scope : SimulatedTDS2014
        The instrument.
    baud_rate : float, optional
        Bytes take their time on the line, 10 bits each, in both directions. Without it they are there at once.

    Raises
    ------
    OSError
        If this system has no pseudo-terminals (Windows).
    """

    def __init__(self, scope: SimulatedTDS2014, baud_rate: float | None = None) -> None:
        super().__init__(scope, serial=True, baud_rate=baud_rate)
        self.device = self._open_terminal()
        self._thread.start()

    @property
    def resource_name(self) -> str:
        """VISA resource name."""
        return f"ASRL{self.device}::INSTR"


# --------------------
# The simulated oscilloscope behind a GPIB adapter of Prologix' kind, on a TCP port or a serial terminal.
#
# Orders begin with `++`; anything else goes to the instrument, without the ESC characters that shield special
# bytes. The adapter hands over what the instrument says only when it is told to read, and gives up after
# `read_tmo_ms`. Source: Prologix GPIB-Ethernet controller user manual, version 1.6.6, sections 7 and 8


_VERSION = b"Simulated GPIB adapter, version 6.107\r\n"
_ESCAPE, _LINE_FEED, _RETURN = 0x1B, 0x0A, 0x0D
_APPENDED = (b"\r\n", b"\r", b"\n", b"")  # ++eos 0 to 3
_UNSENT = 0.001  # s
_NOTHING_TO_SAY = 420  # what an instrument posts that is addressed to talk and was not asked
_UNRECOGNIZED = b"Unrecognized command\r\n"


@dataclass
class _Client:
    """One client, and what it has set."""

    exchange: MessageExchange
    buffer: bytearray = field(default_factory=bytearray)
    settings: dict[str, str] = field(
        default_factory=lambda: {
            "addr": "1",
            "auto": "0",
            "eoi": "1",
            "eos": "0",
            "eot_char": "0",
            "eot_enable": "0",
            "mode": "1",
            "read_tmo_ms": "200",
            "savecfg": "1",
        }
    )
    reading_until: float = 0.0  # time in s at which a read gives up; 0: not reading
    last: int | None = None  # the character that ends a read, before the message does
    escaped: bool = False


class GpibAdapterServer(StreamServer):
    """Serves an instrument behind such an adapter until it is closed.

    Parameters
    ----------
    scope : SimulatedTDS2014
        The instrument.
    address : int
        Its address on the bus; at any other one nobody answers.
    terminal : bool
        True for a serial terminal in place of a TCP port.
    port : int
        0 takes any free port.

    Raises
    ------
    OSError
        If the port cannot be had, or the system has no terminals.
    """

    def __init__(
        self,
        scope: SimulatedTDS2014,
        *,
        address: int = 1,
        terminal: bool = False,
        host: str = "127.0.0.1",
        port: int = 0,
    ) -> None:
        super().__init__()
        self.scope, self.address = scope, address
        self._clients: dict[Port, _Client] = {}
        if terminal:
            self._interface = f"PRLGX-ASRL0::{self._open_terminal()}"
        else:
            self.host, self.port = self._listen(host, port)
            self._interface = f"PRLGX-TCPIP0::{self.host}::{self.port}"
        self._thread.start()

    @property
    def interface_name(self) -> str:
        """VISA name of the adapter."""
        return f"{self._interface}::INTFC"

    @property
    def resource_name(self) -> str:
        """Name of the instrument behind it, as this project writes it."""
        return f"{self._interface}::GPIB0::{self.address}::INSTR"

    def _add(self, port: Port) -> None:
        port.incoming, port.outgoing = Line(), Line()
        self._clients[port] = _Client(MessageExchange(self.scope, message_ends=True))
        super()._add(port)

    def _drop(self, port: Port) -> None:
        if port in self._clients:
            self._clients.pop(port).exchange.clear()
        super()._drop(port)

    def _pause(self) -> float:
        pauses, now = [LOOK_UP], time.monotonic()
        for port, client in self._clients.items():
            if len(port.outgoing):
                pauses.append(_UNSENT)
            if client.reading_until:
                pauses.append(client.reading_until - now)
            pauses.append(client.exchange.pause())
        return max(0.0, min(pauses))

    def _serve(self, port: Port) -> None:
        client, now = self._clients[port], time.monotonic()
        self._take_lines(port, client, now)
        exchange = client.exchange
        exchange.let_time_pass()
        if client.reading_until:
            answer = client.exchange.take() if self._here(client) else None
            if answer is not None:
                end = len(answer) if client.last is None else answer.find(client.last) + 1 or len(answer)
                eot = bytes([int(client.settings["eot_char"])]) if client.settings["eot_enable"] == "1" else b""
                if end < len(answer):
                    client.exchange.put_back(answer[end:])
                    eot = b""
                port.outgoing.put(answer[:end] + eot, now)
                client.reading_until = 0.0
            elif now >= client.reading_until:
                client.reading_until = 0.0
        self._send(port, now)
        if exchange.closed:
            self._drop(port)

    def _take_lines(self, port: Port, client: _Client, now: float) -> None:
        """Cut what came into lines at unshielded ends, and carry them out one by one."""
        for byte in port.incoming.take(now):
            if client.escaped:
                client.escaped = False
                if len(client.buffer) <= LONGEST_MESSAGE:
                    client.buffer += bytes([_ESCAPE, byte])
            elif byte == _ESCAPE:
                client.escaped = True
            elif byte in (_LINE_FEED, _RETURN):
                line, client.buffer = bytes(client.buffer), bytearray()
                if line:
                    self._carry_out(port, client, line, now)
            elif len(client.buffer) <= LONGEST_MESSAGE:  # the rest of a line without end is lost
                client.buffer.append(byte)

    def _carry_out(self, port: Port, client: _Client, line: bytes, now: float) -> None:
        if line.startswith(b"++"):
            self._order(port, client, line[2:].decode("ascii", errors="replace").split(), now)
            return
        if self._here(client):
            client.exchange.receive(_unshielded(line) + _APPENDED[int(client.settings["eos"])])
        if client.settings["auto"] == "1":
            self._start_reading(client, now)

    def _order(self, port: Port, client: _Client, words: list[str], now: float) -> None:
        name, *values = words or [""]
        exchange = client.exchange
        if name in client.settings:
            if values:
                client.settings[name] = " ".join(values)
            else:
                port.outgoing.put(f"{client.settings[name]}\r\n".encode(), now)
        elif name == "read":
            self._start_reading(client, now, values)
        elif name == "clr":
            exchange.clear()
            client.reading_until = 0.0
        elif name == "trg":
            exchange.receive(b"*TRG")
        elif name in ("spoll", "srq"):
            status = exchange.serial_poll() if name == "spoll" else int(bool(exchange.status_byte() & 64))
            port.outgoing.put(f"{status}\r\n".encode(), now)
        elif name == "ver":
            port.outgoing.put(_VERSION, now)
        elif name not in ("ifc", "loc", "llo", "rst"):
            port.outgoing.put(_UNRECOGNIZED, now)

    def _start_reading(self, client: _Client, now: float, values: Sequence[str] = ()) -> None:
        """Listen to the instrument: to the end of its message, or to a character."""
        client.reading_until = now + int(client.settings["read_tmo_ms"]) / 1000
        client.last = int(values[0]) if values and values[0].isdigit() else None
        client.exchange.pump()
        if self._here(client) and not (client.exchange.working or client.exchange.answering):
            with self.scope.lock:
                self.scope.status.post(_NOTHING_TO_SAY)

    def _here(self, client: _Client) -> bool:
        """Whether the instrument has the address that is set."""
        return int(client.settings["addr"].split()[0]) == self.address


def _unshielded(line: bytes) -> bytes:
    """The bytes behind the ESC characters."""
    shielded = bytearray()
    at = 0
    while at < len(line):
        if line[at] == _ESCAPE and at + 1 < len(line):
            at += 1
        shielded.append(line[at])
        at += 1
    return bytes(shielded)
