"""Frames out of a stream of bytes that may have holes, extra bytes and flipped bits.

What is delivered passed every check that its format has. What is not is counted. After damage the search for the
next frame begins one byte behind the place where the damaged one began, so that no good frame inside the damaged
stretch is lost, and never more than two frames' bytes are held, or some more where the checksum is weak.

Where the checksum is weak (one byte, or none), the frames that follow have to bear one out, by their length,
counter and checksum: one whole frame in its place with the right counter, or a header that no slip can put there,
or a header of one byte and the counter behind it. A frame out of step, whose counter does not go on by as many
frames as bytes have passed, needs two whole ones: numbers that look like a header may stand in every frame at the
same place, and with an exclusive-or even their sums may be right. Frames without a header are known by what is
fixed in them, so many of them in succession that chance cannot bring it about. An output that jumps and comes
back with the next frame, on a line that damages frames, is not used: a byte lost in a frame, and one inserted
before the next header, leave the bytes of another whole frame in 1 of 256 cases (one byte of sum), and nothing
else tells it from one that was sent. In text without a checksum a changed digit leaves a whole line too: there an
output is not used that lies beyond those before it while those behind are back among them.
"""

import math
from dataclasses import dataclass

from instrument.fibre_gyro.frame_fields import CHECKSUMS
from instrument.fibre_gyro.frame_format import FrameFormat
from instrument.fibre_gyro.frames import ONE_CHARACTER, STANDS_OUT, Damaged, Frame, FrameReader, OutputContinuity

_MOST_ANSWERS = 8  # an old one that still comes is rubbish
_FOLLOWERS = 3  # frames behind one with a weak checksum that may bear it out
_STRONG_CHECK = 2  # bytes of a checksum that lets less than one damaged frame in 65 000 pass
_ENOUGH_BITS = 24  # of evidence that frames without a header need, to begin with
_IN_STEP = 2  # followers that frames without a header need, once their begin is known
_WITNESSES = 3  # lines behind one whose output stands out, all back where the output was: it is damage
_RECENTLY = 2000  # good frames after which a line that damaged one counts as clean again


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
class StreamCounts:
    """What became of the bytes so far."""

    good: int = 0  # frames: delivered as usable; damaged; whole, but with a bad status or a value out of range
    damaged: int = 0
    unusable: int = 0
    received: int = 0  # bytes that came, and those that belong to no frame and no answer
    discarded: int = 0


class FrameStream:
    """Takes bytes as they come and gives what is in them, in order: frames, answers, damage."""

    def __init__(self, layout: FrameFormat, *, patience: int = 1) -> None:
        self._layout, self._patience = layout, patience
        self._header, self._length = layout.header, layout.frame_bytes
        self._reader = FrameReader(layout)
        self._lines = layout.kind == "ascii"
        self._buffer = bytearray()
        self._answers: dict[bytes, None] = {}  # in the order in which they were expected
        self.tally = StreamCounts()
        weak = layout.check is None or layout.check.size < _STRONG_CHECK
        self._confirm = weak and not self._lines
        self._distinct = _is_distinct(layout)
        self._to_begin = 2 if layout.header else math.ceil(_ENOUGH_BITS / max(1, layout.evidence_bits))
        self._followers = max(_FOLLOWERS, self._to_begin)
        self._course = OutputContinuity(layout) if weak and (not self._lines or layout.check is None) else None
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
        self._held: list[Frame | Damage] = []  # a line whose output stands out, and what came behind it
        self._silent_reads = 0
        self._last_damage = -_RECENTLY  # good frames before it
        if self._course is not None:
            self._course.forget()

    @property
    def held(self) -> int:
        """Bytes that may yet become a frame."""
        return len(self._buffer)

    def feed(self, data: bytes, *, silent: bool = False) -> list[Event]:
        """Take bytes."""
        self.tally.received += len(data)
        self._buffer += data
        self._found: list[Event] = []
        if self._lines:
            self._take_lines()
            self._silent_reads = self._silent_reads + 1 if silent else 0
            if self._silent_reads >= self._patience:
                self._let_held_go()
        else:
            self._take_binary(silent)
        return self._found

    # ------------------------------------------------------------------ binary frames

    def _take_binary(self, silent: bool) -> None:
        position, longest = 0, self._longest()
        while position < len(self._buffer):
            rest = self._buffer[position : position + longest]
            answer = (
                next((answer for answer in self._answers if rest.startswith(answer)), None)
                if self._answers
                else None
            )
            if answer is not None:
                self._end_of_damage()
                self._found.append(Answer(answer))
                position += len(answer)
            elif self._may_begin(rest):
                break
            else:
                frame = self._frame_at(rest)
                good = frame is not None and self._borne_out(frame, rest[self._length :], silent)
                if good is None:
                    break
                if frame and good:
                    self._end_of_damage()
                    self._counter = frame.counter
                    self._give(frame)
                    position += self._length
                else:
                    position = self._behind_damage(position)
        del self._buffer[:position]

    def _longest(self) -> int:
        longest = max(self._length + len(self._header), *map(len, self._answers), 1)
        return longest + self._followers * self._length if self._confirm else longest

    def _may_begin(self, rest: bytearray) -> bool:
        """Whether these bytes may become an answer or a frame and are too few for it."""
        if self._answers and any(len(rest) < len(answer) and answer.startswith(rest) for answer in self._answers):
            return True
        if len(rest) >= self._length:
            return False
        have = min(len(rest), len(self._header))
        return rest[:have] == self._header[:have]

    def _frame_at(self, rest: bytearray) -> Frame | None:
        """The frame at the begin of these bytes, if one stands there."""
        try:
            return self._reader.read(bytes(rest[: self._length]))
        except Damaged as damaged:
            self._reason = self._reason or str(damaged)
            return None

    def _borne_out(self, frame: Frame, behind: bytearray, silent: bool) -> bool | None:
        """Whether what stands behind a frame shows that it is one; None while too little of it has come."""
        if not self._confirm:
            return True
        in_step = self._in_step(frame)
        if (silent and not behind) or any(behind.startswith(answer) for answer in self._answers):
            return in_step or not self._joined
        if not self._header:
            good = self._continued(frame, behind, _IN_STEP if in_step else self._to_begin, silent)
        elif in_step and self._next_begins(frame, behind):
            good = True
        elif not any(start.startswith(behind[: len(start)]) for start in self._starts()):
            self._reason = self._reason or "no header behind it"
            return False
        else:
            good = self._followed(frame, behind, 1 if in_step or self._distinct else 2, silent)
        return self._in_course(frame, behind, silent) if good else good

    def _in_step(self, frame: Frame) -> bool:
        """Whether the frame stands where the one before lets expect it, by its counter or right behind it."""
        counted = self._layout.counter is not None and frame.counter is not None
        if not self._header and self._bad_bytes:
            return False
        if not (self._joined and counted):
            return self._joined and self._bad_bytes == 0
        # whether the counter went on by as many frames as the bytes since the last one make
        between = 1 + round(self._bad_bytes / self._length)
        return self._counter is not None and self._counts(self._counter, frame.counter, between)

    def _next_begins(self, frame: Frame, behind: bytearray) -> bool:
        """Whether the next frame begins right behind, by more than one byte that other numbers could be too."""
        if not behind.startswith(self._header):
            return False
        if self._distinct or self._layout.counter is None or frame.counter is None:
            return self._distinct
        follower = behind[: self._length]
        counter = self._reader.counter_of(bytes(follower))
        return counter is not None and self._counts(frame.counter, counter, 1)

    def _followed(self, frame: Frame, behind: bytearray, needed: int, silent: bool) -> bool | None:
        """Whether enough of the next frames are whole in their places."""
        length, whole = self._length, 0
        for place in range(1, _FOLLOWERS + 1):
            slot = behind[(place - 1) * length : place * length]
            if len(slot) < length:
                return (whole > 0) if silent else None
            follower = self._frame_at(slot)
            whole += follower is not None and self._counts(frame.counter, follower.counter, place)
            if whole >= needed:
                return True
            if whole == 0 and place == _FOLLOWERS - 1:
                break
        self._reason = self._reason or "no whole frame behind it"
        return False

    def _continued(self, frame: Frame, behind: bytearray, needed: int, silent: bool) -> bool | None:
        """Whether so many frames without a header follow in unbroken succession."""
        length = self._length
        before = frame
        for place in range(1, needed + 1):
            slot = behind[(place - 1) * length : place * length]
            if len(slot) < length:
                return (place > 1) if silent else None
            follower = self._frame_at(slot)
            if (
                follower is None
                or not self._counts(before.counter, follower.counter, 1)
                or (self._course is not None and self._course.leap(before, follower))
            ):
                self._reason = self._reason or "no whole frame behind it"
                return False
            before = follower
        return True

    def _counts(self, before: int | None, behind: int | None, frames: int) -> bool:
        """Whether a counter went on by so many frames; without one it always did."""
        rule = self._layout.counter
        if rule is None or before is None or behind is None:
            return True
        return (behind - before - frames * rule.per_frame) % rule.modulus == 0

    def _in_course(self, frame: Frame, behind: bytearray, silent: bool) -> bool | None:
        """Refuse a frame whose output jumps and comes back, on a line that damages frames."""
        if not self._line_is_bad() or self._course is None or not self._course.jumps(frame):
            return True
        length = self._length
        for place in range(_FOLLOWERS):
            slot = behind[place * length : (place + 1) * length]
            if len(slot) < length:
                return True if silent else None
            follower = self._frame_at(slot)
            if follower is not None and self._counts(frame.counter, follower.counter, place + 1):
                if self._course.jumps(follower):
                    return True  # it is the gyro that moves
                self._reason = "output jumps and comes back"
                return False
        return True

    def _line_is_bad(self) -> bool:
        return self.tally.good - self._last_damage < _RECENTLY

    def _starts(self) -> list[bytes]:
        """How what is worth finding begins."""
        return [self._header, *self._answers]

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
        length = self._length
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
            self._let_held_go()
            self._found.append(Answer(text))
        elif text or self._too_long:
            frame = self._frame_in(text)  # of several that lost their ends the last one is whole
            self._reason = "line too long" if self._too_long else self._reason
            if frame is None:
                if self._joined:
                    self._give_damage(1)
                self._joined = True
                return False
            self._give_line(frame)
        else:
            return False
        self._joined = True
        return True

    def _give_line(self, frame: Frame) -> None:
        """Give a frame; on a line that damages frames hold one whose output stands out, until others follow."""
        if self._held:
            self._held.append(frame)
            self._judge_held()
        elif self._course is not None and self._line_is_bad() and self._course.stands_out(frame):
            self._held.append(frame)
        else:
            self._give(frame)

    def _judge_held(self, *, now: bool = False) -> None:
        """Give or refuse the line that is held, once those behind it show which, or `now`."""
        first, *behind = self._held
        witnesses = [one for one in behind if isinstance(one, Frame) and not one.problem]
        stays = self._course is None or not all(self._course.is_back(one) for one in witnesses)
        if not (stays or now or len(witnesses) >= _WITNESSES):
            return
        self._held = []
        if isinstance(first, Frame) and (stays or not witnesses):
            self._give(first)
        else:
            self._reason = STANDS_OUT
            self._give_damage(1)
        for event in behind:
            if isinstance(event, Frame):
                self._give_line(event)
            else:
                (self._held or self._found).append(event)

    def _let_held_go(self) -> None:
        while self._held:
            self._judge_held(now=True)

    def _frame_in(self, text: bytes) -> Frame | None:
        """The frame of a line; of one that lost its line end, the frame at its end if a checksum proves it."""
        if not self._joined and not self._header:
            return None  # it may have lost its beginning, and nothing would show that
        try:
            return self._reader.read(text)
        except Damaged as damaged:
            unproven = self._layout.check is None and self._reader.has_one_character_changed(text)
            self._reason = ONE_CHARACTER if unproven else str(damaged)
        begin = text.rfind(self._header, 1) if self._header else -1
        if begin < 0 or self._layout.check is None:
            return None
        try:
            frame = self._reader.read(text[begin:])
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
        if self._course is not None:
            self._course.follow(frame)
        self._found.append(frame)

    def _give_damage(self, frames: int) -> None:
        self.tally.damaged += frames
        self._last_damage = self.tally.good
        (self._held or self._found).append(Damage(frames, self._reason or "bytes between frames"))


def _is_distinct(layout: FrameFormat) -> bool:
    """Whether a frame with one byte lost or inserted cannot put a header in its place."""
    # So it is with a header of two bytes or more that does not begin anew within itself, and with one byte whose
    # highest bits no other byte of the frame can have.
    header = layout.header
    if len(header) > 1:
        return header[:1] not in header[1:]
    sums = [one.check for one in layout.fields if one.check is not None]
    if layout.check is not None:
        sums.append(layout.check.checksum)
    narrow = all(one is CHECKSUMS["xor8"] for one in sums) and (
        layout.check is None or layout.check.skips == header
    )
    widest = max(8 if one.bits else one.data_bits for one in layout.fields if one.check is None)
    return len(header) == 1 and narrow and header[0] >> widest > 0 and not layout.ending
