"""The simulated oscilloscope behind a TCP socket, and behind a serial port that is a pseudo-terminal.

A pseudo-terminal has no modem lines and carries no break, so RTS/CTS flagging always looks ready and the
break that makes a real unit answer `DCL` does not arrive; call `break_signal` in its place. XON and XOFF work on
both sides when RS232:SOFTFlagging is on and the program opens the port with them.
"""

from __future__ import annotations

import time

from instrument.simulated.links.exchange import MessageExchange
from instrument.simulated.links.stream_server import FULL, LOOK_UP, Line, Port, StreamServer
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
