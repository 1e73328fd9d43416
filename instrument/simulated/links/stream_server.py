"""Serves the instrument on byte streams: the loop that the TCP and the serial server share."""

from __future__ import annotations

import selectors
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Self

from instrument.simulated.links.exchange import MessageExchange
from instrument.simulated.scope import SimulatedTDS2014

_CHUNK = 65_536
_FULL = 1 << 20  # bytes of unread answers at which no more questions are taken
_PACE = 0.004  # s of line time that travel in one piece
_LOOK_UP = 0.2  # s after which an idle server looks whether the instrument is still on
_LATE = 0.05  # s that a paced line may be behind and still catch up
_VIRTUAL_POLL = 0.001  # s of real time between two jumps of a virtual clock


@dataclass
class Line:
    """One direction of a link: holds bytes back until their bits have passed at `baud_rate`."""

    baud_rate: float | None = None
    _held: bytearray = field(default_factory=bytearray)
    _free_at: float = 0.0

    def put(self, data: bytes, now: float) -> None:
        """Hand bytes to the line."""
        if not self._held and now - self._free_at > _LATE:
            self._free_at = now
        self._held += data

    def take(self, now: float) -> bytes:
        """The bytes that have passed by now (s)."""
        if self.baud_rate is None:
            count = len(self._held)
        else:
            rate = self.baud_rate / 10  # bytes a second: start bit, 8 data bits, stop bit
            count = min(int((now - self._free_at) * rate + 1e-6), len(self._held))
            self._free_at += count / rate
        data = bytes(self._held[:count])
        del self._held[:count]
        return data

    def put_back(self, rest: bytes) -> None:
        """Return bytes that the other side could not take yet."""
        self._held[:0] = rest

    def clear(self) -> None:
        """Drop what is under way."""
        self._held.clear()

    def __len__(self) -> int:
        return len(self._held)


@dataclass
class Port:
    """One open stream to one client."""

    descriptor: int
    exchange: MessageExchange
    receive: Callable[[int], bytes]
    send: Callable[[bytes], int]
    close: Callable[[], None]
    incoming: Line
    outgoing: Line


class StreamServer:
    """Runs a thread that moves bytes between clients and the instrument."""

    def __init__(self, scope: SimulatedTDS2014) -> None:
        self.scope = scope
        self._selector = selectors.DefaultSelector()
        self._ports: list[Port] = []
        self._closing = False
        self._wake_out, self._wake_in = socket.socketpair()  # Windows selects on sockets only
        self._selector.register(self._wake_out, selectors.EVENT_READ, lambda: self._wake_out.recv(64))
        self._thread = threading.Thread(target=self._run, name=type(self).__name__, daemon=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Hang up and stop; a second call does nothing."""
        if self._closing:
            return
        self._closing = True
        self._wake_in.send(b"x")
        self._thread.join()

    def break_signal(self) -> None:
        """Stand in for a break on the line, which these links cannot carry: every client is sent `DCL`."""
        for port in list(self._ports):
            port.exchange.break_signal()
        self._wake_in.send(b"x")

    def _add(self, port: Port) -> None:
        self._ports.append(port)
        self._selector.register(port.descriptor, selectors.EVENT_READ, lambda: self._read(port))

    def _drop(self, port: Port) -> None:
        if port in self._ports:
            self._ports.remove(port)
            self._selector.unregister(port.descriptor)
            port.exchange.clear()
            port.close()

    def _run(self) -> None:
        try:
            while not self._closing:
                for port in list(self._ports):
                    self._serve(port)
                for key, _ in self._selector.select(self._pause()):
                    key.data()
        finally:
            for port in list(self._ports):
                self._drop(port)
            self._selector.close()
            self._wake_out.close()
            self._wake_in.close()
            self._released()

    def _released(self) -> None:
        """What a server has to close besides its ports."""

    def _pause(self) -> float:
        """Seconds until something has to be done even if no byte comes."""
        pauses = [_LOOK_UP]
        for port in self._ports:
            if len(port.outgoing) or len(port.incoming):
                pauses.append(_PACE)
            change = port.exchange.next_change()
            if change < float("inf"):
                wait = max(0.0, change - self.scope.clock.now())
                pauses.append(_VIRTUAL_POLL if self.scope.clock.virtual else wait)
        return min(pauses)

    def _read(self, port: Port) -> None:
        try:
            data = port.receive(_CHUNK)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(port)
        else:
            port.incoming.put(data, time.monotonic())

    def _serve(self, port: Port) -> None:
        """Pass on what has arrived, carry it out, and send what is ready."""
        if not self.scope.powered:
            self._drop(port)
            return
        now = time.monotonic()
        if len(port.outgoing) < _FULL and (arrived := port.incoming.take(now)):
            port.exchange.receive(arrived, now)
        if port.exchange.output_dropped:
            port.exchange.output_dropped = False
            port.outgoing.clear()
        self._skip_virtual_wait(port)
        port.exchange.pump()
        while (answer := port.exchange.take()) is not None:
            port.outgoing.put(answer, now)
        self._send(port, now)
        if port.exchange.closed and not len(port.outgoing):
            self._drop(port)

    def _skip_virtual_wait(self, port: Port) -> None:
        clock = self.scope.clock
        port.exchange.pump()
        if clock.virtual and port.exchange.next_change() < float("inf"):
            with self.scope.lock:
                clock.sleep(port.exchange.next_change() - clock.now() + 1e-9)

    def _send(self, port: Port, now: float) -> None:
        data = port.outgoing.take(now)
        if not data:
            return
        try:
            sent = port.send(data)
        except BlockingIOError:
            sent = 0
        except OSError:
            self._drop(port)
            return
        port.outgoing.put_back(data[sent:])
