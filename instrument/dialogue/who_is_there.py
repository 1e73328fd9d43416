"""Asking who is there on a link, past whatever else comes first."""

from __future__ import annotations

from collections.abc import Callable

from instrument import scpi
from instrument.dialogue.identity import Identity, parse_identity
from instrument.dialogue.link import Link, NoAnswer
from instrument.errors import InstrumentError, LinkError, TransferError, WrongInstrument
from instrument.facts import POINTS

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
        """Read a stream up to the answer of a question that no earlier one can be mistaken for.

        Two identities are alike, so an identity alone does not tell that it is the last one under way. A marker
        asks for one setting several times over, and once more often for each marker that was not answered.
        """
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
