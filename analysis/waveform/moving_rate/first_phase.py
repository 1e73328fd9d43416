"""The phase of a beat read from its samples, without any model of how the rate moves.

A gyro's beat is A sin(phi) with phi always rising: between a crest and the trough that follows, phi is the arc
sine of the sample. Wander of any size, sidebands and a fundamental that is nowhere in the spectrum do not matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Bools, Floats, Indices
from analysis.waveform.moving_rate.polynomials import polynomials

SWUNG = 0.25
"""Share of the amplitude by which the signal must cross its middle to begin the next half period."""

REACHED = 0.9
"""Share of the amplitude from which on the first and the last extreme of a record count as a crest."""

QUIET = 0.06
"""Noise over amplitude at which crests are found without smoothing."""

KEPT_LINES = 3
"""Smoothing keeps at least so many times the frequency of the strongest line."""

FEWEST_CRESTS = 6
ENVELOPE_TERMS = 4

STEP_STANDS_OUT = 12.0
"""A step of the offset is believed where it lowers the scatter of the middles by this factor of its variance, in
logarithms times their number; a wrong one costs little, since the fit drops it again."""


NOT_APART = 1e-9
"""Determinant of two columns from which on they count as one."""


@dataclass(frozen=True)
class FirstPhase:
    """phase (N,) rad; amplitude, offset (N,) as low polynomials of time, the offset with its step.

    trusted : (N,) samples at which the step, if there is one, leaves no doubt about the phase
    step : number of the first sample behind a step of the offset, or None
    """

    phase: Floats
    amplitude: Floats
    offset: Floats
    trusted: Bools
    step: int | None


def first_phase(values: Floats, mask: Floats) -> FirstPhase | None:
    """Read the phase of one centred record (N,); `mask` is 0 where a sample is missing. None: there is no beat."""
    valid = mask > 0
    places = np.arange(values.size)
    filled = values if valid.all() else np.interp(places, places[valid], values[valid])
    smooth = _smoothed(filled)
    crests, signs = _crests(smooth)
    if crests.size < FEWEST_CRESTS:
        return None
    envelope = _Envelope.of(crests[1:-1], smooth[crests[1:-1]], signs[1:-1], values.size)
    if np.any(envelope.amplitude <= 0):
        return None
    level = np.clip((smooth - envelope.offset) / envelope.amplitude, -1.0, 1.0)
    passed = crests.copy()
    reached = np.abs(level[crests]) > REACHED
    if passed[0] == 0 or not reached[0]:
        passed[0] = -1
    if passed[-1] == values.size - 1 or not reached[-1]:
        passed[-1] = values.size
    # half turns: even while the beat rises
    half_turns = np.searchsorted(passed, places, side="right") + (signs[0] < 0)
    phase = half_turns * np.pi + np.where(half_turns % 2 == 0, 1, -1) * np.arcsin(level)
    return FirstPhase(_bridged(phase, valid), envelope.amplitude, envelope.offset, envelope.trusted, envelope.step)


def _smoothed(values: Floats) -> Floats:
    """The record without the noise that would make crests of its own."""
    lines = np.fft.rfft(values)
    power = np.abs(lines) ** 2
    power[0] = 0.0
    bins = np.arange(power.size)
    noise = np.sqrt(np.median(power[power.size // 2 :]) / (np.log(2) * values.size))
    allowed = (QUIET * np.ptp(values) / 2 / max(noise, 1e-300)) ** 2 * power.size
    if allowed > power.size:
        return values
    kept = max(allowed, KEPT_LINES * float(power.argmax()), 1.0)
    return np.fft.irfft(lines * np.exp(-np.log(2) * (bins / kept) ** 2), values.size)


def _crests(values: Floats) -> tuple[Indices, Floats]:
    """Places of highest and lowest samples in turn, and which is which (1, -1), by a trigger with hysteresis."""
    middle, half = (values.max() + values.min()) / 2, np.ptp(values) / 2
    side = np.sign(values - middle) * (np.abs(values - middle) > SWUNG * half)
    seen = np.maximum.accumulate(np.where(side != 0, np.arange(values.size), 0))
    side = side[np.maximum(seen, int(np.argmax(side != 0)))]
    starts = np.concatenate([[0], np.flatnonzero(np.diff(side)) + 1])
    pieces = np.split(values * side, starts[1:])
    return starts + np.array([int(piece.argmax()) for piece in pieces]), side[starts]


@dataclass(frozen=True)
class _Envelope:
    amplitude: Floats
    offset: Floats
    trusted: Bools
    step: int | None

    @staticmethod
    def of(crests: Indices, heights: Floats, signs: Floats, n_samples: int) -> _Envelope:
        """Amplitude and offset from what two neighbouring crests have in common, and in what they differ."""
        middles, halves = (heights[1:] + heights[:-1]) / 2, (heights[:-1] - heights[1:]) / 2 * signs[:-1]
        terms = min(ENVELOPE_TERMS, max(1, middles.size // 3))
        columns = polynomials(n_samples).values[:terms]
        between = (crests[1:] + crests[:-1]) // 2
        amplitude = np.linalg.lstsq(columns[:, between].T, halves, rcond=None)[0] @ columns
        trusted, places = np.ones(n_samples, dtype=bool), np.arange(n_samples)
        number = _step_between(columns[:, between], middles)
        if number is None:
            return _Envelope(
                amplitude, np.linalg.lstsq(columns[:, between].T, middles, rcond=None)[0] @ columns, trusted, None
            )
        # Middle `number` belongs to two crests, one on either side of the step.
        step = int(between[number])
        trusted[crests[number] : crests[number + 1] + 1] = False
        behind = np.concatenate([columns, [(places >= step).astype(float)]])
        others = np.arange(middles.size) != number
        found = np.linalg.lstsq(behind[:, between[others]].T, middles[others], rcond=None)[0]
        return _Envelope(amplitude, found @ behind, trusted, step)


def _step_between(columns: Floats, middles: Floats) -> int | None:
    """Which of the middles has a step of the offset between its two crests."""
    count = middles.size
    if count < columns.shape[0] + 4:
        return None
    smooth = np.linalg.qr(columns.T)[0]
    rough = middles - smooth @ (smooth.T @ middles)
    # For each middle the gain of two more columns: 1 behind it, and, since it lies half-way up, one for itself.
    free = np.eye(count) - smooth @ smooth.T
    behind = np.cumsum(free[:, ::-1], axis=1)[:, ::-1] - free
    with_behind = np.cumsum(rough[::-1])[::-1] - rough
    of_behind = np.cumsum(behind[::-1], axis=0)[::-1].diagonal() - behind.diagonal()
    of_both, of_itself = behind.diagonal(), free.diagonal()
    inner = slice(1, -1)
    aa, ab, bb, a, b = (v[inner] for v in (of_behind, of_both, of_itself, with_behind, rough))
    determinant = aa * bb - ab**2
    known = determinant > NOT_APART
    gains = np.where(known, bb * a**2 - 2 * ab * a * b + aa * b**2, 0.0) / np.where(known, determinant, 1.0)
    best, scatter = int(gains.argmax()), float(rough @ rough)
    gain = count * np.log(scatter / max(scatter - gains[best], 1e-12 * scatter)) if scatter > 0 else 0.0
    return best + 1 if gain > STEP_STANDS_OUT + 2 * np.log(count) else None


def _bridged(phase: Floats, valid: Bools) -> Floats:
    """The phase with the whole turns put in that were lost where samples are missing."""
    edges = np.flatnonzero(np.diff(np.concatenate([[1], valid.astype(int), [1]])))
    speed = (phase[-1] - phase[0]) / phase.size
    for start, stop in edges.reshape(-1, 2):
        if start > 0 and stop < phase.size and (stop - start) * speed > 1:
            expected = speed * (stop - start + 1)
            turns = np.rint((expected - (phase[stop] - phase[start - 1])) / (2 * np.pi))
            phase[start:stop] += np.linspace(0, 2 * np.pi * turns, stop - start)
            phase[stop:] += 2 * np.pi * turns
    return phase
