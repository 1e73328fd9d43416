"""The output of a fibre gyro over some time: columns, and what is missing in them."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from instrument.fibre_gyro.frames import ONE_CHARACTER, STANDS_OUT

Floats = NDArray[np.float64]

_ANOTHER_DIGIT = 3 / 5
"""A flipped bit makes another digit of a digit in 3 cases of 8 and something that is none in 5."""


@dataclass(frozen=True)
class Gap:
    """A place where outputs are missing.

    Attributes
    ----------
    after : int
        Index of the last output before it, -1 if the first ones are missing.
    start_s, duration_s : float
        Time of the first output that is missing, and how long they would have lasted.
    missing : int
        Outputs that are missing.
    cause : str
        "frames lost"; "counter jump": the counter went on where it could not, its length is that of the host's
        clock and approximate; "silence": frames are not counted, the length is approximate; "rows missing".
    """

    after: int
    start_s: float
    duration_s: float
    missing: int
    cause: str

    def describe(self) -> str:
        """Say it in a few words."""
        about = "about " if self.cause in ("counter jump", "silence") else ""
        outputs = "1 output" if self.missing == 1 else f"{self.missing} outputs"
        return f"{self.cause}: {about}{outputs} missing {self.start_s:.6g} s after the begin"


@dataclass(frozen=True)
class Losses:
    """What became of the frames of a recording or of a whole session.

    Attributes
    ----------
    good : int
        Frames that were used.
    missing : int
        Frames that the clock says were sent and that were not used; damaged and unusable ones are among them.
    damaged : int
        Frames that came damaged; in frame lengths where more than one in succession was unreadable.
    unusable : int
        Frames that came whole, but with a bad status, a value out of range or a counter that stood still.
    discarded_bytes : int
        Bytes that belong to no whole frame.
    reasons : dict of str to int
        Why frames were damaged or unusable.
    """

    good: int = 0
    missing: int = 0
    damaged: int = 0
    unusable: int = 0
    discarded_bytes: int = 0
    reasons: dict[str, int] = field(default_factory=dict)

    def __add__(self, other: Losses) -> Losses:
        """The losses of both."""
        return Losses(
            self.good + other.good,
            self.missing + other.missing,
            self.damaged + other.damaged,
            self.unusable + other.unusable,
            self.discarded_bytes + other.discarded_bytes,
            dict(Counter(self.reasons) + Counter(other.reasons)),
        )

    @property
    def unseen_digits(self) -> float:
        """Good lines in which, by what was seen, a digit was changed into another; text without a checksum."""
        changed = _ANOTHER_DIGIT * self.reasons.get(ONE_CHARACTER, 0)
        return max(0.0, changed - self.reasons.get(STANDS_OUT, 0))

    def describe(self) -> str:
        """Say it in one clause."""
        if not (self.missing or self.damaged or self.unusable):
            return f"{self.good} frames, none lost"
        why = ", ".join(f"{count} {reason}" for reason, count in sorted(self.reasons.items()))
        parts = (
            f"{self.good} frames used, {self.missing} missing, {self.damaged} damaged, {self.unusable} unusable"
        )
        return f"{parts} ({why})" if why else parts


@dataclass(frozen=True)
class HostClock:
    """The gyro's clock beside the computer's, over one recording.

    Attributes
    ----------
    stated_s : float
        Interval between two outputs by the description of the frames, or by the polls.
    interval_s, interval_u_s : float
        By the computer's clock, and its standard uncertainty, that of the computer's clock included.
    used : bool
        Whether `interval_s` is that of the recording: it differs by more than its uncertainty lets expect.
    """

    stated_s: float
    interval_s: float
    interval_u_s: float
    used: bool

    @property
    def difference_ppm(self) -> float:
        """How much faster the gyro's clock runs than stated, ppm of the output rate."""
        return 1e6 * (self.stated_s / self.interval_s - 1)

    @property
    def u_ppm(self) -> float:
        """Standard uncertainty of `difference_ppm`."""
        return 1e6 * self.interval_u_s / self.interval_s

    @property
    def output_rate_hz(self) -> float:
        """Outputs per second of the computer's clock."""
        return 1 / self.interval_s

    def __str__(self) -> str:
        """Say it in a few words."""
        rate = math.floor(math.log10(max(self.u_ppm, 1e-3)))
        digits = max(0, 1 - rate)
        return f"{self.difference_ppm:+.{digits}f} ppm (u {self.u_ppm:.{digits}f} ppm)"


@dataclass(frozen=True, eq=False)
class Recording:
    """Outputs of a gyro in the order in which they were made.

    Attributes
    ----------
    times : (n,)
        s since the begin of the recording by the gyro's own clock, gaps included.
    counts : (n,)
        The output as the gyro gives it.
    temperature : (n,) or None
        As the format scales it, usually deg C.
    extra : dict of str to (n,)
        Further columns by name.
    interval_s : float
        Time between two outputs.
    clock : str
        What `times` rests on: "counter", "frames" (arrival of frames without a counter, gaps approximate), "polls"
        (the computer asked for each output) or "time column".
    host_clock : HostClock or None
        None where nothing was recorded live, or for too short a time.
    doubts : tuple of str
        What of the numbers shows that the description of the frames may be wrong; sentences.
    """

    times: Floats
    counts: Floats
    temperature: Floats | None
    status: NDArray[np.int64] | None
    extra: dict[str, Floats]
    gaps: tuple[Gap, ...]
    losses: Losses
    interval_s: float
    clock: str
    host_clock: HostClock | None = None
    doubts: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        """From the first output to the end of the last in s, gaps included; 0 without any."""
        return float(self.times[-1] - self.times[0]) + self.interval_s if self.times.size else 0.0

    @property
    def complete(self) -> bool:
        """Whether nothing is missing from its begin to its end."""
        return not self.gaps
