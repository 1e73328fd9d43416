"""One record of beat and single beams: how far each beam swings with the beat, and with which phase.

What the swings of many records say together is in `analysis.single_beams`.
"""

import math
from dataclasses import dataclass
from enum import IntFlag

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Bools, Complexes, Floats, Stacked
from analysis.waveform.series import step_by_samples

HARMONICS = 8  # that are fitted at once: those left out would leak into the fundamental
_HIGHEST = 0.45  # of them, cycles a sample
_FASTEST, _SEEN, _PASSES = 0.5, 6.0, 3  # motion that is followed: over the beat, its size over the median
_LOST = 0.2  # power beside the lines over that of the fundamental, where the rate moves too much
_LARGEST = 0.5  # AC over DC of a channel that shows the fringes rather than a beam


class BeamsFlag(IntFlag):
    """Bits of `BeamsFit.flags`; the lower-case name is the one used in JSON."""

    CLIPPED = 1
    """A beam reaches the end of the converter's range in most records: it is not used."""
    DARK = 2
    """A beam's channel shows no light, or no swing at the beat."""
    SHOWS_THE_BEAT = 4
    """A beam's channel swings like the beat itself: another photodiode is connected to it."""
    NO_LEVEL = 8
    """Nobody stated the DC level of a beam: only the phase of its swing counts."""
    RECORDS_LEFT_OUT = 16
    """In some records the rate moves too much for the swing of the beams."""
    MISFIT = 32
    """Beat and beams do not fit one laser within their noise; the uncertainty is enlarged."""
    ROUTES_DIFFER = 64
    """Harmonics, beams, frequencies and dead band give different lock-in rates."""
    SEVERAL_SOLUTIONS = 128
    """Another lock-in rate explains the records as well; the interval holds all."""
    NOT_SIGNIFICANT = 256
    """The lock-in rate does not stand out of its uncertainty."""


@dataclass(frozen=True)
class BeamModulation(Stacked):
    """Swing of the single beams at the beat frequency, of n records of two beams; nan where there is none.

    modulation : (n, 2) complex, AC over DC, its phase against that of the beat's fundamental
    modulation_u : (n, 2) standard uncertainty of its real and of its imaginary part, but for the phase of the beat
    phase_u : (n,) standard uncertainty of that phase, rad: it turns both beams
    beat_over_level : (n, 2) amplitude of the beat in volts over the DC level of the beam
    flags : bits of `BeamsFlag`, of both beams
    """

    modulation: Complexes
    modulation_u: Floats
    phase_u: Floats
    beat_over_level: Floats
    flags: int


def beam_modulation(
    beat: ArrayLike,
    beams: ArrayLike,
    sample_interval: float,
    *,
    beat_frequency: ArrayLike,
    level: ArrayLike,
    clipped: ArrayLike | None = None,
    ac_corner_hz: float = 0.0,
) -> BeamModulation:
    """Modulation of the single beams against the phase of the beat, by least squares at its frequency.

    Parameters
    ----------
    beat : (n, n_samples)
        Volts of the photodiode that sees the fringes.
    beams : (n_beams, n, n_samples)
        Volts of the photodiodes of one beam, or of both, sampled at the same instants.
    sample_interval : float
        Seconds.
    beat_frequency : (n,)
        Hz, as `estimate_lock_in` found it; nan for a record without a beat.
    level : (n_beams,)
        DC level of each beam, V; nan where nobody knows it. Then the size of a modulation has no meaning.
    clipped : (n_beams, n, n_samples) of bool, optional
    ac_corner_hz : float
        Corner of an AC coupling in front of the beams' channels, whose effect is taken out.

    Raises
    ------
    ValueError
        Channels of different length, or more beams than two.
    """
    whole, single = np.asarray(beat, dtype=np.float64), np.asarray(beams, dtype=np.float64)
    if single.ndim != 3 or not 1 <= len(single) <= 2 or single.shape[1:] != whole.shape:
        raise ValueError(f"beams must have shape (1 or 2, {whole.shape[0]}, {whole.shape[1]}), not {single.shape}")
    frequency = np.asarray(beat_frequency, dtype=np.float64)
    swing = np.full((len(whole), 2), np.nan, dtype=np.complex128)
    swing_u, over = np.full(swing.shape, np.nan), np.full(swing.shape, np.nan)
    phase_u = np.full(len(whole), np.nan)
    beating = np.flatnonzero(frequency > 0)
    waves = _waves(whole[beating], sample_interval * frequency[beating])
    fundamental, fundamental_u, left = _line(whole[beating], waves)
    followed = np.var(left, axis=-1) < _LOST * np.abs(fundamental) ** 2
    rows, waves, first, first_u = (one[followed] for one in (beating, waves, fundamental, fundamental_u))
    flags = 0 if followed.all() else int(BeamsFlag.RECORDS_LEFT_OUT)
    phase_u[rows] = first_u / np.abs(first)
    turn = (1 - 1j * ac_corner_hz / frequency[rows]) * np.abs(first) / first
    for number, volts in enumerate(single):
        cut = np.zeros(rows.size, bool) if clipped is None else np.any(np.asarray(clipped)[number][rows], axis=-1)
        line, line_u, _ = _line(volts[rows], waves)
        dc = float(np.broadcast_to(level, len(single))[number])
        if (problem := _problem(line, line_u, dc, cut)) is not None:
            flags |= int(problem)
            continue
        if math.isnan(dc):
            flags, dc = flags | int(BeamsFlag.NO_LEVEL), 1.0  # a modulation in volts, the same for all rates
        kept = rows[~cut]
        swing[kept, number] = (line * turn / dc)[~cut]
        swing_u[kept, number] = (line_u * np.abs(turn) / dc)[~cut]
        over[kept, number] = (np.abs(first) / dc)[~cut]
    return BeamModulation(swing, swing_u, phase_u, over, flags)


def _problem(line: Complexes, line_u: Floats, level: float, cut: Bools) -> BeamsFlag | None:
    """Why a beam's channel cannot be used; ``None`` if it can."""
    if 2 * cut.sum() > cut.size:
        return BeamsFlag.CLIPPED
    if level <= 0 or not np.any(np.abs(line) > 3 * line_u):
        return BeamsFlag.DARK
    return BeamsFlag.SHOWS_THE_BEAT if np.median(np.abs(line)) > _LARGEST * level else None


def _waves(volts: Floats, frequency: Floats) -> Complexes:
    """Fundamental of size 1 (n, n_samples), which follows the phase of beats of some cycles a sample (n,)."""
    from scipy.fft import dct, idct  # beams are rare

    n, rows = volts.shape[-1], np.arange(len(volts))
    waves: Complexes = np.exp(2j * np.pi * frequency[:, np.newaxis] * (np.arange(n) - (n - 1) / 2))
    slow = np.arange(n) < 2 * _FASTEST * n * frequency[:, np.newaxis]
    for _ in range(_PASSES):
        line, _, left = _line(volts[rows], waves[rows])
        # cosines of half periods: a phase need not end as it began
        moves = dct((2 * left * np.conj(waves[rows]) / line[:, np.newaxis]).imag, norm="ortho")
        size = np.abs(moves)
        seen = slow[rows] & (size > _SEEN * np.median(size, axis=-1, keepdims=True))
        moving = seen.any(axis=-1)
        rows = rows[moving]
        if not rows.size:
            break
        waves[rows] *= np.exp(1j * idct(np.where(seen, moves, 0.0)[moving], norm="ortho"))
    return waves


def _line(volts: Floats, waves: Complexes) -> tuple[Complexes, Floats, Floats]:
    """Complex amplitude (n,) of a fundamental (n, n_samples), its u for each part, and what is left."""
    count = (there := np.isfinite(volts)).sum(axis=-1)
    centred = np.where(there, volts - np.nanmean(volts, axis=-1, keepdims=True), 0.0)
    tangents, wave = np.ones((len(volts), 2 * HARMONICS + 1, volts.shape[-1])), np.ones_like(waves)
    turned = np.abs(np.angle(np.mean(waves[:, 1:] * np.conj(waves[:, :-1]), axis=-1))) / (2 * np.pi)
    for order in range(1, HARMONICS + 1):
        wave = wave * waves * (order * turned < _HIGHEST)[:, np.newaxis]
        tangents[:, 2 * order - 1], tangents[:, 2 * order] = wave.real, -wave.imag
    tangents *= there[:, np.newaxis]
    change = step_by_samples(tangents, centred).solve()
    left = centred - np.matmul(change[:, np.newaxis], tangents)[:, 0]
    noise = np.sqrt(np.sum(left**2, axis=-1) / np.maximum(count - 2 * HARMONICS - 1, 1))
    return change[:, 1] + 1j * change[:, 2], noise * np.sqrt(2 / np.maximum(count, 1)), left
