"""Who may talk to the instrument: an exclusive lock, and a shared one that all have who know its string.

Source: IVI-6.1, version 1.1, section 6.5.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from enum import IntEnum


class LockAnswer(IntEnum):
    """Control code of the answer to a request or a release."""

    FAILURE = 0
    EXCLUSIVE = 1  # granted (of either kind), or the exclusive one released
    SHARED = 2  # the shared one released
    ERROR = 3


@dataclass
class _Request:
    client: Hashable
    key: bytes
    deadline: float


class Locks:
    """The locks of one instrument. Clients are anything hashable; the empty key asks for the exclusive lock.

    Examples
    --------
    >>> locks = Locks()
    >>> locks.request("a", b"", 0.0), locks.request("b", b"", 10.0), locks.may_talk("b")
    (<LockAnswer.EXCLUSIVE: 1>, None, False)
    >>> locks.release("a"), locks.settle(1.0), locks.may_talk("a")
    (<LockAnswer.EXCLUSIVE: 1>, [('b', <LockAnswer.EXCLUSIVE: 1>)], False)
    """

    def __init__(self) -> None:
        self._exclusive: Hashable | None = None
        self._shared: set[Hashable] = set()
        self._key = b""
        self._waiting: list[_Request] = []

    @property
    def exclusive(self) -> bool:
        """Whether somebody has the exclusive lock."""
        return self._exclusive is not None

    @property
    def holders(self) -> int:
        """Number of clients that hold a lock."""
        return len(self._shared | ({self._exclusive} if self.exclusive else set()))

    def may_talk(self, client: Hashable) -> bool:
        """Whether messages of a client are carried out now."""
        if self._exclusive is not None:
            return self._exclusive == client
        return not self._shared or client in self._shared

    def request(self, client: Hashable, key: bytes, deadline: float) -> LockAnswer | None:
        """Ask for a lock; None while it has to be waited for, until the deadline (s) at most."""
        if client == self._exclusive or (key and client in self._shared):
            return LockAnswer.ERROR
        if self._grant(client, key):
            return LockAnswer.EXCLUSIVE
        self._waiting.append(_Request(client, key, deadline))
        return None

    def release(self, client: Hashable) -> LockAnswer:
        """Give a lock back, the exclusive one first."""
        if self._exclusive == client:
            self._exclusive = None
            return LockAnswer.EXCLUSIVE
        if client in self._shared:
            self._shared.discard(client)
            return LockAnswer.SHARED
        return LockAnswer.ERROR

    def forget(self, client: Hashable) -> None:
        """A client is gone, and all of its locks and requests."""
        self._waiting = [request for request in self._waiting if request.client != client]
        self._shared.discard(client)
        if self._exclusive == client:
            self._exclusive = None

    def settle(self, now: float) -> list[tuple[Hashable, LockAnswer]]:
        """Grant what can be granted now (s), in the order of the requests, and refuse what is too late."""
        answers, still = [], []
        for request in self._waiting:
            if self._grant(request.client, request.key):
                answers.append((request.client, LockAnswer.EXCLUSIVE))
            elif now >= request.deadline:
                answers.append((request.client, LockAnswer.FAILURE))
            else:
                still.append(request)
        self._waiting = still
        return answers

    def next_deadline(self) -> float:
        """Time (s) at which the first request is too late; inf without one."""
        return min((request.deadline for request in self._waiting), default=float("inf"))

    def _grant(self, client: Hashable, key: bytes) -> bool:
        if self._exclusive is not None:
            return False
        if not key:
            if self._shared and client not in self._shared:
                return False
            self._exclusive = client
            return True
        if self._shared and key != self._key:
            return False
        self._key = key
        self._shared.add(client)
        return True
