"""A TCP link with latency: passes bytes on after a set time, and counts what passes."""

from __future__ import annotations

import contextlib
import queue
import socket
import threading
import time
from dataclasses import dataclass


@dataclass(frozen=True)
class Traffic:
    """What went over the link.

    Attributes
    ----------
    messages : int
        Line ends sent to the instrument.
    turn_arounds : int
        How often the client had to wait for the instrument: answers that came after something was sent.
    up, down : int
        Bytes to and from the instrument.
    """

    messages: int = 0
    turn_arounds: int = 0
    up: int = 0
    down: int = 0


class DelayingProxy:
    """Stands between one client and a server on this computer; a context manager.

    Parameters
    ----------
    port : int
        Port of the server.
    latency : float
        Time in s for there and back; each direction takes half of it.
    """

    def __init__(self, port: int, latency: float) -> None:
        self._server_port, self._one_way = port, latency / 2
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._threads: list[threading.Thread] = []
        self._sockets: list[socket.socket] = []
        self._reset()
        self._start(self._accept)

    def _reset(self) -> None:
        self._messages = self._turn_arounds = self._up = self._down = 0
        self._last_was_up = False

    def __enter__(self) -> DelayingProxy:
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for end in self._sockets:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join(5)
        for end in self._sockets:
            end.close()

    @property
    def resource_name(self) -> str:
        """VISA resource name of the client's side."""
        return f"TCPIP0::127.0.0.1::{self._listener.getsockname()[1]}::SOCKET"

    def traffic(self) -> Traffic:
        """What has passed since this was last asked."""
        passed = Traffic(self._messages, self._turn_arounds, self._up, self._down)
        self._reset()
        return passed

    def _start(self, target: object, *arguments: object) -> None:
        thread = threading.Thread(target=target, args=arguments, daemon=True)  # type: ignore[arg-type]
        self._threads.append(thread)
        thread.start()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            server = socket.create_connection(("127.0.0.1", self._server_port))
            self._sockets += [client, server]
            for source, target, is_up in ((client, server, True), (server, client, False)):
                # A segment must not wait for an earlier one's acknowledgement; only the latency counts here.
                target.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                line: queue.SimpleQueue[tuple[float, bytes]] = queue.SimpleQueue()
                self._start(self._receive, source, line, is_up)
                self._start(self._deliver, line, target)

    def _receive(self, source: socket.socket, line: queue.SimpleQueue[tuple[float, bytes]], is_up: bool) -> None:
        data = b"open"
        while data:
            try:
                data = source.recv(65_536)
            except OSError:
                data = b""
            line.put((time.perf_counter() + self._one_way, data))
            self._count(data, is_up)

    def _count(self, data: bytes, is_up: bool) -> None:
        if not data:
            return
        if is_up:
            self._messages += data.count(b"\n")
            self._up += len(data)
        else:
            self._turn_arounds += self._last_was_up
            self._down += len(data)
        self._last_was_up = is_up

    @staticmethod
    def _deliver(line: queue.SimpleQueue[tuple[float, bytes]], target: socket.socket) -> None:
        while True:
            due, data = line.get()
            time.sleep(max(0.0, due - time.perf_counter()))
            try:
                if not data:
                    target.shutdown(socket.SHUT_WR)
                    return
                target.sendall(data)
            except OSError:
                return
