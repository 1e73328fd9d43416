"""A simulated oscilloscope behind a real byte stream."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from instrument.simulated import PtyServer, SimulatedTDS2014, TcpServer
from station.errors import UsageError


@contextmanager
def serve(scope: SimulatedTDS2014, link: str, *, tcp_port: int = 0) -> Iterator[str]:
    """Put the simulated oscilloscope behind a byte stream, as :func:`served` does it; yields the VISA name."""
    with served(scope, link, tcp_port=tcp_port) as server:
        yield server.resource_name


@contextmanager
def served(
    scope: SimulatedTDS2014, link: str, *, tcp_port: int = 0, baud_rate: int | None = None
) -> Iterator[PtyServer | TcpServer]:
    """Put the simulated oscilloscope behind a byte stream.

    Parameters
    ----------
    link : {"auto", "pty", "tcp"}
        ``"auto"``: a serial terminal where the system has one.
    tcp_port : int, optional
        0: any free one.
    baud_rate : int, optional
        Paces the serial terminal.

    Yields
    ------
    PtyServer or TcpServer
        With its VISA name, and with an event that is set when it serves no more.

    Raises
    ------
    UsageError
        If the system has no such link, or the port is taken.
    """
    server: PtyServer | TcpServer
    try:
        server = TcpServer(scope, port=tcp_port) if link == "tcp" else PtyServer(scope, baud_rate=baud_rate)
    except OSError as error:
        if link != "auto":
            raise UsageError(f"the simulated scope cannot be served: {error.strerror or error}") from None
        server = TcpServer(scope, port=tcp_port)
    try:
        yield server
    finally:
        server.close()
