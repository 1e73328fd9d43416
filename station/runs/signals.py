"""What ends a run from outside: Ctrl-C, SIGTERM, a closed terminal (SIGHUP).

The first signal ends what is being done, as soon as what must be done as a whole is done; a second one ends the
program at once, also where a library does not come back.
"""

import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from types import FrameType
from typing import Any

from station.errors import Stopped

_ENDING = tuple(int(getattr(signal, name)) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_HANG_UP = int(getattr(signal, "SIGHUP", 0))
_ONE_KEY_S = 0.05  # a key is passed on by programs that started this one: it comes twice within so long
_ONE_HANG_UP_S = (
    1.0  # a closed terminal tells the program, and so does its shell; a service manager sends two kinds
)


class _Signals:
    """The signals that came since a command began."""

    def __init__(self, *, second_ends: bool) -> None:
        self.held = 0
        self._second_ends, self._came, self._waiting = second_ends, 0, 0

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Raise, or keep for later what may not be disturbed."""
        if self._came and self._second_ends:
            return  # the watch ends the program, if it is not the same signal again
        self._came = number
        if self.held and not self._waiting:
            self._waiting = number
        else:
            raise _stop(number)

    def raise_waiting(self) -> None:
        """Raise what came while nothing was to be disturbed."""
        if self._waiting and not self.held:
            number, self._waiting = self._waiting, 0
            raise _stop(number)


def _stop(number: int) -> KeyboardInterrupt:
    return KeyboardInterrupt() if number == signal.SIGINT else Stopped(number)


_now: _Signals | None = None


@contextmanager
def ending_signals(*, second_ends: bool = True) -> Iterator[None]:
    """Let signals end what runs within, by raising :class:`station.errors.Stopped`."""
    global _now
    if threading.current_thread() is not threading.main_thread() or _now is not None:
        yield
        return
    signals = _now = _Signals(second_ends=second_ends)
    before: dict[int, Callable[[int, FrameType | None], Any] | int | signal.Handlers | None] = {}
    try:
        for number in _ENDING:
            ignored = signal.getsignal(number) is signal.SIG_IGN
            # nohup is obeyed; a program that a shell started in the background is to hear Ctrl-C all the same
            if not (ignored and number == _HANG_UP):
                before[number] = signal.signal(number, signals.handle)
        with _watch() if second_ends else nullcontext():
            yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        _now = None


@contextmanager
def undisturbed() -> Iterator[None]:
    """Do something as a whole: a signal that comes meanwhile raises when it is done."""
    signals = _now
    if signals is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    signals.held += 1
    try:
        yield
    finally:
        signals.held -= 1
        signals.raise_waiting()


@contextmanager
def disturbed() -> Iterator[None]:
    """Let signals raise again within what is otherwise not to be disturbed."""
    signals = _now
    if signals is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    held, signals.held = signals.held, 0
    try:
        signals.raise_waiting()
        yield
    finally:
        signals.held = held


def stop_from_within() -> None:
    """End this program as SIGTERM does, from any of its threads and on every system."""
    main_thread = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and main_thread is not None:
        signal.pthread_kill(main_thread, signal.SIGTERM)  # a call of the system that waits is disturbed, too
    else:
        signal.raise_signal(signal.SIGTERM)


@contextmanager
def _watch() -> Iterator[None]:
    """Have a thread count the signals: it ends the program also while the main one waits in a library."""
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    before = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    thread = threading.Thread(target=_count, args=(reader,), name="signals", daemon=True)
    thread.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        writer.close()
        thread.join()
        reader.close()


def _count(reader: socket.socket) -> None:
    first, first_at = 0, 0.0
    while numbers := reader.recv(64):
        for number in filter(_ENDING.__contains__, numbers):
            now = time.monotonic()
            same = _ONE_HANG_UP_S if _HANG_UP in (first, number) else _ONE_KEY_S
            if not first:
                first, first_at = number, now
            elif now - first_at > same:
                os._exit(128 + number)
