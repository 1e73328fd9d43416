"""Simulated oscilloscopes behind a real link."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from instrument.simulated import GpibAdapterServer, HislipServer, PtyServer, SimulatedTDS2014, TcpServer
from station.errors import UsageError

Server = PtyServer | TcpServer | HislipServer | GpibAdapterServer


@dataclass(frozen=True)
class Served:
    """Instruments that are served, and their VISA names in the same order."""

    servers: tuple[Server, ...]
    resource_names: tuple[str, ...]

    def wait(self, timeout: float) -> bool:
        """Wait until one of them is served no more; False after `timeout` s."""
        one, *others = (server.ended for server in self.servers)
        return any(ended.is_set() for ended in others) or one.wait(timeout=timeout)


@contextmanager
def serve(scope: SimulatedTDS2014, link: str, *, tcp_port: int = 0) -> Iterator[str]:
    """Put one simulated oscilloscope behind a byte stream, as :func:`served` does it; yields its VISA name."""
    with served([scope], link, port=tcp_port) as found:
        yield found.resource_names[0]


@contextmanager
def served(
    scopes: Sequence[SimulatedTDS2014], link: str, *, port: int = 0, baud_rate: int | None = None
) -> Iterator[Served]:
    """Put simulated oscilloscopes behind a link."""
    with ExitStack() as stack:
        try:
            yield _start(stack, scopes, link, port, baud_rate)
        except _NotServed as problem:
            if link != "auto":
                raise UsageError(f"the simulated scope cannot be served: {problem}") from None
            yield _start(stack, scopes, "tcp", port, None)


class _NotServed(Exception):
    """The system does not give the link."""


def _start(
    stack: ExitStack, scopes: Sequence[SimulatedTDS2014], link: str, port: int, baud_rate: int | None
) -> Served:
    try:
        if link == "hislip":
            server = stack.enter_context(HislipServer(scopes, port=port))
            return Served((server,), server.resource_names)
        servers: list[TcpServer | PtyServer | GpibAdapterServer] = []
        for number, scope in enumerate(scopes):
            own = port + number if port else 0
            if link == "tcp":
                servers.append(stack.enter_context(TcpServer(scope, port=own)))
            elif link == "prologix":
                servers.append(stack.enter_context(GpibAdapterServer(scope, port=own)))
            else:
                servers.append(stack.enter_context(PtyServer(scope, baud_rate=baud_rate)))
    except OSError as error:
        raise _NotServed(error.strerror or str(error)) from None
    return Served(tuple(servers), tuple(server.resource_name for server in servers))
