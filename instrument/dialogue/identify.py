"""Who is there on a link: `*IDN?` past whatever else comes first, the model, the event queue as exceptions."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from instrument import scpi
from instrument.dialogue.link import Link, NoAnswer
from instrument.errors import (
    CommandError,
    DeviceError,
    ExecutionError,
    InstrumentError,
    LinkError,
    QueryError,
    ScopeEvent,
    TransferError,
    WrongInstrument,
)
from instrument.scpi import POINTS, integer, split_header, split_parts, unquote

LINE_END = ":RS232:TRANSMIT:TERMINATOR"
_MARKER = ":HEADER?"


class WhoIsThere:
    """The question ``*IDN?`` on one link."""

    def __init__(self, link: Link, send: Callable[[str], str]) -> None:
        self._link, self._send = link, send
        self._identity_due = False
        """Whether an answer to an earlier ``*IDN?`` may still come."""
        self._markers_due = 0

    def ask(self) -> Identity:
        """Ask ``*IDN?`` and read until an identity comes: on a stream, older lines may come first."""
        in_doubt, self._identity_due = self._identity_due, True
        mark = self._send("*IDN?")
        clock = self._link.clock
        began, longest = clock.now(), self._link.answer_time + self._link.line_time(2 * POINTS)
        problem: InstrumentError | None = None
        while problem is None or (not self._link.framed and clock.now() - began < longest):
            try:
                text = self._link.read_text(longest=8192)
                if mark:
                    text = ";".join(scpi.without_mark(scpi.split_parts(text), mark))
                identity = parse_identity(text)
            except (WrongInstrument, TransferError) as error:
                if problem is None and isinstance(error, TransferError) and self._link.is_serial:
                    # Text without a line feed: perhaps the scope is set to end its answers with CR alone. But it
                    # may as well be a late record: then both questions are answered.
                    self._link.write(f"{LINE_END} LF")
                    mark = self._send("*IDN?")
                    in_doubt = True
                problem = error
            except NoAnswer:
                # Silence after a line that was not an identity: that line was the answer.
                if problem is None:
                    raise
                break
            else:
                if in_doubt and not self._link.framed and not mark:
                    self._read_to_marker()
                self._identity_due = False
                return identity
        raise problem

    def _read_to_marker(self) -> None:
        """Read a stream up to the answer of a question that no earlier one can be mistaken for."""
        # Two identities are alike, so an identity alone does not tell that it is the last one under way. A marker
        # asks for one setting several times over, and once more often for each marker that was not answered.
        self._markers_due += 1
        parts = 1 + self._markers_due
        self._link.write(";".join([_MARKER] * parts))
        values: list[str] = []
        while len(values) != parts or set(values) - {"0", "1"}:
            line = self._link.read_text(longest=8192)
            values = [scpi.split_header(part)[1] for part in scpi.split_parts(line)]
        self._markers_due = 0


def nobody_known(link: Link, error: InstrumentError, attempts: int) -> InstrumentError:
    """Return the error that ends the greeting on a link after so many attempts, with what to do about it."""
    speed = f", and its speed {link.baud_rate} baud" if link.is_serial else ""
    if isinstance(error, TransferError):
        times = f"{attempts} times " if attempts > 1 else ""
        return TransferError(
            f"{link.name}: what came after *IDN? is no answer of an oscilloscope, {times}"
            f"({str(error).removesuffix('; ask again')}): check that the name is the oscilloscope's{speed}"
        )
    if isinstance(error, NoAnswer):
        more = f" ({attempts} times)" if attempts > 1 else ""
        return LinkError(
            f"{error}{more}: check that it is switched on and connected, and that the name is right{speed}"
        )
    return error


# --------------------
# Which oscilloscope is it: the answer to ``*IDN?`` and what the model name says about the unit


FAMILY = "TDS1000/TDS2000 (also B and C), TPS2000 or TBS1000 (also B)"

# A blank stands between letters and number in *IDN?, and none in the files that the scopes write.
# TBS1000C and TBS2000 are other scopes: longer records, other commands.
_FAMILY_MODEL = re.compile(r"(TDS|TPS) ?[12]\d{3}[BC]?|TBS ?1\d{3}B?(-EDU)?")


@dataclass(frozen=True)
class Identity:
    """The parts of ``*IDN?``.

    Attributes
    ----------
    manufacturer, model, serial, firmware : str
        For example ``TEKTRONIX``, ``TDS 2014``, ``0``, ``CF:91.1CT FV:v4.12 TDS2CM:CMV:v1.04``. The first
        series and the TPS send ``0`` for a serial number.
    text : str
        The answer as it came.
    """

    manufacturer: str
    model: str
    serial: str
    firmware: str
    text: str

    @property
    def channel_count(self) -> int:
        """4 for models whose number ends in 4, else 2."""
        return 4 if re.sub(r"\D", "", self.model).endswith("4") else 2

    def same_unit(self, other: Identity) -> bool:
        """Whether both are of one unit: by serial number, or where the series has none, by the whole answer."""
        if self.serial.strip("0") and other.serial.strip("0"):
            return (self.model, self.serial) == (other.model, other.serial)
        return self.text == other.text


def parse_identity(answer: str) -> Identity:
    """Read ``*IDN?`` and check that the unit is of this family."""
    parts = [part.strip() for part in answer.strip().split(",", 3)]
    if len(parts) == 4 and parts[0].upper() == "TEKTRONIX" and _FAMILY_MODEL.fullmatch(parts[1].upper()):
        manufacturer, model, serial, firmware = parts
        return Identity(manufacturer, model, serial, firmware, answer.strip())
    raise WrongInstrument(
        f"the instrument calls itself {answer.strip()[:80]!r}, which is not a Tektronix {FAMILY}; "
        "check the resource name"
    )


# --------------------
# The scope's event queue as exceptions: the answer to ``*ESR?;ALLEv?`` turned into typed events.
#
# Programmer manual 071-1075-04, pp. 3-1 to 3-22


POWER_ON = 128  # bit of the standard event status register: the scope was switched on since it was last read
ERROR_BITS = 32 | 16 | 8 | 4  # bits for command, execution, device and query errors

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
    """Read the answer to ``ALLEv?``: ``<code>,"<text>; <command>"`` one after the other."""
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
