"""A dialogue with one scope that stays in step: questions, records, events, and recovery after a fault.

The driver speaks with headers off and takes curves as signed bytes. Both are set when the dialogue begins
and put back as found when it ends.
"""

from __future__ import annotations

import contextlib

from instrument import scpi
from instrument.dialogue.events import ERROR_BITS, POWER_ON, is_error, scope_event
from instrument.dialogue.exchange import LONG, RECORD, Exchange
from instrument.dialogue.link import ANSWER_TIME, Link, NoAnswer
from instrument.dialogue.persistence import Persistence
from instrument.dialogue.record_question import PREAMBLE_FIELDS, RecordQuestion
from instrument.dialogue.who_is_there import LINE_END
from instrument.errors import InstrumentError, TransferError
from instrument.facts import POINTS
from instrument.waveform import Waveform

_FORMAT_QUERY = ":HEADER?;:VERBOSE?;:DATA:ENCDG?;:DATA:SOURCE?;:DATA:START?;:DATA:STOP?;:DATA:WIDTH?"
_OUR_FORMAT = f":HEADER OFF;:VERBOSE ON;:DATA:ENCDG RIBINARY;:DATA:WIDTH 1;:DATA:START 1;:DATA:STOP {POINTS}"
_HELD_FORMAT = {":DATA:ENCDG": "RIBINARY", ":DATA:WIDTH": "1", ":DATA:START": "1", ":DATA:STOP": str(POINTS)}
_ROUNDS = 3
_SOFT_FLAGGING = ":RS232:SOFTFLAGGING"
_HARD_FLAGGING = ":RS232:HARDFLAGGING"


class Dialogue(Exchange):
    """Questions and answers with one scope over an open link: records, pictures, and what `Exchange` does."""

    def __init__(self, link: Link, persistence: Persistence | None = None) -> None:
        self.source: str | None = None
        """Source that ``DATa:SOUrce`` names now, None if not known."""
        self._confirmed: dict[str, str] = {}
        self._found_format = ""
        super().__init__(link, persistence)
        self._found_line = self.set_line()
        found = [scpi.split_header(part)[1] for part in self.ask(_FORMAT_QUERY, parts=7, twice=True)]
        self._found_format = _format_commands(found)
        self.repeated(self.set_format)

    def close(self) -> None:
        """Put headers and transfer format back as found, and close the link whatever happens."""
        if self.link.closed:
            return
        try:
            self._put_format_back()
            self.end()
            if self._found_line:
                # An answer could not be read any more, so nothing is asked.
                self.link.write(self._found_line)
        finally:
            self.link.close()

    def set_format(self) -> None:
        """Headers off, signed bytes, whole record; older events are dropped, they are not about us."""
        commands, wanted = self.format_question()
        if not commands:
            return
        *held, _ = self.ask(f"{commands};*ESR?", parts=len(wanted) + 1)
        if held != wanted:
            raise TransferError(f"the transfer format was set and is {held!r:.60}; ask again")

    def format_question(self) -> tuple[str, list[str]]:
        """The same as commands with queries behind them, and what those shall answer; forgets what it changes."""
        self.source = None
        self._confirmed.clear()
        if not self._found_format:
            return "", []  # how it was found must be known first
        queries = ";".join(f"{command}?" for command in _HELD_FORMAT)
        return f"{_OUR_FORMAT};*CLS;{queries}", list(_HELD_FORMAT.values())

    def picture(self, *, wait: float) -> bytes:
        """Let the scope send the picture of its screen and return the BMP file; errors as `ask`."""
        return self.repeated(lambda: self._picture_once(wait))

    def _picture_once(self, wait: float) -> bytes:
        try:
            with self.exchange():
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
        asked for a second time, because a lost digit in it could not be noticed otherwise; a persistent program
        has each record sent twice instead. Of several sources the scope tells before and after them that it is
        stopped: then they are of one acquisition.
        """
        clean = "*CLS" if self.unread_events else ""
        self.unread_events = False
        twice = self.persistence.careful and self.persistence.read_twice
        kind = RECORD if wait < ANSWER_TIME else LONG
        wanted = RecordQuestion(sources, selected=self.source, twice=twice)
        message = ";".join(filter(None, (clean, commands, "*ESR?", wanted.text, afterwards)))
        try:
            with self.exchange():
                mark = self.send(message, kind=kind)
                self.source = None
                answer = self.link.read_blocks(blocks=wanted.blocks, wait=wait, longest=2 * POINTS)
            register, texts, curves = wanted.split(*answer, mark)
            if mark:
                self.came(kind)
            self._check_register(register)
            missing = wanted.not_displayed(texts)
            if missing is not None:
                self._raise_not_displayed(missing)
            waveforms = wanted.decode(texts, curves)
        except TransferError as error:
            raise self.after_damage(error) from error
        self.source = sources[-1]
        if wanted.twice:
            return waveforms
        new = {name: text for name, text in zip(sources, texts, strict=True) if self._confirmed.get(name) != text}
        if new:
            self._confirm(new)
        return waveforms

    # ------------------------------------------------------------------ inside

    def set_line(self) -> str:
        """On RS-232, let answers end with LF and no byte value stop the line; returns how to undo it."""
        if not self.link.is_serial:
            return ""
        answers = self.ask(f"{LINE_END}?;{_SOFT_FLAGGING}?", parts=2, twice=True)
        line_end, soft = (scpi.split_header(part)[1] for part in answers)
        undo = []
        if soft != "0":
            # XON and XOFF are also values of samples; hard flagging switches soft flagging off.
            self.command(f"{_HARD_FLAGGING} ON")
            undo.append(f"{_SOFT_FLAGGING} ON")
        if line_end != "LF":
            self.command(f"{LINE_END} LF")
            undo.append(f"{LINE_END} {line_end}")
        return ";".join(undo)

    def _put_format_back(self) -> None:
        """Put headers and transfer format back, and see that they are."""
        held = ""
        for _ in range(_ROUNDS):
            answers = self.checked(f"{self._found_format};{_FORMAT_QUERY};*ESR?", parts=7)
            held = _format_commands([scpi.split_header(part)[1] for part in answers])
            if held == self._found_format:
                return
        raise TransferError(f"the transfer format was {self._found_format} and is {held} after it was put back")

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

    def _raise_not_displayed(self, source: str) -> None:
        with contextlib.suppress(InstrumentError):
            self.events()
        switch = f"set_channel({source!r})" if source.startswith("CH") else f"write('SELECT:{source} ON')"
        raise scope_event(2244, f"{source} is not displayed", f"switch it on first: {switch}")

    def _check_register(self, text: str) -> None:
        """TransferError, or on a framed link the event itself, if commands before a record went wrong."""
        register = scpi.integer(text)
        if register & POWER_ON:
            self.in_doubt = True
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


def _format_commands(values: list[str]) -> str:
    """The commands that put the values back which `_FORMAT_QUERY` asked for; headers come last."""
    header, verbose, encoding, source, start, stop, width = values
    return (
        f":DATA:ENCDG {encoding};:DATA:SOURCE {source};:DATA:START {start};:DATA:STOP {stop};"
        f":DATA:WIDTH {width};:VERBOSE {verbose};:HEADER {header}"
    )
