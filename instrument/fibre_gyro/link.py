"""The link to a fibre gyro: its output as it comes, and the commands of the self-calibration, on a serial port.

Every time limit is made of named ingredients: the bytes of a frame at the baud rate, the interval of the output,
the time that the gyro takes to answer (from its format), and the delay of the host.
"""

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Self

import serial

from instrument.claims import claim
from instrument.errors import CommandRefused, FrameFormatError, LinkError, NoAcknowledgement, SettingError
from instrument.fibre_gyro.frame_format import FrameFormat, compose
from instrument.fibre_gyro.frame_stream import Answer, Event, FrameStream
from instrument.fibre_gyro.frames import Frame
from instrument.fibre_gyro.recording import HOST_DELAY_S, WRONG, Losses, RecordBuilder, Recording, counts_per_unit

SLICE_S = 0.02  # time in s that one read of the port waits for its bytes

ATTEMPTS = 3
"""How often a command is sent that is not acknowledged. Each sets a state, so twice is as good as once."""

_CHUNK = 4096
_BACKLOG = 1 << 20  # bytes that an operating system may have kept for us; more means that nobody paces them
_LINES_WAITED_FOR = 4  # by a line that has to be borne out
_UNPACED_S = 10.0  # an answer waits behind frames that were sent before, if they come as fast as they are read


class FibreGyroLink:
    """One open link to a fibre gyro; a context manager.

    Parameters
    ----------
    port : str
        What pySerial opens: "/dev/ttyUSB0", "COM3", "socket://host:port" behind a serial-to-Ethernet adapter.
    layout : FrameFormat
        Frames, commands and line settings, from `parse_frame_format`.
    speed : float
        Seconds of the gyro's time in one second; other than 1 for simulated gyros only, inf if they send as fast
        as they are read.
    longest_silence_s : float
        Time in s after which a gyro that sends no good frame is given up.

    Raises
    ------
    LinkError
        If the port cannot be opened.
    """

    def __init__(
        self, port: str, layout: FrameFormat, *, speed: float = 1.0, longest_silence_s: float = 5.0
    ) -> None:
        self.name, self.layout, self.speed = port, layout, speed
        frame_s = layout.frame_bytes * layout.byte_time_s
        self._patience_s = longest_silence_s + 2 * (layout.interval_s / max(speed, 1e-9)) + frame_s
        patience = max(1, math.ceil(_LINES_WAITED_FOR * layout.interval_s / SLICE_S))
        self._stream = FrameStream(layout, patience=patience)
        self._session = Losses()
        self._claim = claim(port)
        try:
            self._port = open_port(port, layout)
        except BaseException:  # Ctrl-C while it is opened, too
            self._claim.release()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the port; never raises."""
        with contextlib.suppress(serial.SerialException, OSError):
            self._port.close()
        self._claim.release()

    @property
    def acknowledges(self) -> bool:
        """Whether the gyro answers commands; without answers nothing proves that one arrived."""
        return self.layout.has_answers

    @property
    def losses(self) -> Losses:
        """What became of all frames of all recordings since the link was opened."""
        return self._session

    # ------------------------------------------------------------------ output

    def record(
        self,
        seconds: float,
        *,
        skip_s: float = 0.0,
        progress: Callable[[float], None] | None = None,
        axis: str = "",
        counts_per_dps: float | None = None,
        inject_at: Sequence[tuple[float, float]] = (),
    ) -> Recording:
        """Record the gyro's output from now on.

        Parameters
        ----------
        seconds : float
            Of the gyro's own time, or of the computer's where the gyro's clock is found to differ. Frames
            that are lost shorten the columns, not the time.
        skip_s : float
            Time that is left out first, for the loop to settle.
        progress : callable, optional
            Called a few times a second with the seconds of the gyro's time that have passed, `skip_s` included.
        axis : str
            Which output is the recording's, where frames hold several; the others become further columns.
        counts_per_dps : float, optional
            Turns an output in deg/s, deg/h or an angle into counts.
        inject_at : sequence of (seconds, codes), optional
            Staircases to inject while it records, `skip_s` included; answers are not waited for.

        Raises
        ------
        LinkError
            If the link is lost, or no good frame comes for too long; the text tells silence from rubbish.
        FrameFormatError
            If frames come at quite another rate than the format says.
        SettingError
            If there is no output of this axis, or nobody says what a count is.
        """
        interval_s, output = self.layout.interval_s, self.layout.output_of(axis)
        counts_per_unit(self.layout.unit, interval_s, counts_per_dps)
        wanted, skip = round(seconds / interval_s), math.ceil(skip_s / interval_s - 1e-6)
        if wanted < 1:
            raise SettingError(f"{seconds:g} s is shorter than one output ({interval_s:g} s); record longer")
        self._catch_up()
        paced = math.isfinite(self.speed) and self.layout.poll is None
        builder = RecordBuilder(self.layout, skip, wanted, paced=paced)
        discarded = self._stream.tally.discarded
        fill = self._fill if self.layout.poll is None else self._fill_by_polls
        to_come = list(inject_at)
        for _ in fill(builder):
            if to_come and (builder.index + 1) * interval_s >= to_come[0][0]:
                number = round(to_come.pop(0)[1] * self.layout.step_scale)
                for answer in (self.layout.accepted, self.layout.refused):
                    if answer is not None:
                        self._stream.expect(compose(answer, number, self.layout.check))
                self._write(compose(self.layout.commands["inject"], number, self.layout.check))
            if progress is not None:
                progress(min((builder.index + 1) * interval_s, (skip + wanted) * interval_s))
            if builder.done:
                self._go_on_if_short(builder, seconds)
            if builder.done:
                break
        recording = builder.recording(
            self._stream.tally.discarded - discarded, output=output, counts_per_dps=counts_per_dps
        )
        self._session += recording.losses
        return recording

    def _go_on_if_short(self, builder: RecordBuilder, seconds: float) -> None:
        """Record more where the gyro's clock runs fast; refuse a rate that no clock can be off by."""
        clock = builder.host_clock()
        if clock is None or not clock.used:
            return
        if abs(clock.stated_s / clock.interval_s - 1) > WRONG:
            raise FrameFormatError(
                f"{self.name} sends {clock.output_rate_hz:.5g} frames a second by the computer's clock, but "
                f"output_rate_hz of the frame format is {self.layout.output_rate_hz:g}; correct it (or per_frame "
                "of the counter)"
            )
        builder.extend(round(seconds / clock.interval_s))

    def _fill(self, builder: RecordBuilder) -> Iterator[None]:
        """Hand on what comes of itself; a step for each piece that holds something."""
        for events, host_s, silent_s in self._arrivals(lambda: builder.index):
            builder.take(events, host_s=host_s, silent_s=silent_s)
            if events:
                yield

    def _fill_by_polls(self, builder: RecordBuilder) -> Iterator[None]:
        """Ask for one frame after the other, at the output rate; a step for each."""
        pace_s = self.layout.interval_s / self.speed if math.isfinite(self.speed) else 0.0
        began = answered_at = time.monotonic()
        poll, received = 0, self._stream.tally.received
        while True:
            due = began + poll * pace_s
            if (early := due - time.monotonic()) > 0:
                time.sleep(early)
            events = self._ask()
            if any(isinstance(event, Frame) for event in events):
                builder.take(events, host_s=self._gyro_time(due), silent_s=0.0, polled=poll)
                answered_at = time.monotonic()
            else:
                builder.take(events, host_s=self._gyro_time(due), silent_s=0.0)
                builder.pass_over(poll)
            yield
            if time.monotonic() - answered_at > self._patience_s:
                raise LinkError(self._why_nothing(self._stream.tally.received - received, builder.index))
            # a computer that was late does not ask twice for one time
            poll = max(poll + 1, math.ceil((time.monotonic() - began) / pace_s - 0.5) if pace_s else 0)

    def _ask(self) -> list[Event]:
        """Send a poll and take what comes until a frame is there, or too late."""
        if self.layout.poll is None:
            return []
        self._stream.restart()
        self._write(compose(self.layout.poll, 0, self.layout.check))
        deadline = time.monotonic() + self.layout.answer_time_s + self.layout.frame_bytes * self.layout.byte_time_s
        events: list[Event] = []
        while time.monotonic() < deadline:
            data = self._read_up_to_frame()
            events += self._stream.feed(data, silent=True)
            if any(isinstance(event, Frame) for event in events):
                break
        return events

    def _arrivals(self, reached: Callable[[], int]) -> Iterator[tuple[list[Event], float, float]]:
        """What comes, when, and after how much silence, until `reached` has stood still for too long."""
        received = self._stream.tally.received
        moved_at, place = time.monotonic(), reached()
        while True:
            began = time.monotonic()
            data = self._read()
            now = time.monotonic()
            events = self._stream.feed(data, silent=not data)
            yield events, self._gyro_time(now), 0.0 if data else self._gyro_time(now - began)
            if reached() != place:
                moved_at, place = now, reached()
            elif now - moved_at > self._patience_s:
                raise LinkError(self._why_nothing(self._stream.tally.received - received, place))

    def _gyro_time(self, seconds: float) -> float:
        # A gyro that sends as fast as it is read keeps no pace that silence could be measured against.
        return seconds * self.speed if math.isfinite(self.speed) else 0.0

    def _why_nothing(self, received: int, place: int) -> str:
        waited = f"for {self._patience_s:.3g} s"
        if received == 0:
            return (
                f"{self.name} sent nothing {waited}; is the gyro on, is it the right port, and are transmit and "
                "receive the right way round?"
            )
        if place >= 0:
            return f"{self.name} stopped sending good frames {waited}; look at the gyro and its cable"
        return (
            f"{self.name} sent {received} bytes {waited}, but not one good frame; compare baud rate "
            f"({self.layout.baud_rate}), header, fields and checksum of the frame format with the data sheet"
        )

    def _catch_up(self) -> None:
        """Throw away what came while nobody listened: it is old, and the rest of it may be lost."""
        if math.isfinite(self.speed):
            with self._lost_link("reading from"):
                drop_backlog(self._port)
        self._stream.restart()

    # ------------------------------------------------------------------ commands

    def inject(self, step_codes: float) -> float:
        """Inject a staircase."""
        lowest, highest = self.layout.step_range
        if not lowest <= step_codes <= highest:
            raise SettingError(
                f"a step of {step_codes:g} codes cannot be injected, the gyro takes {lowest:g} to {highest:g}; "
                "choose a smaller rate"
            )
        number = round(step_codes * self.layout.step_scale)
        self._tell("inject", number)
        return number / self.layout.step_scale

    def close_loop(self) -> None:
        """Let the feedback null the phase. Errors as `inject`."""
        self._tell("close_loop", 0)

    def open_loop(self) -> None:
        """Take the feedback away. Errors as `inject`."""
        self._tell("open_loop", 0)

    def hold_feedback(self) -> None:
        """Freeze the feedback at its present step. Errors as `inject`."""
        self._tell("hold_feedback", 0)

    def _tell(self, name: str, number: int) -> None:
        message = self.layout.commands.get(name)
        if message is None:
            raise SettingError(f"the frame format of this gyro has no command {name}; add it under commands")
        self._catch_up()
        check, accepted, refused = self.layout.check, self.layout.accepted, self.layout.refused
        for attempt in range(ATTEMPTS):
            self._write(compose(message, number, check))
            if accepted is None:
                return
            yes = self._stream.expect(compose(accepted, number, check))
            no = self._stream.expect(compose(refused, number, check)) if refused is not None else None
            answer = self._await_answer({yes, no})
            if answer == no and answer is not None:
                raise CommandRefused(f"{self.name}: the gyro refused {name} ({number}); is it in the right mode?")
            if answer == yes:
                if attempt:
                    self._await_answer(set())  # the answer to an earlier attempt may still come
                return
        raise NoAcknowledgement(
            f"{self.name}: the gyro did not acknowledge {name} in {ATTEMPTS} attempts; check the wire from the "
            "computer to the gyro and the answers in the frame format"
        )

    def _await_answer(self, answers: set[bytes | None]) -> bytes | None:
        """One of the answers, None if none comes in time."""
        limit = self.layout.answer_time_s + HOST_DELAY_S + 2 * self.layout.frame_bytes * self.layout.byte_time_s
        deadline = time.monotonic() + limit + (0.0 if math.isfinite(self.speed) else _UNPACED_S)
        while time.monotonic() < deadline:
            data = self._read()
            for event in self._stream.feed(data, silent=not data):
                if isinstance(event, Answer) and event.message in answers:
                    return event.message
        return None

    # ------------------------------------------------------------------ the port

    def _read(self) -> bytes:
        with self._lost_link("reading from"):
            return bytes(self._port.read(_CHUNK))

    def _read_up_to_frame(self) -> bytes:
        """What is there, at once when it makes a frame."""
        with self._lost_link("reading from"):
            if self.layout.kind == "ascii":
                return bytes(self._port.read_until(self.layout.ending, self.layout.frame_bytes))
            return bytes(self._port.read(max(1, self.layout.frame_bytes - self._stream.held)))

    def _write(self, data: bytes) -> None:
        with self._lost_link("writing to"):
            self._port.write_timeout = (
                self.layout.answer_time_s + HOST_DELAY_S + len(data) * self.layout.byte_time_s
            )
            self._port.write(data)

    @contextlib.contextmanager
    def _lost_link(self, doing: str) -> Iterator[None]:
        try:
            yield
        except (serial.SerialException, OSError) as error:
            raise LinkError(f"{doing} {self.name} failed, the link is lost: {error}") from error


def drop_backlog(port: serial.SerialBase) -> None:
    """Throw away what an open port has kept for us."""
    port.timeout = 0
    dropped = 0
    while dropped < _BACKLOG and (late := port.read(_CHUNK)):
        dropped += len(late)
    port.timeout = SLICE_S


def open_port(port: str, layout: FrameFormat) -> serial.SerialBase:
    """Open a port with the line settings of a format; LinkError if it cannot be opened."""
    options: dict[str, Any] = {"exclusive": True} if port.startswith("/") else {}
    try:
        return serial.serial_for_url(
            port,
            baudrate=layout.baud_rate,
            bytesize=layout.data_bits,
            parity=layout.parity,
            stopbits=layout.stop_bits,
            timeout=SLICE_S,
            **options,
        )
    except (serial.SerialException, OSError, ValueError) as error:
        raise LinkError(
            f"cannot open {port} for the fibre gyro: {error}; is it the right port, and is it free?"
        ) from None
