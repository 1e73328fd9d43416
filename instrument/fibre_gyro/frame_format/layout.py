"""What a gyro's frames and commands look like, and what follows from it: lengths, times, limits."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from instrument.errors import SettingError
from instrument.fibre_gyro.frame_format.checksums import CheckRule
from instrument.fibre_gyro.frame_format.fields import (
    ANY_STATUS,
    CHECK,
    COUNTS,
    FIXED,
    PARITY,
    CounterRule,
    Field,
    StatusRule,
    is_output,
)
from instrument.fibre_gyro.frame_format.messages import Message

_LONGEST_NUMBER = 24  # characters of a number in text


@dataclass(frozen=True)
class FrameFormat:
    """Frames, commands and line settings of one kind of gyro; made by `parse_frame_format`.

    Attributes
    ----------
    output_rate_hz : float
        Frames per second of the gyro's own clock.
    header, ending : bytes
        Begin and end of every frame; the ending of a line is its terminator.
    separator : bytes
        Between the fields of a line.
    fields : tuple of Field
        In the order in which they are sent, without the checksum.
    commands : dict of str to Message
        Of `COMMANDS` those that the gyro knows.
    accepted, refused : Message or None
        Answers to a command.
    answer_time_s : float
        Longest time until the gyro answers.
    step_scale : float
        Number that is sent for one code per transit time.
    largest_step : float
        Codes; no larger step is injected, in either direction.
    parity : str
        "N", "E" or "O" as pySerial has them.
    poll : Message or None
        What the gyro is asked with for each frame; None for one that sends by itself.
    """

    kind: str
    output_rate_hz: float
    header: bytes
    ending: bytes
    separator: bytes
    fields: tuple[Field, ...]
    check: CheckRule | None = None
    counter: CounterRule | None = None
    status: StatusRule = ANY_STATUS
    commands: dict[str, Message] = field(default_factory=dict)
    accepted: Message | None = None
    refused: Message | None = None
    answer_time_s: float = 0.5
    step_scale: float = 1.0
    largest_step: float = math.inf
    baud_rate: int = 115_200
    data_bits: int = 8
    stop_bits: int = 1
    parity: str = "N"
    poll: Message | None = None

    @property
    def interval_s(self) -> float:
        """Time between two frames in s."""
        return 1.0 / self.output_rate_hz

    @property
    def names(self) -> tuple[str, ...]:
        """Columns that are delivered, without the counter."""
        return tuple(entry.name for entry in self.fields if entry.delivers)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Columns with an output: "counts" alone, or those of several axes."""
        return tuple(name for name in self.names if is_output(name))

    @property
    def unit(self) -> str:
        """Unit of all outputs, one of `FRAME_UNITS`."""
        return next((entry.unit for entry in self.fields if is_output(entry.name)), COUNTS)

    @property
    def turning(self) -> Field | None:
        """The field in which several quantities take turns, None without one."""
        return next((entry for entry in self.fields if entry.cycle), None)

    def output_of(self, axis: str = "") -> str:
        """Column with the output of an axis; of a gyro with one output that one, whatever its axis is called.

        Raises
        ------
        SettingError
            The frames hold no output of this axis.
        """
        if len(self.outputs) == 1:
            return self.outputs[0]
        name = f"{COUNTS}_{axis.lower()}" if axis else self.outputs[0]
        if name not in self.outputs:
            raise SettingError(f"the frames hold the outputs {', '.join(self.outputs)}, none of axis {axis}")
        return name

    @property
    def frame_bytes(self) -> int:
        """Bytes of a frame; in text, of the longest."""
        check = 0 if self.check is None else self.check.size
        ends = len(self.header) + len(self.ending)
        if self.kind == "binary":
            return ends + sum(entry.size for entry in self.fields) + self._field_bits // 8 + check
        numbers = len(self.fields) * (_LONGEST_NUMBER + len(self.separator))
        return ends + numbers + (2 * check + len(self.check.mark) if self.check else 0)

    @property
    def _field_bits(self) -> int:
        return sum(entry.bits for entry in self.fields)

    @property
    def evidence_bits(self) -> int:
        """Bits of a binary frame that only the right one has: header, ending, checksum, counter, fixed ones."""
        known = len(self.header) + len(self.ending) + (self.check.size if self.check else 0)
        bits = 8 * known + (self.counter.modulus.bit_length() - 1 if self.counter else 0)
        for entry in self.fields:
            if entry.name in (FIXED, PARITY, CHECK):
                bits += entry.bits or 8 * entry.size
            elif entry.size:
                bits += entry.size * 8 - (entry.value_bits or entry.size * entry.data_bits)
        return bits

    @property
    def byte_time_s(self) -> float:
        """Time of one byte on the line in s."""
        return (1 + self.data_bits + (self.parity != "N") + self.stop_bits) / self.baud_rate

    @property
    def has_counter(self) -> bool:
        """Whether frames are counted, so that lost ones are known and time is the gyro's own."""
        return self.counter is not None

    @property
    def has_answers(self) -> bool:
        """Whether the gyro acknowledges what it is told."""
        return self.accepted is not None

    @property
    def step_resolution(self) -> float:
        """Smallest difference between two injected steps, in codes."""
        return 1.0 / self.step_scale

    @property
    def step_range(self) -> tuple[float, float]:
        """Lowest and highest step in codes that can be injected."""
        message = self.commands.get("inject")
        limits = message.step_limits() if message is not None else None
        if limits is None:
            return -self.largest_step, self.largest_step
        lowest, highest = (limit / self.step_scale for limit in limits)
        return max(lowest, -self.largest_step), min(highest, self.largest_step)
