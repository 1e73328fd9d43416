"""What a channel of known frequency response does to the harmonic ratio, and how to undo it.

A linear channel multiplies harmonic n of the beat by its response H(n f). Without a time origin that makes

    rho_measured = rho H(2f) |H(f)| / H(f)^2                                                           (1)

far above lock-in. Closer to it the fit of the waveform leans on the higher harmonics too; then the factor is that
of the geometric series which fits H(n f) q^(n-1) best, found by the same least squares.

The gain of the laser acts like one more pole, once for each step from a harmonic to the next.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Bools, Complexes, Floats, OutsideResponse
from analysis.lockin_rate import LockInEstimate, with_ratio

EXPLAINED = 2.5
"""Uncertainty of the ratio over the size of what it leaves on higher harmonics (`waveform.misfit`), and some
room for what the fit of a bent waveform adds."""

HARMONICS = 24  # of the series that is fitted; 0.7^24 is 2e-4, and a slow channel passes less of them

ROUNDS = 40
STEP = 1e-4


def low_pass(frequency: float | Floats, corner_hz: float | Floats) -> Complexes:
    """Gain of one pole at frequencies in Hz; an infinite corner passes everything."""
    return np.asarray(1 / (1 + 1j * (np.asarray(frequency, dtype=np.float64) / corner_hz)))


def high_pass(frequency: float | Floats, corner_hz: float | Floats) -> Complexes:
    """Gain of AC coupling at frequencies in Hz; a corner at 0 passes everything."""
    f = np.asarray(frequency, dtype=np.float64)
    return np.asarray(f / (f - 1j * np.asarray(corner_hz)))


def low_pass_on_ratio(frequency: float | Floats, corner_hz: float | Floats) -> Complexes:
    """Factor (1) on rho of one pole, at a beat frequency in Hz; its size is that on r."""
    f = np.asarray(frequency, dtype=np.float64)
    return _on_ratio(low_pass(f, corner_hz), low_pass(2 * f, corner_hz))


def high_pass_on_ratio(frequency: float | Floats, corner_hz: float | Floats) -> Complexes:
    """Factor (1) on rho of AC coupling, at a beat frequency in Hz; its size is that on r."""
    f = np.asarray(frequency, dtype=np.float64)
    return _on_ratio(high_pass(f, corner_hz), high_pass(2 * f, corner_hz))


def gain_on_ratio(frequency: float | Floats, corner_hz: float | Floats) -> Complexes:
    """Factor on rho of the laser's gain, which follows the intensity up to g_c/2 pi = `corner_hz` only."""
    return low_pass(frequency, corner_hz)


def tail_on_ratio(frequency: float | Floats, size: float, after_s: float) -> Complexes:
    """Factor (1) on rho of a thermal tail: a share `size` of every step that comes after a time."""
    first, second = (1 + size * low_pass(n * np.asarray(frequency), 1 / (2 * np.pi * after_s)) for n in (1, 2))
    return _on_ratio(first, second)


def _on_ratio(first: Complexes, second: Complexes) -> Complexes:
    """Equation (1): H(2f) |H(f)| / H(f)^2."""
    return np.asarray(second / first * np.abs(first) / first)


@dataclass(frozen=True)
class ChannelResponse:
    """Frequency response of a channel, a product of what is given.

    low_pass_hz, low_pass_u_hz : corners of single poles, and their standard uncertainties
    high_pass_hz, high_pass_u_hz : corners of single-pole AC couplings
    table_hz, table_gain, table_phase_rad : measured response, frequencies rising
    table_gain_u : relative standard uncertainty of each gain, table_phase_u_rad : of each phase
    """

    low_pass_hz: Sequence[float] = ()
    low_pass_u_hz: Sequence[float] = ()
    high_pass_hz: Sequence[float] = ()
    high_pass_u_hz: Sequence[float] = ()
    table_hz: Sequence[float] = ()
    table_gain: Sequence[float] = ()
    table_phase_rad: Sequence[float] = ()
    table_gain_u: float = 0.0
    table_phase_u_rad: float = 0.0

    def __post_init__(self) -> None:
        for name in ("low_pass", "high_pass"):
            corners, us = (np.asarray(getattr(self, name + end), dtype=float) for end in ("_hz", "_u_hz"))
            if np.any(~np.isfinite(corners)) or np.any(corners <= 0):
                raise ValueError(f"{name}_hz must hold positive corner frequencies (Hz)")
            if us.size not in (0, corners.size) or np.any(~np.isfinite(us)) or np.any(us < 0):
                raise ValueError(f"{name}_u_hz must hold one uncertainty for each corner, or none")
        table = [np.asarray(v, dtype=float) for v in (self.table_hz, self.table_gain, self.table_phase_rad)]
        if len({v.size for v in table}) > 1 or table[0].size == 1:
            raise ValueError(
                "table_hz, table_gain and table_phase_rad must have the same length, two points or more"
            )
        if not all(np.all(np.isfinite(v)) for v in table) or np.any(table[1] <= 0):
            raise ValueError("the response table must be finite, its gains positive")
        if np.any(table[0] <= 0) or np.any(np.diff(table[0]) <= 0):
            raise ValueError("table_hz must be positive and rising")
        if not (self.table_gain_u >= 0 and self.table_phase_u_rad >= 0):
            raise ValueError("the uncertainties of the table must not be negative")

    def at(self, frequency: ArrayLike) -> Complexes:
        """Complex gain at any frequencies, Hz.

        Raises
        ------
        OutsideResponse
            A frequency outside the table.
        """
        f = np.asarray(frequency, dtype=np.float64)
        gain = np.ones(f.shape, dtype=np.complex128)
        for corner in self.low_pass_hz:
            gain = gain * low_pass(f, corner)
        for corner in self.high_pass_hz:
            gain = gain * high_pass(f, corner)
        return gain * self._table_at(f) if len(self.table_hz) else gain

    def reach(self, frequency: ArrayLike) -> Bools:
        """Whether a frequency lies inside the table; always, without one."""
        f = np.asarray(frequency, dtype=np.float64)
        if not len(self.table_hz):
            return np.ones(f.shape, dtype=bool)
        return np.asarray((f >= self.table_hz[0] * (1 - 1e-9)) & (f <= self.table_hz[-1] * (1 + 1e-9)))

    def _table_at(self, f: Floats) -> Complexes:
        from scipy.interpolate import PchipInterpolator  # costs as much to import as the whole of NumPy

        inside = self.reach(f)
        if not np.all(inside | np.isnan(f)):
            outside = f[~inside & ~np.isnan(f)]
            raise OutsideResponse(
                f"the response is known from {self.table_hz[0]:.6g} to {self.table_hz[-1]:.6g} Hz, but "
                f"{float(outside.flat[0]):.6g} Hz is needed: beat and second harmonic must lie inside"
            )
        known = np.log(np.asarray(self.table_hz, dtype=float))
        place = np.clip(np.log(f), known[0], known[-1])
        gain = PchipInterpolator(known, np.log(np.asarray(self.table_gain, dtype=float)))(place)
        phase = PchipInterpolator(known, np.unwrap(np.asarray(self.table_phase_rad, dtype=float)))(place)
        return np.asarray(np.exp(gain + 1j * phase))


def ratio_factor(response: ChannelResponse, frequency: ArrayLike, ratio: ArrayLike = 0.0) -> Complexes:
    """Measured over true rho of a beat that went through the channel."""
    # One pole at five times the beat takes 5.3 % off, AC coupling at a fifth of it adds 1.5 %.
    f, r = np.broadcast_arrays(np.asarray(frequency, dtype=np.float64), np.asarray(ratio, dtype=np.float64))
    first = response.at(f)
    start = _on_ratio(first, response.at(2 * f))
    if not np.any(r > 0.02):
        return start
    lines = _lines(response, f, r)
    q = _best_series(lines, lines[..., 1])
    head = np.sum(lines * np.conj(q[..., np.newaxis] ** np.arange(HARMONICS)), axis=-1)
    # The fit's own fundamental turns with the rest, and with it the origin that rho is counted from.
    fitted = q * np.exp(-1j * np.angle(head * first))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(r > 1e-6, fitted / np.where(r > 1e-6, np.minimum(r, 0.99), 1.0), start))


def _lines(response: ChannelResponse, f: Floats, ratio: Floats) -> Complexes:
    """The harmonics behind the channel (..., n), over the fundamental there."""
    orders = np.arange(1, HARMONICS + 1)
    harmonics = f[..., np.newaxis] * orders
    # Beyond a table nothing is known: those harmonics are taken to be shaped like the last known one.
    last = response.table_hz[-1] if len(response.table_hz) else np.inf
    gains = response.at(np.minimum(harmonics, np.maximum(last, f[..., np.newaxis])))
    lines = gains / gains[..., :1] * np.minimum(ratio, 0.99)[..., np.newaxis] ** (orders - 1)
    return np.asarray(lines)


def _best_series(lines: Complexes, q: Complexes) -> Complexes:
    """q of the geometric series h q^(n-1) nearest to the lines (..., n), by Gauss-Newton with h solved for."""
    place = np.arange(lines.shape[-1])
    for _ in range(ROUNDS):
        powers = q[..., np.newaxis] ** place
        h = np.sum(lines * np.conj(powers), axis=-1) / np.sum(np.abs(powers) ** 2, axis=-1)
        slope = place * h[..., np.newaxis] * q[..., np.newaxis] ** np.maximum(place - 1, 0)
        share = np.sum(slope * np.conj(powers), axis=-1) / np.sum(np.abs(powers) ** 2, axis=-1)
        slope = slope - share[..., np.newaxis] * powers
        left = lines - h[..., np.newaxis] * powers
        power = np.sum(np.abs(slope) ** 2, axis=-1)
        change = np.sum(left * np.conj(slope), axis=-1) / np.where(power > 0, power, 1.0)
        q = q + change
        q = np.where(np.abs(q) > 0.995, q * 0.995 / np.maximum(np.abs(q), 1e-300), q)
    return q


def correct_response(estimate: LockInEstimate, response: ChannelResponse) -> LockInEstimate:
    """The estimate that the records would have given without the channel's response.

    Parameters
    ----------
    estimate : LockInEstimate
        As measured, any shape.
    response : ChannelResponse
        Of everything between the light and the samples.

    Returns
    -------
    LockInEstimate
        Its uncertainty holds that of the response, which is common to all records at one frequency and does
        not average out; `noise_model` says that it is in there.

    Raises
    ------
    OutsideResponse
        A record's beat or second harmonic lies outside the response table.
    """
    f = np.where(estimate.usable, estimate.beat_frequency, np.nan)
    with np.errstate(invalid="ignore"):
        factor = ratio_factor(response, f)
        for _ in range(8):  # the measured ratio is known instead of the true one
            factor = ratio_factor(response, f, np.minimum(np.abs(estimate.complex_ratio) / np.abs(factor), 0.95))
        rho = estimate.complex_ratio / factor
        turn = np.stack(
            [
                np.stack([(1 / factor).real, -(1 / factor).imag], axis=-1),
                np.stack([(1 / factor).imag, (1 / factor).real], axis=-1),
            ],
            axis=-2,
        )
        covariance = turn @ estimate.complex_ratio_covariance @ turn.swapaxes(-1, -2)
        covariance = covariance + _response_covariance(response, f, rho)
        # the channel has bent the waveform too, and what no geometric series takes up of it is explained
        lines = _lines(response, f, np.abs(rho))
        powers = _best_series(lines, lines[..., 1])[..., np.newaxis] ** np.arange(HARMONICS)
        head = np.sum(lines * np.conj(powers), axis=-1) / np.sum(np.abs(powers) ** 2, axis=-1)
        explained = EXPLAINED * np.asarray(np.linalg.norm(lines - head[..., np.newaxis] * powers, axis=-1))
        misfit_u = np.sqrt(np.maximum(estimate.misfit_u**2 - explained**2, 0.0))
        corrected = with_ratio(estimate, rho, covariance, np.sign(estimate.input_rate), misfit_u)
    return replace(
        corrected,
        noise_model=estimate.noise_model + "; corrected for the channel's response, whose uncertainty is in it",
    )


def _by_corner(pole: ChannelResponse, moved: ChannelResponse, f: Floats) -> Complexes:
    """Relative change of the factor far above lock-in for a relative change of one corner."""
    return np.asarray((ratio_factor(moved, f) / ratio_factor(pole, f) - 1) / STEP)


def _response_covariance(response: ChannelResponse, f: Floats, rho: Complexes) -> Floats:
    """Covariance (..., 2, 2) that the uncertainty of the response gives to the corrected rho."""
    changes = []
    for pole, u in zip(response.low_pass_hz, response.low_pass_u_hz, strict=False):
        slope = _by_corner(
            ChannelResponse(low_pass_hz=[pole]), ChannelResponse(low_pass_hz=[pole * (1 + STEP)]), f
        )
        changes.append(slope * u / pole)
    for pole, u in zip(response.high_pass_hz, response.high_pass_u_hz, strict=False):
        slope = _by_corner(
            ChannelResponse(high_pass_hz=[pole]), ChannelResponse(high_pass_hz=[pole * (1 + STEP)]), f
        )
        changes.append(slope * u / pole)
    # ln|H(2f)| - ln|H(f)| and arg H(2f) - 2 arg H(f), each value of the table with its own error.
    changes.append(np.full(f.shape, np.sqrt(2) * response.table_gain_u + 0j))
    changes.append(np.full(f.shape, 1j * np.sqrt(5) * response.table_phase_u_rad))
    total = np.zeros((*f.shape, 2, 2))
    for change in changes:
        parts = np.stack([(rho * change).real, (rho * change).imag], axis=-1)
        total += parts[..., :, np.newaxis] * parts[..., np.newaxis, :]
    return total
