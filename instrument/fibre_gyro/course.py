"""How outputs move from frame to frame, and which of them jump further than they ever do."""

from __future__ import annotations

from collections import deque

from instrument.fibre_gyro.frame_format.fields import TEMPERATURE, is_output
from instrument.fibre_gyro.frame_format.layout import FrameFormat
from instrument.fibre_gyro.frames import Frame

_FEWEST = 24  # frames before anything is judged
_MEMORY = 64  # frames over which the usual movement is taken
_FAR = 10.0  # times the usual movement; Gaussian noise gets so far once in 1e14
_AROUND = 8  # frames whose range tells whether an output stands out
_BEYOND = 4.5
"""Times the usual movement beyond that range: of Gaussian noise 6.5 standard deviations off, once in 1e8."""


class Course:
    """The usual movement of the outputs, and of the temperature, from one frame to the next."""

    def __init__(self, layout: FrameFormat) -> None:
        steps = {one.name: abs(one.scale) for one in layout.fields}
        floats = {one.name for one in layout.fields if one.kind in ("float", "decimal")}
        self._watched = [
            (place, 0.0 if name in floats else 2.0 * steps[name])
            for place, name in enumerate(layout.names)
            if is_output(name) or name == TEMPERATURE
        ]
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._last: tuple[float, ...] | None = None
        self._recent: deque[tuple[float, ...]] = deque(maxlen=_AROUND)
        self._usual = [0.0] * len(self._watched)
        self._seen = 0

    def follow(self, frame: Frame) -> None:
        """Take a frame that is used."""
        if frame.problem:
            return
        last, self._last = self._last, frame.values
        self._recent.append(frame.values)
        if last is None:
            return
        self._seen += 1
        weight = 1.0 / self._seen if self._seen < _MEMORY else 1.0 / _MEMORY
        values, usuals = frame.values, self._usual
        for number, (place, _) in enumerate(self._watched):
            moved = abs(values[place] - last[place])
            if moved:  # an output that stands still most of the time moves by its smallest step
                usual = usuals[number]
                if usual and moved > 8 * usual and self._seen > _FEWEST:  # a step of the rate is no usual movement
                    moved = 8 * usual
                usuals[number] = usual + weight * (moved - usual)

    def jumps(self, frame: Frame) -> bool:
        """Whether an output lies further from the last one than it ever moves."""
        return self._last is not None and self._apart(self._last, frame.values)

    def stands_out(self, frame: Frame) -> bool:
        """Whether an output lies beyond all the last ones, by far more than it usually moves."""
        return not frame.problem and self._beyond(frame, _BEYOND)

    def is_back(self, frame: Frame) -> bool:
        """Whether the outputs of a frame behind one that stood out lie again where they were before it."""
        return not self._beyond(frame, _BEYOND / 2)

    def leap(self, before: Frame, behind: Frame) -> bool:
        """Whether two neighbours lie further apart than neighbours ever do."""
        return self._apart(before.values, behind.values)

    def _apart(self, one: tuple[float, ...], other: tuple[float, ...]) -> bool:
        if self._seen < _FEWEST:
            return False
        return any(
            usual + smallest > 0 and abs(other[place] - one[place]) > _FAR * (usual + smallest)
            for usual, (place, smallest) in zip(self._usual, self._watched, strict=True)
        )

    def _beyond(self, frame: Frame, far: float) -> bool:
        if self._seen < _FEWEST:
            return False
        for usual, (place, smallest) in zip(self._usual, self._watched, strict=True):
            margin, value = far * (usual + smallest), frame.values[place]
            around = [one[place] for one in self._recent]
            if margin > 0 and not min(around) - margin <= value <= max(around) + margin:
                return True
        return False
