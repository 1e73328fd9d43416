"""Serves a simulated instrument on byte streams: the loop, the terminals and the sockets that all share."""

import contextlib
import errno
import os
import selectors
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Self

CHUNK = 65_536  # bytes that are read at once
LOOK_UP = 0.2  # seconds after which an idle server looks whether its instrument is still on
FULL = 1 << 20  # bytes of unread answers at which no more questions are taken
_CLIENTS = 16  # connections at once on one server
_IDLE_S = 60.0  # of silence, after which a connection gives way to a new one
_UNTAKEN = 4 * CHUNK  # bytes of a client that have not been taken yet, at which it is not listened to
_NO_DESCRIPTOR = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
_DEAF_S = 1.0  # after the system had no descriptor left for a client
_LATE = 0.05  # s that a paced line may be behind and still catch up


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

    def take(self, now: float, most: int = CHUNK) -> bytes:
        """The bytes that have passed by now (s), at most so many."""
        if self.baud_rate is None:
            count = min(len(self._held), most)
        else:
            rate = self.baud_rate / 10  # bytes a second: start bit, 8 data bits, stop bit
            count = min(int((now - self._free_at) * rate + 1e-6), len(self._held), most)
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


@dataclass(eq=False)
class Port:
    """One open stream to one client, and what is under way on it."""

    descriptor: int
    receive: Callable[[int], bytes]
    send: Callable[[bytes], int]
    close: Callable[[], None]
    incoming: Line = field(default_factory=Line)
    outgoing: Line = field(default_factory=Line)
    heard: bool = True
    heard_at: float = field(default_factory=time.monotonic)  # when the last byte of it came


class StreamServer(ABC):
    """Runs a thread that moves bytes between clients and an instrument, until it is closed."""

    def __init__(self) -> None:
        self.error: BaseException | None = None
        self.ended = threading.Event()
        self._selector = selectors.DefaultSelector()
        self._ports: list[Port] = []
        self.clients, self.idle_s = _CLIENTS, _IDLE_S
        self._held = contextlib.ExitStack()  # what is open besides the ports
        self._closing = False
        self._listener: socket.socket | None = None
        self._deaf_until = 0.0
        self._wake_out, self._wake_in = socket.socketpair()  # Windows selects on sockets only
        self._selector.register(self._wake_out, selectors.EVENT_READ, lambda: self._wake_out.recv(64))
        self._thread = threading.Thread(target=self._run, name=type(self).__name__, daemon=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Hang up and stop; a second call does nothing. Raises what ended the thread before, if something did."""
        if self._closing:
            return
        self._closing = True
        self._wake()
        self._thread.join()
        if self.error is not None:
            raise self.error

    # What an instrument does

    @abstractmethod
    def _serve(self, port: Port) -> None:
        """Take what has arrived from a client, and send what is ready; called again and again."""

    @abstractmethod
    def _pause(self) -> float:
        """Seconds until something has to be done even if no byte comes."""

    def _advance(self) -> None:
        """Do what is to be done now, whether there is a client or not."""
        for port in list(self._ports):
            self._serve(port)

    def _welcomes(self) -> bool:
        """Whether one more client may connect now."""
        return True

    def _make_room(self) -> bool:
        """Hang up on the client that has been silent longest, and for long; tell whether there is one."""
        longest = min(self._ports, key=self._heard_at, default=None)
        if longest is None or time.monotonic() - self._heard_at(longest) < self.idle_s:
            return False
        self._drop(longest)
        return True

    def _heard_at(self, port: Port) -> float:
        """When the client of a port was heard for the last time."""
        return port.heard_at

    def _add(self, port: Port) -> None:
        """A client is there."""
        self._ports.append(port)
        self._selector.register(port.descriptor, selectors.EVENT_READ, self._hearing(port))

    def _drop(self, port: Port) -> None:
        """A client is gone, or has to go."""
        if port in self._ports:
            self._ports.remove(port)
            if port.heard:
                self._selector.unregister(port.descriptor)
            port.close()

    # Transports

    def _open_terminal(self) -> str:
        """Serve on a pseudo-terminal; gives the device. OSError if this system has none (Windows)."""
        try:
            import tty
        except ImportError:
            self._release()
            raise OSError("this system has no pseudo-terminals; serve the instrument on TCP instead") from None
        master, slave = os.openpty()
        self._held.callback(os.close, slave)  # stays open, so that clients may come and go
        tty.setraw(slave)  # no echo, no line editing, no characters with a meaning of their own
        os.set_blocking(master, False)
        self._add(
            Port(
                master,
                receive=lambda count: os.read(master, count),
                send=lambda data: os.write(master, data),
                close=lambda: os.close(master),
            )
        )
        return os.ttyname(slave)

    def _listen(self, host: str, port: int) -> tuple[str, int]:
        """Serve on a TCP port, 0 takes any free one; gives host and port. OSError if it cannot be had."""
        try:
            listener = self._held.enter_context(socket.create_server((host, port)))
        except OSError:
            self._release()
            raise
        listener.setblocking(False)
        self._listener = listener
        self._selector.register(listener, selectors.EVENT_READ, lambda: self._accept(listener))
        name: tuple[str, int] = listener.getsockname()[:2]
        return name

    def _accept(self, listener: socket.socket) -> None:
        try:
            client, _ = listener.accept()
        except OSError as error:
            if error.errno in _NO_DESCRIPTOR:
                # the client waits in its queue, and the selector would not wait at all
                self._selector.unregister(listener)
                self._deaf_until = time.monotonic() + _DEAF_S
            return
        full = len(self._ports) >= self.clients and not self._make_room()
        if full or not self._welcomes():
            with contextlib.suppress(OSError):
                client.send(f"{self.clients} connections are open: close one\n".encode() if full else b"")
            client.close()
            return
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._add(Port(client.fileno(), _acknowledging(client), client.send, client.close))

    # The loop

    def _wake(self) -> None:
        with contextlib.suppress(OSError):  # the thread may have ended by itself
            self._wake_in.send(b"x")

    def _run(self) -> None:
        try:
            while not self._closing:
                self._advance()
                self._listen_again()
                for key, _ in self._selector.select(self._pause()):
                    key.data()
        except BaseException as error:
            self.error = error
        finally:
            for port in list(self._ports):
                self._drop(port)
            self._release()
            self.ended.set()

    def _listen_again(self) -> None:
        """Listen to those that were not listened to, where there is room now; and not to others."""
        if self._deaf_until and self._listener is not None and time.monotonic() >= self._deaf_until:
            self._deaf_until, listener = 0.0, self._listener
            self._selector.register(listener, selectors.EVENT_READ, lambda: self._accept(listener))
        for port in self._ports:
            room = len(port.incoming) < _UNTAKEN
            if room and not port.heard:
                self._selector.register(port.descriptor, selectors.EVENT_READ, self._hearing(port))
            elif port.heard and not room:
                self._selector.unregister(port.descriptor)
            port.heard = room

    def _hearing(self, port: Port) -> Callable[[], None]:
        return lambda: self._read(port)

    def _release(self) -> None:
        self._held.close()
        self._selector.close()
        self._wake_out.close()
        self._wake_in.close()

    def _read(self, port: Port) -> None:
        try:
            data = port.receive(CHUNK)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            port.heard_at = time.monotonic()
            port.incoming.put(data, port.heard_at)
        else:
            self._drop(port)

    def _send(self, port: Port, now: float) -> None:
        """Send what the line to a client lets pass by now (s)."""
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


def _acknowledging(client: socket.socket) -> Callable[[int], bytes]:
    """Receive, and acknowledge at once where the system can: who writes twice would wait 40 ms for it."""
    at_once = getattr(socket, "TCP_QUICKACK", None)
    if at_once is None:
        return client.recv

    def receive(count: int) -> bytes:
        data = client.recv(count)
        with contextlib.suppress(OSError):  # hung up meanwhile: what came is there all the same
            client.setsockopt(socket.IPPROTO_TCP, at_once, 1)  # holds until the next one only
        return data

    return receive
