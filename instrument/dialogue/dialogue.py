"""A dialogue with one scope that stays in step: questions, records, events, and recovery after a fault.

The driver speaks with headers off and takes curves as signed bytes. Both are set when the dialogue begins
and put back as found when it ends.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator

from instrument import scpi
from instrument.dialogue.events import ERROR_BITS, POWER_ON, is_error, parse_events, scope_event
from instrument.dialogue.identity import Identity, parse_identity
from instrument.dialogue.link import Link, NoAnswer
from instrument.dialogue.record_question import PREAMBLE_FIELDS, RecordQuestion
from instrument.errors import (
    InstrumentError,
    LinkError,
    QueryError,
    ScopeEvent,
    TransferError,
    WrongInstrument,
)
from instrument.facts import POINTS
from instrument.waveform import Waveform

_FORMAT_QUERY = ":HEADER?;:VERBOSE?;:DATA:ENCDG?;:DATA:SOURCE?;:DATA:START?;:DATA:STOP?;:DATA:WIDTH?"
_OUR_FORMAT = f":HEADER OFF;:VERBOSE ON;:DATA:ENCDG RIBINARY;:DATA:WIDTH 1;:DATA:START 1;:DATA:STOP {POINTS}"
_LINE_END = ":RS232:TRANSMIT:TERMINATOR"
_SOFT_FLAGGING = ":RS232:SOFTFLAGGING"
_HARD_FLAGGING = ":RS232:HARDFLAGGING"
_MARKER = ":HEADER?"


class Dialogue:
    """Questions and answers with one scope over an open link.

    Parameters
    ----------
    link : Link
        Open link; the dialogue closes it.

    Raises
    ------
    LinkError, WrongInstrument
        If nothing, or the wrong instrument, answers.
    """

    def __init__(self, link: Link) -> None:
        self.link = link
        self.source: str | None = None
        """Source that ``DATa:SOUrce`` names now, None if not known."""
        self._confirmed: dict[str, str] = {}
        self._recovering = False
        self._answer_due = False
        self._identity_due = False
        """Whether an answer to an earlier ``*IDN?`` may still come."""
        self._markers_due = 0
        self.unread_events = False
        """Whether a question of the user's may have left events that are not about the next record."""
        if self.link.is_serial or self.link.framed:
            self.link.clear()
        self.identity = self._identify()
        self._found_line = self._set_line()
        found = [scpi.split_header(part)[1] for part in self.ask(_FORMAT_QUERY, parts=7)]
        header, verbose, encoding, source, start, stop, width = found
        self._found_format = (
            f":DATA:ENCDG {encoding};:DATA:SOURCE {source};:DATA:START {start};:DATA:STOP {stop};"
            f":DATA:WIDTH {width};:VERBOSE {verbose};:HEADER {header}"
        )
        self.set_format()

    def close(self) -> None:
        """Put headers and transfer format back as found, and close the link whatever happens."""
        if self.link.closed:
            return
        try:
            self.command(self._found_format)
            if self._found_line:
                # An answer could not be read any more, so nothing is asked.
                self.link.write(self._found_line)
        finally:
            self.link.close()

    def set_format(self) -> None:
        """Headers off, signed bytes, whole record; older events are dropped, they are not about us."""
        self.source = None
        self._confirmed.clear()
        self.ask(f"{_OUR_FORMAT};*CLS;*ESR?")

    # ------------------------------------------------------------------ questions

    def ask(self, text: str, *, parts: int | None = 1, wait: float = 0.0) -> list[str]:
        """Send one message with `parts` queries in it and return their answers (None: any number).

        Raises
        ------
        ScopeEvent
            If the scope refused a query (it then sends nothing at all).
        TransferError
            If the answer was damaged; the dialogue is in step again.
        LinkError
            If the scope answers nothing any more.
        """
        try:
            with self._exchange():
                self.link.write(text)
                found = scpi.split_parts(self.link.read_text(wait=wait, longest=16_384))
            if parts is not None and len(found) != parts:
                raise TransferError(
                    f"{parts} answers to {text!r} were expected, but {found!r:.80} came; ask again"
                )
        except NoAnswer as silence:
            raise self.explain_silence(text, silence) from None
        except TransferError as error:
            raise self.after_damage(error) from error
        return found

    def command(self, text: str) -> None:
        """Send commands and check in the same exchange that the scope took them."""
        self.checked(f"{text};*ESR?", parts=0)

    def checked(self, text: str, *, parts: int) -> list[str]:
        """Send a message that ends with ``*ESR?``; return its other answers if no error bit is set."""
        *answers, register = self.ask(text, parts=parts + 1)
        if self._integer(register) & ERROR_BITS:
            self._raise_errors(self._read_event_queue())
        return answers

    def ask_with_events(self, text: str, *, parts: int, wait: float = 0.0) -> tuple[list[str], list[ScopeEvent]]:
        """As `ask`; besides, every event that the message caused, warnings too."""
        clean = "*CLS;" if self.unread_events else ""
        self.unread_events = False
        *answers, register = self.ask(f"{clean}{text};*ESR?", parts=parts + 1, wait=wait)
        return answers, self._read_event_queue() if self._integer(register) & ERROR_BITS else []

    def picture(self, *, wait: float) -> bytes:
        """Let the scope send the picture of its screen and return the BMP file; errors as `ask`."""
        try:
            with self._exchange():
                self.link.write(":HARDCOPY START")
                picture = self.link.read_bitmap(wait=wait)
        except NoAnswer as silence:
            raise self.explain_silence("HARDCopy STARt", silence) from None
        except TransferError as error:
            raise self.after_damage(error) from error
        return picture

    def records(
        self, commands: str, sources: tuple[str, ...], *, wait: float = 0.0, afterwards: str = ""
    ) -> tuple[Waveform, ...]:
        """Send commands and ask for the records of `sources`, all in one message.

        The status register is asked for with them, so that a command that was lost or refused on its way cannot
        pass an old record off as a new one. A preamble that differs from the last one of its source is
        asked for a second time, because a lost digit in it could not be noticed otherwise. Of several sources
        the scope tells before and after them that it is stopped: then they are of one acquisition.

        Parameters
        ----------
        commands, afterwards : str
            Commands before and behind the records, without a ``;`` at either end.
        sources : tuple of str
            What to read, in this order.
        wait : float
            Time in s that the commands may take.

        Raises
        ------
        NoAnswer
            If nothing came in time: the caller knows what it waited for.
        ExecutionError
            If a source is not displayed.
        SettingError
            If the scope acquires on, so that several sources would not be of one acquisition.
        TransferError
            If a record is damaged, or is not in the format asked for; it has been set again.
        """
        clean = "*CLS" if self.unread_events else ""
        self.unread_events = False
        wanted = RecordQuestion(sources, selected=self.source)
        message = ";".join(filter(None, (clean, commands, "*ESR?", wanted.text, afterwards)))
        try:
            with self._exchange():
                self.link.write(message)
                self.source = None
                answer = self.link.read_blocks(blocks=len(sources), wait=wait, longest=2 * POINTS)
            register, texts, curves = wanted.split(*answer)
            self._check_register(register)
            missing = wanted.not_displayed(texts)
            if missing is not None:
                self._raise_not_displayed(missing)
            waveforms = wanted.decode(texts, curves)
        except TransferError as error:
            raise self.after_damage(error) from error
        self.source = sources[-1]
        new = {name: text for name, text in zip(sources, texts, strict=True) if self._confirmed.get(name) != text}
        if new:
            self._confirm(new)
        return waveforms

    def events(self) -> list[ScopeEvent]:
        """Read and empty the event queue."""
        self.ask("*ESR?")
        return self._read_event_queue()

    # ------------------------------------------------------------------ getting back into step

    def resynchronise(self) -> None:
        """Clear the link, make sure that the same scope still answers, and set our format again.

        Raises
        ------
        LinkError, WrongInstrument
            If it does not.
        """
        self.link.clear()
        identity = self._identify()
        if identity.text != self.identity.text:
            identity = self._identify()  # damage on the way does not strike twice alike
        if identity.text != self.identity.text:
            raise WrongInstrument(
                f"another instrument answers on {self.link.name} now: {identity.text!r} instead of "
                f"{self.identity.text!r}; connect again"
            )

    def resynchronise_or_raise(self, silence: NoAnswer) -> None:
        """Get back into step after a wait that brought nothing; LinkError if the scope is gone."""
        try:
            with self._recovery():
                self.resynchronise()
                self.set_format()
        except NoAnswer:
            raise LinkError(f"{silence}, and to *IDN? neither; is it switched on and connected?") from None

    def explain_silence(self, text: str, silence: NoAnswer) -> InstrumentError:
        """Find out why nothing came; returns the scope's own event if there is one, else the best guess."""
        if self._recovering:
            return silence
        try:
            with self._recovery():
                self.resynchronise()
                found = self.events()
                self.set_format()
        except NoAnswer:
            return LinkError(f"{silence}, and to *IDN? neither; is it switched on and connected?")
        except InstrumentError as error:
            return error
        # Event 420 only says that we read where nothing was sent; the other one names the cause.
        causes = [event for event in found if is_error(event) and not isinstance(event, QueryError)]
        if causes:
            return causes[0]
        if any(event.code == 401 for event in found):
            return TransferError(f"the scope was switched off and on while {text!r} was asked; ask again")
        return TransferError(f"no answer to {text!r} came, though the scope is there; ask again")

    def after_damage(self, error: TransferError) -> InstrumentError:
        """Get back into step after a damaged answer; returns the error to raise."""
        if self._recovering:
            return error
        try:
            with self._recovery():
                self.resynchronise()
                self.set_format()
        except NoAnswer:
            return LinkError(f"{error}; after that the scope answered nothing any more: is it switched on?")
        except InstrumentError as worse:
            return worse
        return error

    @contextlib.contextmanager
    def _exchange(self) -> Iterator[None]:
        """Around one question and its answer: if the last one was interrupted, get back into step first."""
        if self._answer_due and not self._recovering:
            with self._recovery():
                self.resynchronise()
                self.set_format()
        self._answer_due = True
        yield
        self._answer_due = False

    @contextlib.contextmanager
    def _recovery(self) -> Iterator[None]:
        # A fault during recovery ends it; it must not start another one.
        self._recovering = True
        try:
            yield
        finally:
            self._recovering = False

    # ------------------------------------------------------------------ inside

    def _identify(self) -> Identity:
        """Ask ``*IDN?`` and read until an identity comes: on a stream, older lines may come first."""
        in_doubt, self._identity_due = self._identity_due, True
        self.link.write("*IDN?")
        deadline = time.monotonic() + self.link.answer_time + self.link.line_time(2 * POINTS)
        problem: InstrumentError | None = None
        while problem is None or (not self.link.framed and time.monotonic() < deadline):
            try:
                identity = parse_identity(self.link.read_text(longest=8192))
            except (WrongInstrument, TransferError) as error:
                if problem is None and isinstance(error, TransferError) and self.link.is_serial:
                    # Text without a line feed: perhaps the scope is set to end its answers with CR alone. But it
                    # may as well be a late record: then both questions are answered.
                    self.link.write(f"{_LINE_END} LF")
                    self.link.write("*IDN?")
                    in_doubt = True
                problem = error
            except NoAnswer:
                # Silence after a line that was not an identity: that line was the answer.
                if problem is None:
                    raise
                break
            else:
                if in_doubt and not self.link.framed:
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
        self.link.write(";".join([_MARKER] * parts))
        values: list[str] = []
        while len(values) != parts or set(values) - {"0", "1"}:
            line = self.link.read_text(longest=8192)
            values = [scpi.split_header(part)[1] for part in scpi.split_parts(line)]
        self._markers_due = 0

    def _set_line(self) -> str:
        """On RS-232, let answers end with LF and no byte value stop the line; returns how to undo it."""
        if not self.link.is_serial:
            return ""
        answers = self.ask(f"{_LINE_END}?;{_SOFT_FLAGGING}?", parts=2)
        line_end, soft = (scpi.split_header(part)[1] for part in answers)
        undo = []
        if soft != "0":
            # XON and XOFF are also values of samples; hard flagging switches soft flagging off.
            self.command(f"{_HARD_FLAGGING} ON")
            undo.append(f"{_SOFT_FLAGGING} ON")
        if line_end != "LF":
            self.command(f"{_LINE_END} LF")
            undo.append(f"{_LINE_END} {line_end}")
        return ";".join(undo)

    def _confirm(self, preambles: dict[str, str]) -> None:
        """Ask for new preambles a second time; TransferError if one of them differs."""
        question = ";".join(f":DATA:SOURCE {source};:WFMPRE?" for source in preambles)
        if list(preambles) == [self.source]:
            question = ":WFMPRE?"
        answers = self.ask(question, parts=PREAMBLE_FIELDS * len(preambles))
        self.source = list(preambles)[-1]
        for number, (source, text) in enumerate(preambles.items()):
            again = ";".join(answers[PREAMBLE_FIELDS * number : PREAMBLE_FIELDS * (number + 1)])
            if again != text:
                self._confirmed.pop(source, None)
                raise TransferError(
                    "the preamble changed while it was read (a lost byte, or a turned knob); ask again"
                )
            self._confirmed[source] = text

    def _read_event_queue(self) -> list[ScopeEvent]:
        answer = ";".join(self.ask(":ALLEV?", parts=None))
        try:
            return parse_events(answer)
        except TransferError as error:
            raise self.after_damage(error) from error

    def _raise_errors(self, found: list[ScopeEvent]) -> None:
        for event in found:
            if is_error(event):
                raise event
        if not found:
            raise scope_event(100, "an error without an entry in the queue")

    def _raise_not_displayed(self, source: str) -> None:
        with contextlib.suppress(InstrumentError):
            self.events()
        switch = f"set_channel({source!r})" if source.startswith("CH") else f"write('SELECT:{source} ON')"
        raise scope_event(2244, f"{source} is not displayed", f"switch it on first: {switch}")

    def _integer(self, text: str) -> int:
        try:
            value = scpi.integer(scpi.split_header(text)[1])
        except TransferError as error:
            raise self.after_damage(error) from error
        if value & POWER_ON:
            # Whatever the scope forgot, it forgot our format first.
            self.set_format()
        return value

    def _check_register(self, text: str) -> None:
        """TransferError, or on a framed link the event itself, if commands before a record went wrong."""
        register = scpi.integer(text)
        if register & POWER_ON:
            raise TransferError("the scope was switched off and on; check its settings and ask again")
        if not register & ERROR_BITS:
            return
        events = self._read_event_queue()
        found = [event for event in events if is_error(event)]
        if events and not found:
            return  # warnings only: an earlier measurement of a clipped record, for example
        if found and self.link.framed:
            raise found[0]
        # Our own fixed commands are right, so on a stream it was the line that spoiled them.
        told = f" ({found[0]})" if found else ""
        raise TransferError(f"the request for a record was damaged on its way{told}; ask again")
