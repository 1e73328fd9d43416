"""The simulated instrument behind a TCP socket, as behind a serial-to-Ethernet adapter."""

from __future__ import annotations

import selectors
import socket

from instrument.simulated.links.exchange import MessageExchange
from instrument.simulated.links.stream_server import Line, Port, StreamServer
from instrument.simulated.scope import SimulatedTDS2014


class TcpServer(StreamServer):
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
        self._serial, self._baud_rate = serial, baud_rate
        self._listener = socket.create_server((host, port))
        super().__init__(scope)
        self._listener.setblocking(False)
        self.host, self.port = self._listener.getsockname()[:2]
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)
        self._thread.start()

    @property
    def resource_name(self) -> str:
        """VISA resource name for clients on this computer."""
        return f"TCPIP0::{self.host}::{self.port}::SOCKET"

    def _accept(self) -> None:
        try:
            client, _ = self._listener.accept()
        except OSError:
            return
        if not self.scope.powered:
            client.close()
            return
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        exchange = MessageExchange(self.scope, message_ends=False, serial=self._serial)
        lines = Line(self._baud_rate), Line(self._baud_rate)
        self._add(Port(client.fileno(), exchange, client.recv, client.send, client.close, *lines))

    def _released(self) -> None:
        self._listener.close()
