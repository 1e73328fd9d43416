"""The event codes of the family with their texts and our guesses; status registers and the event queue.

Source: programmer manual 071-1075-04, tables 3-3 to 3-9.
"""

from collections import deque
from enum import IntEnum


class Guess(IntEnum):
    """Which event a bad message causes, where no source says so. Correct these on a real instrument."""

    HEADER_IS_NOT_A_NAME = 110
    UNKNOWN_HEADER = 113
    COMMAND_HAS_NO_QUERY = 113
    QUERY_HAS_NO_COMMAND = 113
    QUERY_WITH_ARGUMENT = 108
    SURPLUS_ARGUMENT = 108
    MISSING_ARGUMENT = 104
    ARGUMENT_IS_EMPTY = 102
    STRING_IS_NOT_CLOSED = 102
    NUMBER_EXPECTED = 104
    STRING_EXPECTED = 104
    BLOCK_EXPECTED = 104
    UNKNOWN_WORD = 102  # as a TBS1072B posts it
    MEMORY_NUMBER_OUT_OF_RANGE = 222
    PICTURE_FORMAT_NOT_SIMULATED = 221
    FOLDER_NOT_EMPTY = 250
    FILE_IS_NO_SETUP = 253
    FILE_IS_NO_WAVEFORM = 253
    DATE_IS_NONE = 224
    INPUT_BUFFER = 1024  # bytes of a message that may wait behind a full output queue
    OUTPUT_QUEUE = 4096  # bytes of answers that may wait while the rest of the message is still coming
    DROPS_REST_OF_MESSAGE = (
        32  # status bit of events after which a message is not read on, but for unknown headers
    )
    TRIGGER_IGNORED = 0  # TRIGger FORCe outside READY: no event is known


class Refusal(Exception):
    """A command is not carried out: the event that the instrument posts instead."""

    def __init__(self, event: int) -> None:
        super().__init__(event)
        self.event = int(event)


_MEASUREMENT = {
    2200: "Measurement system error",
    2201: "Zero period",
    2202: "No period found",
    2203: "No period, second waveform",
    2204: "Low signal amplitude",
    2205: "Low amplitude, second waveform",
    2206: "Invalid gate",
    2207: "Measurement overflow",
    2208: "Waveform does not cross Mid Ref",
    2209: "No second Mid Ref crossing",
    2210: "No Mid Ref crossing, second waveform",
    2211: "No backwards Mid Ref crossing",
    2212: "No negative crossing",
    2213: "No positive crossing",
    2214: "No crossing",
    2215: "No crossing, second waveform",
    2216: "No crossing, target waveform",
    2217: "Constant waveform",
    2218: "Unused",
    2219: "No valid edge: No arm sample",
    2220: "No valid edge: No arm cross",
    2221: "No valid edge: No trigger cross",
    2222: "No valid edge: No second cross",
    2223: "Waveform mismatch",
    2224: "WAIT calculating",
    2225: "No waveform to measure",
    2228: "Positive Clipping",
    2229: "Negative Clipping",
    2230: "High Ref < Low Ref",
}

TEXTS = {
    0: "No events to report : queue empty",
    1: "No events to report : new events pending *ESR?",
    100: "Command error",
    102: "Syntax error",
    103: "Invalid separator",
    104: "Data type error",
    105: "GET not allowed",
    108: "Parameter not allowed",
    110: "Command header error",
    111: "Header separator error",
    112: "Program mnemonic too long",
    113: "Undefined header",
    161: "Invalid block data",
    200: "Execution error",
    201: "Invalid while in local",
    210: "Trigger error",
    211: "Trigger ignored",
    212: "Arm ignored",
    220: "Parameter error",
    221: "Settings conflict",
    222: "Data out of range",
    223: "Too much data",
    224: "Illegal parameter value",
    230: "Data corrupt or stale",
    240: "Hardware error",
    241: "Hardware missing",
    242: "Hardware configuration error",
    243: "Hardware I/O device error",
    250: "Mass storage error",
    251: "Missing mass storage",
    252: "Missing media",
    253: "Corrupt media",
    254: "Media full",
    255: "Directory full",
    256: "File name not found",
    257: "File name error",
    258: "Media protected",
    260: "Expression error",
    261: "Math error in expression",
    300: "Device-specific error",
    310: "System error",
    311: "Memory error",
    313: "Calibration memory lost",
    314: "Save/recall memory lost",
    315: "Configuration memory lost",
    350: "Queue overflow",
    361: "Parity error in program message",
    362: "Framing error in program message",
    363: "Input buffer overrun",
    400: "Query event",
    401: "Power on",
    402: "Operation complete",
    403: "User request",
    404: "Power fail",
    405: "Request control",
    410: "Query INTERRUPTED",
    420: "Query UNTERMINATED",
    430: "Query DEADLOCKED",
    440: "Query UNTERMINATED after indefinite response",
    500: "Execution warning",
    510: "String data too long, truncated",
    525: "Parameter underrange",
    526: "Parameter overrange",
    527: "Parameter rounded",
    528: "Parameter out of range",
    530: "Data start > stop, Values swapped internally",
    531: "Data stop > record length, Curve truncated",
    532: "Curve data too long, Curve truncated",
    540: "Measurement warning",
    541: "Measurement warning, Low signal amplitude",
    542: "Measurement warning, Unstable histogram",
    543: "Measurement warning, Low resolution",
    544: "Measurement warning, Uncertain edge",
    545: "Measurement warning, Invalid in minmax",
    546: "Measurement warning, Need 3 edges",
    547: "Measurement warning, Clipping positive/negative",
    548: "Measurement warning, Clipping positive",
    549: "Measurement warning, Clipping negative",
    600: "Internal warning",
    2226: "Null Waveform",
    2227: "Positive and Negative Clipping",
    2231: "Measurement not activated",
    2235: "Math error, Invalid math description",
    2241: "Waveform request is invalid",
    2242: "Data start > record length",
    2243: "Waveform requested is not a data source",
    2244: "Waveform requested is not turned on",
    2245: "Saveref error, Selected channel is turned off",
    2246: "Saveref error, Selected channel data invalid",
    2248: "Saveref error, Source reference data invalid",
    2260: "Calibration error",
    2301: "Cursor error, Off screen",
    2302: "Cursor error, Cursors are off",
    2303: "Cursor error, Cursor source waveform is off",
    **{code: f"Measurement error, {text}" for code, text in _MEASUREMENT.items()},
}

PON, URQ, CME, EXE, DDE, QYE, RQC, OPC = 128, 64, 32, 16, 8, 4, 2, 1


def status_bit(code: int) -> int:
    """Bit of the standard event status register that an event sets; 0 for those that set none, pp. 3-10 ff."""
    special = {401: PON, 402: OPC, 403: URQ, 404: DDE, 405: RQC, 400: QYE, 350: 0}
    if code in special:
        return special[code]
    for first, last, bit in (
        (100, 199, CME),
        (200, 299, EXE),
        (300, 399, DDE),
        (410, 449, QYE),
        (500, 599, EXE),
        (2200, 2399, EXE),
    ):
        if first <= code <= last:
            return bit
    return 0


# --------------------
# Status registers and event queue.
#
# Source: programmer manual 071-1075-04, pp. 3-1 to 3-9


QUEUE_LENGTH = 20
TEXT_LENGTH = 60  # message and command together, p. 2-110


class Status:
    """The standard event status register, its masks and the event queue."""

    # Events wait in the queue until `*ESR?` is read; only then `EVENT?`, `EVMsg?` and `ALLEv?` give them out, and
    # the next `*ESR?` drops what was not fetched.

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
        bit = status_bit(code)
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
        return code, TEXTS[code]

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
    """Text of an event with the offending command; a long command loses its beginning."""
    text = TEXTS[code] + "; "
    if not command or status_bit(code) != CME:
        return text
    room = max(0, TEXT_LENGTH - len(text))
    return text + (command[-room:] if room else "")
