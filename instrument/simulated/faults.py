"""What can go wrong on demand: faults of the instrument, of its link, and of people near it."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

FaultKind = Literal[
    "late answer",
    "lost byte",
    "inserted byte",
    "changed byte",
    "repeated answer",
    "lost message",
    "cut answer",
    "wrong block length",
    "garbage",
    "lost answer",
    "link closed",
    "power off",
    "power cycle",
    "knob turned",
    "knob turned within",
    "parity error",
    "framing error",
    "input overrun",
]
_INPUT_ERRORS = {"parity error": 361, "framing error": 362, "input overrun": 363}
_ON_INPUT = (*_INPUT_ERRORS, "lost message")
_WITHIN = "knob turned within"
_BLOCK_LENGTH = re.compile(rb"#([1-9])(\d+)")


@dataclass(frozen=True)
class Fault:
    """One fault and the answers that it meets."""

    # one of FaultKind. "link closed" and "power off" happen after the first `bytes_sent` bytes of the answer. A
    # knob is turned behind an answer, or "within" a message, before a query of it. A locked panel has no knobs.
    kind: FaultKind
    # number of the answer, counted from 1 since the fault was added. None: any answer. A "lost message" and errors
    # of the RS-232 input ("parity error" and the two after it) count the pieces received instead, a knob turned
    # within messages counts queries.
    answer: int | None = None
    probability: float = 1.0  # chance that an answer that fits is hit
    # only answers that hold this, for instance b"#42500"; within messages, only queries that hold it
    in_answer: bytes = b""
    shortest: int = 0  # only answers with at least so many bytes: 1000 picks the curves
    bytes_sent: int | None = None  # where the answer is hit; None: anywhere in it
    seconds: float = 1.0  # delay of a late answer
    command: str = ""  # what the hand on the knob does, as a program message: `"CH1:SCALE 2"`


@dataclass(frozen=True)
class Delivery:
    """An answer on its way: its bytes, when it leaves, and what happens to the link after it."""

    data: bytes
    due: float = 0.0
    closes_link: bool = False
    power: Literal["", "off", "cycle"] = ""
    command: str = ""


class Faults:
    """The faults of one instrument; change the attributes at any time, also while it is served."""

    def __init__(self, *faults: Fault, seed: int = 0) -> None:
        self.stuck_busy = False  # BUSY? answers 1 and *OPC? nothing for ever
        self.no_trigger = False  # the trigger never comes (NORMAL waits, AUTO runs free)
        self.identity: str | None = None  # another unit answers `*IDN?` with this
        # on RS-232 the cable or the program heeds neither RTS nor XOFF, so that bursts overrun the input
        self.no_flow_control = False
        self.unplugged = False  # no byte arrives on either side, and nobody is told
        self.hung = False  # everything is taken in and nothing carried out
        self.happened: list[Fault] = []
        self._rng = np.random.default_rng([seed, 0xFA17])
        self._armed: list[tuple[Fault, int]] = []
        self._count = self._inputs = self._queries = 0
        self.add(*faults)

    def add(self, *faults: Fault) -> None:
        """Arm more faults; their answers count from here."""
        for fault in faults:
            counted = self._inputs if fault.kind in _ON_INPUT else self._count
            self._armed.append((fault, self._queries if fault.kind == _WITHIN else counted))

    def clear(self) -> None:
        """Heal everything."""
        self._armed.clear()
        self.stuck_busy = self.no_trigger = self.no_flow_control = self.unplugged = self.hung = False
        self.identity = None

    @property
    def armed(self) -> Sequence[Fault]:
        """The faults that may still happen."""
        return [fault for fault, _ in self._armed]

    def input_error(self, data: bytes) -> int:
        """Event that bytes from an RS-232 line cause, or 0."""
        for entry in self._armed:
            fault, since = entry
            if fault.kind in _INPUT_ERRORS and self._hits(fault, self._inputs - since, data):
                self._note(entry)
                return _INPUT_ERRORS[fault.kind]
        return 0

    def swallows(self, data: bytes) -> bool:
        """Whether bytes that were sent never arrive."""
        self._inputs += 1
        for entry in self._armed:
            fault, since = entry
            if fault.kind == "lost message" and self._hits(fault, self._inputs - since, data):
                self._note(entry)
                return True
        return self.unplugged

    def hand(self, query: bytes) -> str:
        """Command that a hand on the front panel gives just before a query, or ""."""
        self._queries += 1
        for entry in self._armed:
            fault, since = entry
            if fault.kind == _WITHIN and self._hits(fault, self._queries - since, query):
                self._note(entry)
                return fault.command
        return ""

    def deliver(self, answer: bytes, now: float) -> Delivery:
        """What becomes of an answer."""
        self._count += 1
        for entry in self._armed:
            fault, since = entry
            spoils = fault.kind not in _ON_INPUT and fault.kind != _WITHIN
            if spoils and self._hits(fault, self._count - since, answer):
                self._note(entry)
                return self._spoil(fault, answer, now)
        return Delivery(answer, now)

    def _note(self, entry: tuple[Fault, int]) -> None:
        """Remember what happened; a fault with a number happens once."""
        self.happened.append(entry[0])
        if entry[0].answer is not None:
            self._armed.remove(entry)

    def _hits(self, fault: Fault, number: int, answer: bytes) -> bool:
        if fault.answer is not None and number != fault.answer:
            return False
        if fault.in_answer not in answer or len(answer) < fault.shortest:
            return False
        return fault.probability >= 1 or bool(self._rng.random() < fault.probability)

    def _spoil(self, fault: Fault, answer: bytes, now: float) -> Delivery:
        where = fault.bytes_sent
        at = int(self._rng.integers(len(answer))) if where is None else min(where, len(answer) - 1)
        match fault.kind:
            case "late answer":
                return Delivery(answer, now + fault.seconds)
            case "lost byte":
                return Delivery(answer[:at] + answer[at + 1 :], now)
            case "inserted byte":
                return Delivery(answer[:at] + self._rng.bytes(1) + answer[at:], now)
            case "changed byte":
                other = (answer[at] + int(self._rng.integers(1, 256))) % 256
                return Delivery(answer[:at] + bytes([other]) + answer[at + 1 :], now)
            case "repeated answer":
                return Delivery(answer + answer, now)
            case "cut answer":
                return Delivery(answer[:at] + answer[-1:], now)
            case "wrong block length":
                return Delivery(_BLOCK_LENGTH.sub(self._other_length, answer, count=1), now)
            case "garbage":
                return Delivery(self._rng.bytes(len(answer)), now)
            case "lost answer":
                return Delivery(b"", now)
            case "link closed":
                return Delivery(answer[:at], now, closes_link=True)
            case "power off":
                return Delivery(answer[:at], now, closes_link=True, power="off")
            case "power cycle":
                return Delivery(answer[:at], now, closes_link=True, power="cycle")
            case "knob turned":
                return Delivery(answer, now, command=fault.command)
            case "parity error" | "framing error" | "input overrun" | "knob turned within" | "lost message":
                return Delivery(answer, now)  # they spoil what comes in

    def _other_length(self, match: re.Match[bytes]) -> bytes:
        width = int(match[1])
        digits, rest = match[2][:width], match[2][width:]
        wrong = (int(digits) + int(self._rng.choice([-1, 1, 7]))) % 10**width
        return b"#" + match[1] + str(wrong).zfill(width).encode() + rest
