"""The scope's event queue as exceptions: the answer to ``*ESR?;ALLEv?`` turned into typed events.

Programmer manual 071-1075-04, pp. 3-1 to 3-22.
"""

from __future__ import annotations

from instrument.errors import (
    CommandError,
    DeviceError,
    ExecutionError,
    QueryError,
    ScopeEvent,
    TransferError,
)
from instrument.scpi import integer, split_header, split_parts, unquote

POWER_ON = 128
"""Bit of the standard event status register: the scope was switched on since it was last read."""

ERROR_BITS = 32 | 16 | 8 | 4
"""Bits for command, execution, device and query errors."""

_NOTHING_TO_REPORT = (0, 1)
_PLAIN_EVENTS = (401, 402, 403)  # power on, operation complete, user request


def scope_event(code: int, text: str, advice: str = "") -> ScopeEvent:
    """The event as an exception of the class that its code belongs to."""
    if 100 <= code < 200:
        return CommandError(code, text, advice)
    if 300 <= code < 400 or code == 404:
        return DeviceError(code, text, advice)
    if code in (400, 410, 420, 430, 440):
        return QueryError(code, text, advice)
    if 200 <= code < 300 or 500 <= code < 600 or code >= 2200:
        return ExecutionError(code, text, advice)
    return ScopeEvent(code, text, advice)


def is_error(event: ScopeEvent) -> bool:
    """Whether something was refused; not for warnings (500 to 599) and plain news such as power on."""
    return event.code not in _PLAIN_EVENTS and not 500 <= event.code < 600


def parse_events(answer: str) -> list[ScopeEvent]:
    """Read the answer to ``ALLEv?``: ``<code>,"<text>; <command>"`` one after the other.

    >>> [(e.code, e.text) for e in parse_events('401,"Power on; "')]
    [(401, 'Power on')]
    """
    _, value = split_header(answer)
    words = split_parts(value, ",")
    if len(words) % 2:
        raise TransferError(f"the event list reads {answer[:60]!r}; ask again")
    found = []
    for code_text, text in zip(words[::2], words[1::2], strict=True):
        code = integer(code_text)
        if code not in _NOTHING_TO_REPORT:
            found.append(scope_event(code, unquote(text).rstrip(" ;")))
    return found


def raise_errors(found: list[ScopeEvent]) -> None:
    """Raise the first error among the events that an error bit was set for."""
    for event in found:
        if is_error(event):
            raise event
    if not found:
        raise scope_event(100, "an error without an entry in the queue")
