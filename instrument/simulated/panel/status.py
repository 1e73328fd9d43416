"""Status registers and event queue.

Source: programmer manual 071-1075-04, pp. 3-1 to 3-9.
"""

from __future__ import annotations

from collections import deque

from instrument.simulated.panel import event_table as events

QUEUE_LENGTH = 20
TEXT_LENGTH = 60  # message and command together, p. 2-110


class Status:
    """The standard event status register, its masks and the event queue.

    Events wait in the queue until `*ESR?` is read; only then `EVENT?`, `EVMsg?` and `ALLEv?` give them out,
    and the next `*ESR?` drops what was not fetched.
    """

    def __init__(self) -> None:
        self.esr_mask = 0  # *ESE
        self.service_mask = 0  # *SRE
        self.device_mask = 255  # DESE
        self.clear_masks_at_power_on = True  # *PSC
        self.clear()
        self.post(401)

    def power_on(self) -> None:
        """Empty everything; reset the masks when *PSC says so; report event 401."""
        self.clear()
        if self.clear_masks_at_power_on:
            self.esr_mask, self.service_mask, self.device_mask = 0, 0, 255
        self.post(401)

    def clear(self) -> None:
        """Empty the register and the queue (`*CLS`)."""
        self._register = 0
        self._new: deque[tuple[int, str]] = deque()
        self._readable: deque[tuple[int, str]] = deque()

    def post(self, code: int, command: str = "") -> None:
        """Record an event; one that DESE masks off leaves no trace."""
        bit = events.status_bit(code)
        if code == 0 or (bit and not bit & self.device_mask):
            return
        self._register |= bit
        if len(self._new) < QUEUE_LENGTH - 1:
            self._new.append((code, event_text(code, command)))
        elif len(self._new) == QUEUE_LENGTH - 1:
            self._new.append((350, event_text(350)))

    def read_esr(self) -> int:
        """Value of the register; clears it and makes the new events readable."""
        value, self._register = self._register, 0
        self._readable, self._new = self._new, deque()
        return value

    def status_byte(self, *, message_available: bool) -> int:
        """Status byte as `*STB?` gives it (bit 6 is MSS)."""
        summary = (32 if self._register & self.esr_mask else 0) | (16 if message_available else 0)
        return summary | (64 if summary & self.service_mask else 0)

    def next_event(self) -> tuple[int, str]:
        """Take the oldest readable event; code 0 or 1 says why there is none."""
        if self._readable:
            return self._readable.popleft()
        code = 1 if self._new else 0
        return code, events.TEXTS[code]

    def all_events(self) -> list[tuple[int, str]]:
        """Take all readable events, or the one that says there is none."""
        taken = [self.next_event()]
        while self._readable:
            taken.append(self._readable.popleft())
        return taken

    def count(self) -> int:
        """Number of readable events."""
        return len(self._readable)


def event_text(code: int, command: str = "") -> str:
    """Text of an event with the offending command; a long command loses its beginning.

    Examples
    --------
    >>> event_text(401), event_text(113, "FOO?")
    ('Power on; ', 'Undefined header; FOO?')
    """
    text = events.TEXTS[code] + "; "
    if not command or events.status_bit(code) != events.CME:
        return text
    room = max(0, TEXT_LENGTH - len(text))
    return text + (command[-room:] if room else "")
