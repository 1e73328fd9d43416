"""Frames out of a stream of bytes that may have holes, extra bytes and flipped bits.

What is delivered passed every check that its format has. What is not is counted. After damage the search for the
next frame begins one byte behind the place where the damaged one began, so that no good frame inside the damaged
stretch is lost, and never more than two frames' bytes are held, or four where the checksum is weak.

Where the checksum is weak (one byte, or none), the frames that follow have to bear one out, by their length,
counter and checksum: one whole frame in its place with the right counter, or a header of two bytes or more right
behind, or a header of one byte and the counter behind it. A frame out of step, whose counter does not go on by
as many frames as bytes have passed, needs two whole ones: numbers that look like a header may stand in every
frame at the same place, and with an exclusive-or even their sums may be right. More cannot be had. A byte lost
in a frame, and one inserted before the next header, leave the very bytes of another whole frame in 1 of 256
cases (one byte of sum); nothing tells it from one that was sent.
"""

from __future__ import annotations

from dataclasses import dataclass

from instrument.fibre_gyro.frame_format import COUNTER, FrameFormat
from instrument.fibre_gyro.frames import Damaged, Frame, decode_frame

_MOST_ANSWERS = 8  # an old one that still comes is rubbish
_FOLLOWERS = 3  # frames behind one with a weak checksum that may bear it out
_STRONG_CHECK = 2  # bytes of a checksum that lets less than one damaged frame in 65 000 pass


@dataclass(frozen=True)
class Answer:
    """One of the expected answers came; `message` is its bytes."""

    message: bytes


@dataclass(frozen=True)
class Damage:
    """So many frames came damaged here, or what is left of them; `reason` in a few words."""

    frames: int
    reason: str


Event = Frame | Answer | Damage


@dataclass
class Tally:
    """What became of the bytes so far.

    Attributes
    ----------
    good, damaged, unusable : int
        Frames: delivered as usable; damaged; whole, but with a bad status or a value out of range.
    received, discarded : int
        Bytes that came, and those that belong to no frame and no answer.
    """

    good: int = 0
    damaged: int = 0
    unusable: int = 0
    received: int = 0
    discarded: int = 0


class FrameStream:
    """Takes bytes as they come and gives what is in them, in order: frames, answers, damage."""

    def __init__(self, layout: FrameFormat) -> None:
        self._layout = layout
        self._lines = layout.kind == "ascii"
        self._buffer = bytearray()
        self._answers: dict[bytes, None] = {}  # in the order in which they were expected
        self.tally = Tally()
        weak = layout.check is None or layout.check.size < _STRONG_CHECK
        self._confirm = weak and not self._lines
        # a header that a frame with one byte lost or inserted cannot put in its place
        self._distinct = len(layout.header) > 1 and layout.header[:1] not in layout.header[1:]
        self.restart()

    def expect(self, message: bytes) -> bytes:
        """From now on `message` is an answer; returns what `Answer.message` will be."""
        answer = message.removesuffix(self._layout.ending).rstrip(b" \r\n") if self._lines else message
        while answer not in self._answers and len(self._answers) >= _MOST_ANSWERS:
            del self._answers[next(iter(self._answers))]
        self._answers[answer] = None
        return answer

    def restart(self) -> None:
        """Drop what is held and begin anew, in the middle of a frame perhaps."""
        self.tally.discarded += len(self._buffer)
        self._buffer.clear()
        self._joined = False  # whether a frame was found since
        self._counter: int | None = None  # of the last frame
        self._bad_bytes, self._reason = 0, ""
        self._too_long = False

    @property
    def held(self) -> int:
        """Bytes that may yet become a frame."""
        return len(self._buffer)

    def feed(self, data: bytes, *, silent: bool = False) -> list[Event]:
        """Take bytes.

        Parameters
        ----------
        silent : bool
            Nothing more will follow for a while: a frame with nothing behind it waits no longer.
        """
        self.tally.received += len(data)
        self._buffer += data
        self._found: list[Event] = []
        if self._lines:
            self._take_lines()
        else:
            self._take_binary(silent)
        return self._found

    # ------------------------------------------------------------------ binary frames

    def _take_binary(self, silent: bool) -> None:
        position = 0
        while position < len(self._buffer):
            rest = self._buffer[position : position + self._longest()]
            answer = self._answer_at(rest)
            if answer is not None:
                self._end_of_damage()
                self._found.append(Answer(answer))
                position += len(answer)
            elif self._may_begin(rest):
                break
            else:
                frame = self._frame_at(rest)
                good = frame is not None and self._borne_out(frame, rest[self._layout.frame_bytes :], silent)
                if good is None:
                    break
                position = self._behind_frame(frame, position) if frame and good else self._behind_damage(position)
        del self._buffer[:position]

    def _longest(self) -> int:
        layout = self._layout
        longest = max(layout.frame_bytes + len(layout.header), *map(len, self._answers), 1)
        return longest + _FOLLOWERS * layout.frame_bytes if self._confirm else longest

    def _answer_at(self, rest: bytes | bytearray) -> bytes | None:
        return next((answer for answer in self._answers if rest.startswith(answer)), None)

    def _may_begin(self, rest: bytearray) -> bool:
        """Whether these bytes may become an answer or a frame and are too few for it."""
        layout = self._layout
        if any(len(rest) < len(answer) and answer.startswith(rest) for answer in self._answers):
            return True
        have = min(len(rest), len(layout.header))
        return rest[:have] == layout.header[:have] and len(rest) < layout.frame_bytes

    def _frame_at(self, rest: bytearray) -> Frame | None:
        """The frame at the begin of these bytes, if one stands there."""
        try:
            return decode_frame(bytes(rest[: self._layout.frame_bytes]), self._layout)
        except Damaged as damaged:
            self._reason = self._reason or str(damaged)
            return None

    def _borne_out(self, frame: Frame, behind: bytearray, silent: bool) -> bool | None:
        """Whether what stands behind a frame shows that it is one; None while too little of it has come."""
        if not self._confirm:
            return True
        layout, length = self._layout, self._layout.frame_bytes
        counted = layout.counter is not None and frame.counter is not None
        in_step = self._joined and (self._counts_on(frame) if counted else self._bad_bytes == 0)
        if any(behind.startswith(answer) for answer in self._answers) or (silent and not behind):
            return in_step or not self._joined
        if not any(start.startswith(behind[: len(start)]) for start in self._starts()):
            self._reason = self._reason or "no header behind it"
            return False
        if in_step and self._next_begins(frame, behind, counted):
            return True
        needed = 1 if in_step or self._distinct else 2
        whole = 0
        for place in range(1, _FOLLOWERS + 1):
            slot = behind[(place - 1) * length : place * length]
            if len(slot) < length:
                return (whole > 0) if silent else None
            whole += self._follows(frame, slot, place)
            if whole >= needed:
                return True
            if whole == 0 and place == _FOLLOWERS - 1:
                break
        self._reason = self._reason or "no whole frame behind it"
        return False

    def _next_begins(self, frame: Frame, behind: bytearray, counted: bool) -> bool:
        """Whether the next frame begins right behind, by more than one byte that other numbers could be too."""
        layout = self._layout
        if not behind.startswith(layout.header):
            return False
        distinct = self._distinct
        if distinct or not counted or layout.counter is None or frame.counter is None:
            return distinct
        begin = layout.counter_place
        if begin is None or len(behind) < begin[1]:
            return False
        entry = next(one for one in layout.fields if one.name == COUNTER)
        number = int.from_bytes(behind[begin[0] : begin[1]], entry.byte_order)
        return number == (frame.counter + layout.counter.per_frame) % layout.counter.modulus

    def _follows(self, frame: Frame, slot: bytearray, place: int) -> bool:
        """Whether a whole frame stands there, with the counter that it must have so many frames behind."""
        follower = self._frame_at(slot)
        rule = self._layout.counter
        if follower is None or rule is None or frame.counter is None or follower.counter is None:
            return follower is not None
        return (follower.counter - frame.counter - place * rule.per_frame) % rule.modulus == 0

    def _counts_on(self, frame: Frame) -> bool:
        """Whether the counter went on by as many frames as the bytes since the last one make."""
        rule = self._layout.counter
        if rule is None or frame.counter is None or self._counter is None:
            return False
        passed = 1 + round(self._bad_bytes / self._layout.frame_bytes)
        return (frame.counter - self._counter - passed * rule.per_frame) % rule.modulus == 0

    def _starts(self) -> list[bytes]:
        """How what is worth finding begins."""
        return [self._layout.header, *self._answers]

    def _behind_frame(self, frame: Frame, position: int) -> int:
        """Give a frame; where to go on."""
        self._end_of_damage()
        self._counter = frame.counter
        self._give(frame)
        return position + self._layout.frame_bytes

    def _behind_damage(self, position: int) -> int:
        """Discard what belongs to no frame and no answer; where to go on."""
        starts = self._starts()
        places = [place for start in starts if (place := self._buffer.find(start, position + 1)) >= 0]
        # The last bytes may be the begin of a header.
        kept = len(self._buffer) - max(map(len, starts)) + 1
        behind = min(places) if places else max(position + 1, kept)
        self._bad_bytes += behind - position
        self.tally.discarded += behind - position
        return behind

    def _end_of_damage(self) -> None:
        """A frame or an answer begins here: what was discarded before were damaged frames, or the end of one."""
        length = self._layout.frame_bytes
        if self._bad_bytes and (self._joined or self._bad_bytes >= length):
            self._give_damage(max(1, round(self._bad_bytes / length)))
        self._joined, self._bad_bytes, self._reason = True, 0, ""

    # ------------------------------------------------------------------ lines

    def _take_lines(self) -> None:
        *lines, rest = bytes(self._buffer).split(self._layout.ending)
        for line in lines:
            self._too_long = self._too_long or len(line) > self._longest()
            if not self._take_line(line):
                self.tally.discarded += len(line) + len(self._layout.ending)
            self._too_long = False
        if len(rest) > self._longest():
            # No line is so long: hold only what could be the first byte of an ending.
            cut = len(rest) - (len(self._layout.ending) - 1)
            self.tally.discarded += cut
            rest = rest[cut:]
            self._too_long = True
        self._buffer[:] = rest

    def _take_line(self, line: bytes) -> bool:
        """Give what is in a line; False if that is nothing."""
        text = line.rstrip(b" \r\n")
        if text in self._answers:
            self._found.append(Answer(text))
        elif text or self._too_long:
            self._reason = "line too long"
            frame = None if self._too_long else self._frame_in(text)
            if frame is None:
                if self._joined:
                    self._give_damage(1)
                self._joined = True
                return False
            self._give(frame)
        else:
            return False
        self._joined = True
        return True

    def _frame_in(self, text: bytes) -> Frame | None:
        """The frame of a line; of one that lost its line end, the frame at its end if a checksum proves it."""
        if not self._joined and not self._layout.header:
            return None  # it may have lost its beginning, and nothing would show that
        try:
            return decode_frame(text, self._layout)
        except Damaged as damaged:
            self._reason = str(damaged)
        begin = text.rfind(self._layout.header, 1) if self._layout.header else -1
        if begin < 0 or self._layout.check is None:
            return None
        try:
            frame = decode_frame(text[begin:], self._layout)
        except Damaged:
            return None
        self.tally.discarded += begin
        if self._joined:
            self._give_damage(1)
        return frame

    # ------------------------------------------------------------------ what is given

    def _give(self, frame: Frame) -> None:
        if frame.problem:
            self.tally.unusable += 1
        else:
            self.tally.good += 1
        self._found.append(frame)

    def _give_damage(self, frames: int) -> None:
        self.tally.damaged += frames
        self._found.append(Damage(frames, self._reason or "bytes between frames"))
