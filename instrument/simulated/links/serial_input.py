"""The RS-232 input of the communications module: flow control, and what happens without it.

With hard flagging the unit holds the computer back by RTS, with soft flagging by XOFF, and nothing is lost. A
program or a cable that heeds neither sends faster than the processor fetches the bytes: a burst overruns the
input (event 363), all input and output is dropped, and the unit is deaf for the rest of the burst. Sent one by
one, 50 ms apart, all bytes arrive. Source: programmer manual 071-1075-04, pp. 2-186 to 2-189 and 3-8.
"""

from __future__ import annotations

from instrument.simulated.faults import Faults
from instrument.simulated.panel.panel import Panel

XON, XOFF = 0x11, 0x13
OVERRUN = 363
READ_TIME = 0.02  # s that the processor needs for a byte without flow control (a guess; 50 ms are enough)
HELD_BYTES = 4  # bytes that wait for it (a guess; `*IDN?` in one burst is too long)


class SerialInput:
    """What becomes of bytes on their way from the line into the input buffer."""

    def __init__(self, panel: Panel, faults: Faults) -> None:
        self._panel, self._faults = panel, faults
        self.clear()

    def clear(self) -> None:
        """Forget what is under way."""
        self.output_stopped = False
        self._deaf = False
        self._arrived_at = self._idle_at = 0.0

    def receive(self, data: bytes, now: float) -> tuple[bytes, int]:
        """Pass bytes on."""
        event = self._faults.input_error(data)
        if event:
            return b"", event
        soft = self._panel.flag("RS232:SOFTFLAGGING")
        if not self._faults.no_flow_control and (soft or self._panel.flag("RS232:HARDFLAGGING")):
            return self._without_flow_characters(data) if soft else data, 0
        return self._unprotected(data, now)

    def _without_flow_characters(self, data: bytes) -> bytes:
        """Obey and take out XON and XOFF, also those that were meant as data."""
        for byte in data:
            if byte in (XON, XOFF):
                self.output_stopped = byte == XOFF
        return data.translate(None, bytes((XON, XOFF)))

    def _unprotected(self, data: bytes, now: float) -> tuple[bytes, int]:
        """Bytes that come whether the processor has time or not."""
        received, event = bytearray(), 0
        byte_time = 10 / self._panel.number("RS232:BAUD")
        self._arrived_at = max(self._arrived_at, now)
        for byte in data:
            self._arrived_at += byte_time
            if self._arrived_at >= self._idle_at:
                self._deaf = False
            elif self._deaf or self._idle_at - self._arrived_at > HELD_BYTES * READ_TIME:
                received.clear()
                event = event if self._deaf else OVERRUN
                self._deaf = True
                continue
            self._idle_at = max(self._idle_at, self._arrived_at) + READ_TIME
            received.append(byte)
        return bytes(received), event
