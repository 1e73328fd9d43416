"""Time of each frame from the counter that it carries."""

from __future__ import annotations

from dataclasses import dataclass

from instrument.fibre_gyro.frame_format import CounterRule

HOST_DELAY_S = 0.5
"""How much sooner than another a frame can come through a USB adapter and the host's own buffers."""


@dataclass(frozen=True)
class Tick:
    """Place of a frame in time.

    Attributes
    ----------
    index : int
        Intervals since the first frame.
    cause : str
        Of the gap before the frame; empty if there is none.
    """

    index: int
    cause: str = ""


class CounterClock:
    """Counts intervals from frame to frame, over wraps of the counter and over frames that are missing.

    Parameters
    ----------
    rule : CounterRule or None
        None for frames without a counter: then damage and silence are all that tells of missing frames.
    interval_s : float
        Between two frames.
    """

    def __init__(self, rule: CounterRule | None, interval_s: float) -> None:
        self._rule, self._interval_s = rule, interval_s
        self._last: int | None = None
        self._index = 0
        self._last_host_s = 0.0
        self._lead_s = 0.0  # most that the gyro's time was ahead of the host's since the first frame
        self._first_host_s = 0.0

    def place(self, counter: int | None, *, host_s: float, silent_s: float, damaged: int) -> Tick | None:
        """Place the next frame.

        Parameters
        ----------
        counter : int or None
            What the frame carries.
        host_s : float
            When it was read, in s of the gyro's time.
        silent_s : float
            How long nothing came before it although somebody listened.
        damaged : int
            Damaged frames just before it.

        Returns
        -------
        Tick or None
            None if the counter stands still: then the frame is a copy of the one before, or none at all.
        """
        if self._last is None:
            self._first_host_s = host_s
            return self._keep(0, counter, host_s, "")
        if self._rule is None or counter is None:
            heard = silent_s < HOST_DELAY_S / 2 + 3 * self._interval_s  # frames often come several at once
            passed = 1 + (damaged if heard else max(damaged, round(silent_s / self._interval_s) - 1))
            return self._keep(passed, counter, host_s, self._without_counter(passed, damaged))
        ticks = (counter - self._last) % self._rule.modulus
        silent_ticks = silent_s / self._interval_s * self._rule.per_frame
        ticks += max(0, round((silent_ticks - ticks) / self._rule.modulus)) * self._rule.modulus
        if ticks == 0:
            return None
        passed, rest = divmod(ticks, self._rule.per_frame)
        if rest or self._is_ahead(passed, host_s):
            passed = max(1, round((host_s - self._last_host_s) / self._interval_s))
            return self._keep(passed, counter, host_s, "counter jump")
        return self._keep(passed, counter, host_s, "frames lost" if passed > 1 else "")

    @staticmethod
    def _without_counter(passed: int, damaged: int) -> str:
        if passed == 1:
            return ""
        return "frames lost" if passed == damaged + 1 else "silence"

    def _is_ahead(self, passed: int, host_s: float) -> bool:
        """Whether that many frames cannot have been sent since the one before: the counter was set anew."""
        lead_s = (self._index + passed) * self._interval_s - (host_s - self._first_host_s)
        return passed > 1 and lead_s > self._lead_s + HOST_DELAY_S

    def _keep(self, passed: int, counter: int | None, host_s: float, cause: str) -> Tick:
        self._index += passed
        self._last = -1 if counter is None else counter
        self._last_host_s = host_s
        self._lead_s = max(self._lead_s, self._index * self._interval_s - (host_s - self._first_host_s))
        return Tick(self._index, cause)
