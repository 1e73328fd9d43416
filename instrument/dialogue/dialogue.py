"""A dialogue with one scope that stays in step: questions, records, events, and recovery after a fault.

The driver speaks with headers off and takes curves as signed bytes. Both are set when the dialogue begins
and put back as found when it ends.
"""

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from instrument import scpi
from instrument.dialogue.identify import (
    ERROR_BITS,
    LINE_END,
    POWER_ON,
    Identity,
    WhoIsThere,
    is_error,
    nobody_known,
    parse_events,
    raise_errors,
    scope_event,
)
from instrument.dialogue.link import SLICE_TIME, Link, NoAnswer
from instrument.dialogue.retry import ANSWER_TIME, AnswerTimeout, Persistence, Tally
from instrument.errors import (
    InstrumentError,
    LinkError,
    QueryError,
    ScopeEvent,
    SettingError,
    TransferError,
    WrongInstrument,
)
from instrument.scpi import POINTS
from instrument.waveform import Preamble, Waveform, decode_curve

# --------------------
# Questions and answers that stay in step with one scope, whatever its link does to them.
#
# After damage or silence both sides are brought to rest, and the same scope must answer. With `Persistence` an
# exchange is then done again, a lost link is opened again, and every answer on a stream must bear the mark of its
# question: ``*ESE`` is set to another number each time and asked for with it. This enable mask serves service
# requests only, which streams do not have; it is put back as found


T = TypeVar("T")

TEXT, RECORD, LONG = "text", "record", "long"
"""Kinds of answers, by how long a scope thinks; what takes long anyway is not given up early."""

_MASK = "*ESE"
_MARKS = 256
_LONGEST_TEXT = 16_384
_OPENING_ATTEMPTS = 6  # nobody has answered on this name yet: it may be wrong
_UNREAD = 8  # answers in a row that are none: a line that spoils one exchange in five has one of 3000 links so
_IDENTITIES, _TRIES = 3, 4
_FIRST_PAUSE, _LONGEST_PAUSE = 0.1, 2.0  # s between two attempts to connect


class Exchange(ABC):
    """Text to and from one scope over an open link."""

    def __init__(self, link: Link, persistence: Persistence | None = None) -> None:
        self.link = link
        self.persistence = persistence or Persistence()
        self.tally = Tally()
        self.in_doubt = self.lost = False
        self.unread_events = False
        """Whether a question of the user's may have left events that are not about the next record."""
        self._recovering = self.reconnecting = False
        self._answer_due = False
        self._mark: int | None = None
        link.answer_time = self.persistence.answer_time
        self._patience = AnswerTimeout(link.pause_time, link.answer_time)
        self._late_until: float | None = None
        """Until when a message that nobody waits for any more may still arrive, and be obeyed."""
        self._kind = TEXT
        self.hasty = False
        """Whether the last answer was waited for less long than a slow scope may take."""
        self._who = WhoIsThere(link, self.send)
        self._found_mask = 0
        self.identity = self._greet()

    @abstractmethod
    def set_format(self) -> None:
        """Make the scope answer in the form that is read here."""

    @abstractmethod
    def format_question(self) -> tuple[str, list[str]]:
        """The same as commands with queries behind them, and what those shall answer; forgets what it changes."""

    @abstractmethod
    def set_line(self) -> str:
        """Make the line carry what is sent here; returns the commands that undo it."""

    def settings_in_doubt(self) -> bool:
        """Whether settings may have changed since they were verified, by a message that came late, too."""
        if self._late_until is not None and self.link.clock.now() > self._late_until:
            self._late_until, self.in_doubt = None, True
        return self.in_doubt

    def let_late_messages_pass(self) -> None:
        """Wait until no message that was given up can arrive any more, and be obeyed."""
        if self._late_until is not None and not self.lost:
            self.link.clock.sleep(max(0.0, self._late_until - self.link.clock.now()))

    def end(self) -> None:
        """Put the mask back that the marks stood in: it is the last mark."""
        if self._mark is not None:
            self.repeated(self._put_mask_back)
            self._mark, self.link.answer_time = None, self._patience.longest

    def _put_mask_back(self) -> None:
        self._mark = self._found_mask - 1
        (held,) = self._ask_once(f"{_MASK}?")
        if held != str(self._found_mask):
            raise TransferError(f"{_MASK} is {held} and not {self._found_mask} as it was found; ask again")

    # ------------------------------------------------------------------ questions

    def ask(self, text: str, *, parts: int | None = 1, wait: float = 0.0, twice: bool = False) -> list[str]:
        """Send one message with `parts` queries in it and return their answers (None: any number)."""
        if not (twice and self.persistence.careful):
            return self.repeated(lambda: self._ask_once(text, parts=parts, wait=wait))
        return self.repeated(lambda: self._ask_twice(text, parts, wait))

    def command(self, text: str) -> None:
        """Send commands and check in the same exchange that the scope took them."""
        self.checked(f"{text};*ESR?", parts=0)

    def checked(self, text: str, *, parts: int) -> list[str]:
        """Send a message that ends with ``*ESR?``; return its other answers if no error bit is set."""

        def once() -> list[str]:
            *answers, register = self._ask_once(text, parts=parts + 1)
            if self._register(register) & ERROR_BITS:
                raise_errors(self._read_event_queue())
            return answers

        return self.repeated(once)

    def ask_with_events(self, text: str, *, parts: int, wait: float = 0.0) -> tuple[list[str], list[ScopeEvent]]:
        """As `ask`; besides, every event that the message caused, warnings too."""
        clean = "*CLS;" if self.unread_events else ""
        self.unread_events = False
        return self.repeated(lambda: self._with_events_once(f"{clean}{text};*ESR?", parts, wait))

    def events(self) -> list[ScopeEvent]:
        """Read and empty the event queue."""
        self.ask("*ESR?")
        return self.repeated(self._read_event_queue)

    def _with_events_once(self, text: str, parts: int, wait: float) -> tuple[list[str], list[ScopeEvent]]:
        *answers, register = self._ask_once(text, parts=parts + 1, wait=wait)
        return answers, self._read_event_queue() if self._register(register) & ERROR_BITS else []

    def _ask_twice(self, text: str, parts: int | None, wait: float) -> list[str]:
        both = None if parts is None else 2 * parts
        found = self._ask_once(f"{text};{text}", parts=both, wait=wait)
        half = len(found) // 2
        # A message of which nothing is left has no answer twice over.
        if not found or len(found) % 2 or found[:half] != found[half:]:
            raise self.after_damage(TransferError(f"{text!r:.60} was answered in two ways; ask again"))
        return found[:half]

    def _ask_once(self, text: str, *, parts: int | None = 1, wait: float = 0.0) -> list[str]:
        try:
            with self.exchange():
                mark = self.send(text)
                found = scpi.split_parts(self.link.read_text(wait=wait, longest=_LONGEST_TEXT))
            if mark:
                found = scpi.without_mark(found, mark)
                self.came()
            if parts is not None and len(found) != parts:
                raise TransferError(
                    f"{parts} answers to {text!r:.80} were expected, but {found!r:.80} came; ask again"
                )
        except NoAnswer as silence:
            raise self.explain_silence(text, silence) from None
        except TransferError as error:
            raise self.after_damage(error) from error
        return found

    def send(self, text: str, *, kind: str = TEXT) -> str:
        """Send a message, with a mark in front of it where marks are in use; returns the mark, else ""."""
        # Where marks are in use, its answer is waited for as long as those of its kind make likely.
        if self._mark is None:
            self.link.write(text)
            return ""
        self._mark = (self._mark + 1) % _MARKS
        message = f"{_MASK} {self._mark};{_MASK}?;{text}"
        patience = self._patience.seconds(kind)
        self._kind, self.hasty = kind, patience < self._patience.longest
        self.link.answer_time = patience + self.link.line_time(len(message))
        self.link.write(message)
        return str(self._mark)

    def came(self, kind: str = TEXT) -> None:
        """The answer of this kind bore the mark of its question."""
        if kind != LONG:
            self._patience.came(kind, self.link.began_after)
        if self._late_until is not None and self.link.is_serial:
            # a line keeps the order: what was sent before this question was obeyed by now, or is lost
            self._late_until, self.in_doubt = None, True

    def _nothing_came(self) -> None:
        if self._mark is not None:
            self._patience.silent(self._kind)
            self._late_until = self.link.clock.now() + self._patience.longest

    # ------------------------------------------------------------------ doing it again

    def repeated(self, work: Callable[[], T]) -> T:
        """Do an exchange, or a step that can be done again as a whole, as often as the persistence allows."""
        # What the scope refuses twice in the same words was not spoiled by the line, and is raised.
        refused = ""
        for attempt in range(1, self.persistence.attempts + 1):
            last = self._recovering or attempt == self.persistence.attempts
            try:
                return work()
            except TransferError:
                if last:
                    raise
            except (ScopeEvent, SettingError) as refusal:
                if last or str(refusal) == refused:
                    raise
                refused = str(refusal)
            except LinkError as lost:
                if last:
                    raise
                self._reconnect(lost)
            self.tally.repeated += 1
            self.in_doubt = True
        raise LinkError(f"{self.link.name}: nothing was tried")

    def _reconnect(self, lost: LinkError) -> None:
        """Open the link again, for as long as the persistence allows; the first error is raised in the end."""
        longest, clock = self.persistence.reconnect_for, self.persistence.clock
        if self.reconnecting or self.lost or not longest:
            raise lost
        self.reconnecting = True
        self.persistence.tell(f"{lost}; trying to connect again for {longest:g} s")
        began, pause = clock.now(), _FIRST_PAUSE
        try:
            while not self._connected():
                waited = clock.now() - began
                if waited >= longest:
                    self.lost = True
                    raise LinkError(f"{lost}; it could not be reached again in {waited:.0f} s") from lost
                clock.sleep(pause)
                pause = min(2 * pause, _LONGEST_PAUSE)
        finally:
            self.reconnecting = False
        self.tally.reconnected += 1
        self.in_doubt = True
        self.persistence.tell(f"{self.identity.model} answers again after {clock.now() - began:.1f} s")

    def _connected(self) -> bool:
        """Try once to open the link and to get ready; WrongInstrument if somebody else answers."""
        try:
            self.link.reopen()
            self._answer_due = False
            with self._recovery():
                if self._mark is not None:
                    self._ask_for_all()
                else:
                    self.resynchronise()
            self.set_line()
            if self._mark is None:
                self.set_format()
        except WrongInstrument:
            raise
        except InstrumentError:
            return False
        return True

    # ------------------------------------------------------------------ getting back into step

    def resynchronise(self) -> None:
        """Clear the link, and make sure that the same scope still answers."""
        self.link.clear()
        other = ""
        for _ in range(_IDENTITIES):  # damage on the way does not strike twice alike
            try:
                identity = self._who.ask()
            except WrongInstrument as error:
                text = str(error)
            else:
                if identity.same_unit(self.identity):
                    return
                text = identity.text
            if text == other:
                raise WrongInstrument(
                    f"another instrument answers on {self.link.name} now: {text!r} instead of "
                    f"{self.identity.text!r}; connect again"
                )
            other = text
        raise TransferError(f"the identity of {self.identity.model} came damaged again and again; ask again")

    def _come_into_step(self) -> list[ScopeEvent]:
        """Get back into step, a persistent program after several tries; returns the events that waited."""
        tries = _TRIES if self.persistence.careful else 1
        for attempt in range(1, tries + 1):
            try:
                with self._recovery():
                    if self._mark is not None:
                        found = self._ask_for_all()
                    else:
                        self.resynchronise()
                        found = self.events()
                        self.set_format()
            except (NoAnswer, TransferError):
                if attempt == tries:
                    raise
            else:
                break
        return found

    def _ask_for_all(self) -> list[ScopeEvent]:
        """Events, format and identity in one marked message, up to which everything on the line is dropped."""
        self.link.clear(SLICE_TIME)  # what comes later bears another mark
        if not self.link.is_serial:
            self.link.write("")  # ends a half-sent command, as a break does
        commands, wanted = self.format_question()
        mark = self.send(";".join(filter(None, ("*ESR?;:ALLEV?", commands, "*IDN?"))))
        clock = self.link.clock
        began, longest = clock.now(), self.link.answer_time + self.link.line_time(2 * POINTS)
        while True:
            try:
                found = scpi.split_parts(self.link.read_text(longest=_LONGEST_TEXT))
                _, events, *held, identity = scpi.without_mark(found, mark)
            except NoAnswer:
                self._nothing_came()
                raise
            except (TransferError, ValueError) as error:
                if clock.now() - began > longest:
                    raise TransferError("many answers came, and none to the last question; ask again") from error
            else:
                break
        self.came()
        if identity != self.identity.text:
            self.resynchronise()  # damaged, or another instrument: it decides
        if held != wanted:
            raise TransferError(f"the transfer format was set and is {held!r:.60}; ask again")
        return parse_events(events)

    def resynchronise_or_raise(self, silence: NoAnswer) -> None:
        """Get back into step after a wait that brought nothing; LinkError if the scope is gone."""
        try:
            self._come_into_step()
        except NoAnswer:
            raise LinkError(f"{silence}, and to *IDN? neither; is it switched on and connected?") from None

    def explain_silence(self, text: str, silence: NoAnswer) -> InstrumentError:
        """Find out why nothing came; returns the scope's own event if there is one, else the best guess."""
        if self._recovering:
            return silence
        try:
            found = self._come_into_step()
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
            self._come_into_step()
        except NoAnswer:
            return LinkError(f"{error}; after that the scope answered nothing any more: is it switched on?")
        except InstrumentError as worse:
            return worse
        return error

    @contextlib.contextmanager
    def exchange(self) -> Iterator[None]:
        """Around one question and its answer: if the last one was interrupted, get back into step first."""
        if self._answer_due and not self._recovering:
            self._come_into_step()
        self._answer_due = True
        try:
            yield
        except NoAnswer:
            self._nothing_came()
            raise
        self._answer_due = False

    @contextlib.contextmanager
    def _recovery(self) -> Iterator[None]:
        # A fault during recovery ends it; it must not start another one.
        before, self._recovering = self._recovering, True
        try:
            yield
        finally:
            self._recovering = before

    # ------------------------------------------------------------------ who is there

    def _greet(self) -> Identity:
        """Ask who is there; a persistent program opens the link again after damage and silence."""
        silent = unread = 0
        told, tries = "", 2 * self.persistence.attempts - 1
        for attempt in range(1, tries + 1):
            try:
                if attempt > 1:
                    self.link.reopen()
                    self._answer_due = False
                if self.link.is_serial or self.link.framed:
                    self.link.clear()
                identity = self._who.ask()
                unread = 0
                if self.persistence.careful:
                    with self._recovery():
                        mask, again, text = self._ask_once(f"{_MASK}?;{_MASK}?;*IDN?", parts=3)
                        if text != identity.text or mask != again:
                            raise TransferError("the identity was answered in two ways; ask again")
                        if not self.link.framed:
                            self._mark = self._found_mask = self._integer(mask)
                return identity
            except (LinkError, TransferError, WrongInstrument) as error:
                silent += isinstance(error, LinkError)
                unread += isinstance(error, TransferError)
                alike = isinstance(error, WrongInstrument) and str(error) == told
                if alike or silent == _OPENING_ATTEMPTS or unread == _UNREAD or attempt == tries:
                    raise nobody_known(self.link, error, attempt) from error
                told = str(error)
                self.tally.repeated += 1
                self.persistence.clock.sleep(_FIRST_PAUSE)
        raise LinkError(f"{self.link.name}: nothing was tried")

    # ------------------------------------------------------------------ what came

    def _read_event_queue(self) -> list[ScopeEvent]:
        answer = ";".join(self.ask(":ALLEV?", parts=None))
        try:
            return parse_events(answer)
        except TransferError as error:
            raise self.after_damage(error) from error

    def _integer(self, text: str) -> int:
        try:
            return scpi.integer(scpi.split_header(text)[1])
        except TransferError as error:
            raise self.after_damage(error) from error

    def _register(self, text: str) -> int:
        """Value of an answer to ``*ESR?``."""
        value = self._integer(text)
        if value & POWER_ON:
            # Whatever the scope forgot, it forgot our format first.
            self.in_doubt = True
            self.set_format()
        return value


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
        """Send commands and ask for the records of `sources`, all in one message."""
        # The status register is asked for with them, so that a command that was lost or refused on its way cannot
        # pass an old record off as a new one. A preamble that differs from the last one of its source is asked for
        # a second time, because a lost digit in it could not be noticed otherwise; a persistent program has each
        # record sent twice instead. Of several sources the scope tells before and after them that it is stopped:
        # then they are of one acquisition.
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
            for name, waveform in zip(sources, waveforms, strict=True):
                if waveform.preamble.nr_pt != POINTS and name != "MATH":  # a spectrum is shorter
                    raise TransferError(
                        f"{waveform.preamble.nr_pt} points of {name} came where {POINTS} were asked for: another "
                        "program has set DATA:START or DATA:STOP; ask again"
                    )
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


# --------------------
# The question for one or several records in one message, and how its answer is taken apart.
#
# Of one source the question is ``WAVFrm?``. Of several, ``DATa:SOUrce`` goes from one to the next, and
# ``ACQuire:STATE?`` stands before and behind them. What comes back is, with headers off::
#
#     <*ESR?>;[<STATE?>;]<preamble>;<block>[;<preamble>;<block>...;<STATE?>]
#
# Programmer manual 071-1075-04, pp. 2-86 to 2-91 and 2-240 to 2-246


PREAMBLE_FIELDS = 16  # fields of ``WFMPre?`` of a waveform that is displayed
TRANSMISSION_FIELDS = 5  # fields of ``WFMPre?`` of a waveform that is not

_STOPPED, _RUNNING = "0", "1"


@dataclass(frozen=True)
class RecordQuestion:
    """Which records are asked for."""

    sources: tuple[str, ...]  # ``CH1``..., in the order in which they are wanted
    selected: str | None = None  # what ``DATa:SOUrce`` names before the question; None if not known
    # each record is asked for two times and must come alike: nothing else shows a changed byte in a curve
    twice: bool = False

    @property
    def blocks(self) -> int:
        """Binary blocks in a whole answer."""
        return len(self.sources) * (1 + self.twice)

    @property
    def text(self) -> str:
        """The queries, to follow ``*ESR?``."""
        query = ":WAVF?;:WAVF?" if self.twice else ":WAVF?"
        if len(self.sources) == 1:
            return f"{self._select(self.sources[0], self.selected)}{query}"
        before = (self.selected, *self.sources)
        waveforms = [f"{self._select(new, old)}{query}" for old, new in zip(before, self.sources, strict=False)]
        return ";".join((":ACQ:STATE?", *waveforms, ":ACQ:STATE?"))

    @staticmethod
    def _select(source: str, selected: str | None) -> str:
        return "" if source == selected else f":DATA:SOURCE {source};"

    def split(
        self, pieces: list[tuple[str, bytes]], rest: str, mark: str = ""
    ) -> tuple[str, list[str], list[bytes]]:
        """Take an answer apart."""
        several = len(self.sources) > 1
        fields: list[str] = []
        ends: list[int] = []  # numbers of fields before each block
        for number, (text, _) in enumerate(pieces):
            fields += _fields(text, follows_block=number > 0)
            last = fields[-1].strip().lstrip(":").upper()
            if not last or last.startswith("CURV"):  # with headers on ``:CURVE`` stands before its block
                del fields[-1]
            ends.append(len(fields))
        if rest or not pieces:
            fields += _fields(rest, follows_block=bool(pieces))
        if mark:
            fields, ends = scpi.without_mark(fields, mark), [end - 1 for end in ends]
        if not fields:
            raise TransferError("nothing stands before the binary block; ask again")
        register, *fields = fields
        if several:
            if len(fields) < 2 or {fields[0], fields[-1]} - {_STOPPED, _RUNNING}:
                raise TransferError(f"records were expected, but {fields[-1:]!r:.60} ended the answer; ask again")
            if _RUNNING in (fields[0], fields[-1]):
                raise SettingError(
                    "the scope acquires on, so that its channels would be of different acquisitions; stop it, or "
                    "acquire a single record"
                )
            fields = fields[1:-1]
        behind = 2 if several else 1
        texts = self._preambles(fields, {end - behind for end in ends})
        curves = [data for _, data in pieces]
        if self.twice:
            if texts[::2] != texts[1::2] or curves[::2] != curves[1::2]:
                raise TransferError("a record came in two ways when it was read twice; ask again")
            texts, curves = texts[::2], curves[::2]
        return register, texts, curves

    def _preambles(self, fields: list[str], ends: set[int]) -> list[str]:
        """Cut the fields into preambles; `ends` are the places where a block followed."""
        texts, position = [], 0
        for _ in range(self.blocks):
            length = PREAMBLE_FIELDS if position + PREAMBLE_FIELDS in ends else TRANSMISSION_FIELDS
            texts.append(";".join(fields[position : position + length]))
            position += length
            ends.discard(position)
        if position != len(fields) or ends:
            raise TransferError(
                f"{len(fields)} fields of preambles came where {position} were expected; ask again"
            )
        return texts

    def not_displayed(self, texts: list[str]) -> str | None:
        """The first source of which only the transmission fields came."""
        for source, text in zip(self.sources, texts, strict=True):
            if len(scpi.split_parts(text)) == TRANSMISSION_FIELDS:
                return source
        return None

    def decode(self, texts: list[str], curves: list[bytes]) -> tuple[Waveform, ...]:
        """The records; TransferError if one is damaged, or not in our format, or of another acquisition."""
        if len(curves) != len(self.sources):
            raise TransferError(f"{len(curves)} records came where {len(self.sources)} belong; ask again")
        waveforms = []
        for source, text, data in zip(self.sources, texts, curves, strict=True):
            preamble = Preamble.parse(text)
            form = (preamble.byt_nr, preamble.encdg, preamble.bn_fmt)
            if form != (1, "BIN", "RI") or text.lstrip().startswith(":"):
                raise TransferError(
                    "somebody changed headers or the transfer format; it has been set again, ask again"
                )
            named = preamble.wfid.split(",")[0].upper().replace(" ", "")
            if named != source:
                raise TransferError(f"the record is of {named} instead of {source}; ask again")
            waveforms.append(decode_curve(data, preamble))
        if len({(waveform.preamble.xincr, waveform.preamble.xzero) for waveform in waveforms}) > 1:
            raise TransferError("the channels are not of one acquisition (was a knob turned?); ask again")
        return tuple(waveforms)


def _fields(text: str, *, follows_block: bool) -> list[str]:
    """Fields of the text between blocks; the ``;`` that joins them to the block is not one."""
    if follows_block:
        if not text.startswith(";"):
            raise TransferError(f"{text[:20]!r} follows a binary block where ';' belongs; ask again")
        text = text[1:]
    return scpi.split_parts(text)
