"""What a photodiode and its amplifier make of beat or single beam: phase, distortion, bandwidth, coupling.

At a constant rate the detector's signal is a periodic function of the beat phase. Behind a filter its harmonic n
is multiplied by the response at n f. The rate changes little in one period, so the harmonics are worked out on a
grid of rates once and interpolated; without a filter the signal is computed sample by sample.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from analysis.arrays import Bools, Complexes, Floats, Indices
from analysis.channel import high_pass, low_pass
from analysis.ring_laser.gyro import Gyro, RateMotion, beat_phase_on_table, split
from analysis.two_mode_laser import FINER, beat_rate_at, grid_place, interpolate, rate_at, six_weights, weights_at

_FEWEST_POINTS, _MOST_POINTS = 128, 8192
_NEGLIGIBLE = 1e-9
_FEW_CELLS = 6
_OVERSHOOT = 0.05  # of the swing: more than a polynomial between points of the grid leaves them by


@dataclass(frozen=True)
class Detector:
    """A photodiode that looks at the fringes, with its amplifier."""

    readout_phase: float  # delta, where it reads the fringes, rad
    amplitude: float = 1.0  # of its signal, V
    offset: float = 0.0
    # distortion: s + second_order s^2 + third_order s^3 of the signal s in units of the amplitude. The harmonics
    # of a pure beat are then second_order / 2 and third_order / 4 of it.
    second_order: float = 0.0
    third_order: float = 0.0
    low_pass_hz: float = 0.0  # corners of one pole each; 0: there is none
    ac_corner_hz: float = 0.0
    pump_ripple: float = 0.0  # the light swings by this share
    pump_hz: float = 0.0
    # light of the single beams over that of the fringes: how much of their winking is seen
    single_beams: float = 0.0
    coupling_hz: float = 0.0  # corner of the AC coupling of what looks at the signal, as `ac_corner_hz`
    beam: int = 0  # 1 or 2: it looks at that beam alone, and offset and amplitude are its light; 0: at the fringes
    crosstalk_v: float = 0.0  # of the beat into the channel of a beam, V

    @property
    def filtered(self) -> bool:
        """Whether anything in it depends on the frequency."""
        return self.low_pass_hz > 0 or self.ac_corner_hz > 0 or self.coupling_hz > 0

    def volts(self, fringe: Complexes, backscatter_phase: float, light: Floats | float = 1.0) -> Floats:
        """Signal before any filter, V, for exp(i (phi + beta)), and the light of the beam that it may look at."""
        turned = fringe * np.exp(1j * (self.readout_phase - backscatter_phase))
        s = turned.imag
        if self.beam:
            return np.asarray(self.offset + self.amplitude * (light - 1) + self.crosstalk_v * s, dtype=np.float64)
        distorted = s + self.second_order * s**2 + self.third_order * s**3
        return np.asarray(self.offset + self.amplitude * distorted, dtype=np.float64)

    def response(self, frequency: Floats) -> Complexes:
        """Gain of the filters at frequencies in Hz."""
        gain = np.ones_like(frequency, dtype=np.complex128)
        if self.low_pass_hz > 0:
            gain *= low_pass(frequency, self.low_pass_hz)
        for corner in (self.ac_corner_hz, self.coupling_hz):
            if corner > 0:
                gain *= high_pass(frequency, corner)
        return gain

    def swing(self, times: Floats) -> Floats:
        """The light at absolute times in s over its mean."""
        return np.asarray(1 + self.pump_ripple * np.sin(self._pump_phase(times)))

    def mean_swing(self, starts: Floats, times: Floats) -> Floats:
        """Mean over several starts (absolute, s) of `swing` at times in s behind each."""
        together = np.exp(1j * self._pump_phase(starts)).mean()
        return np.asarray(1 + self.pump_ripple * (np.exp(1j * self._pump_phase(times)) * together).imag)

    def _pump_phase(self, times: Floats) -> Floats:
        """Phase of the light's swing in rad, less whole turns."""
        cycles = self.pump_hz * times
        return np.asarray(2 * np.pi * (cycles - np.floor(cycles)))


def detector_signal(gyro: Gyro, detector: Detector, axis_rate: Floats, beat_phase: Floats) -> Floats:
    """Volts at the detector for given rate on the axis and slow beat phase."""
    # Shapes: axis_rate (n,), beat_phase (n,).
    if not detector.filtered and gyro.winking is None:
        return detector.volts(gyro.fringe(axis_rate, beat_phase), gyro.backscatter_phase)
    locked, senses = gyro.locked(axis_rate), np.sign(axis_rate)
    if senses.size and not locked.any() and (senses == senses[0]).all():
        return _by_harmonics(gyro, detector, axis_rate, beat_phase, int(senses[0]))
    volts = np.empty(axis_rate.shape)
    # behind a filter a locked gyro's signal is what the filter leaves of a constant
    if locked.any():
        still = detector.volts(gyro.fringe(axis_rate[locked], beat_phase[locked]), gyro.backscatter_phase)
        volts[locked] = still * float(detector.response(np.zeros(1))[0].real)
    for sense in (1, -1):
        inside = np.flatnonzero(~locked & (senses == sense))
        if inside.size:
            volts[inside] = _by_harmonics(gyro, detector, axis_rate[inside], beat_phase[inside], sense)
    return volts


def volts_between(
    gyro: Gyro, detector: Detector, slowest: float, fastest: float, sense: int
) -> tuple[float, float]:
    """Volts that the detector does not leave at any phase of the beat."""
    low, high = np.inf, -np.inf
    first, last = grid_place(np.array([slowest, fastest]), gyro.lock_in_rate)
    for point in range(math.floor(first) - 2, math.ceil(last) + 4):  # those that are interpolated between
        harmonics = _harmonics(gyro, detector, point, sense)
        middle, swing = float(harmonics[0].real), float(np.abs(harmonics[1:]).sum())
        low, high = min(low, middle - swing), max(high, middle + swing)
    slack = _OVERSHOOT * (high - low)
    return low - slack, high + slack


def _by_harmonics(gyro: Gyro, detector: Detector, rates: Floats, phases: Floats, sense: int) -> Floats:
    """Sum of the harmonics, each interpolated between points of the grid of rates."""
    turning = np.exp(1j * sense * phases)
    place = grid_place(np.abs(rates), gyro.lock_in_rate) * FINER
    cells = np.floor(place).astype(np.intp)
    lowest, highest = int(cells.min()), int(cells.max())
    if highest - lowest > _FEW_CELLS:

        def at_point(point: int, inside: Indices) -> Floats:
            return _real_series(_harmonics(gyro, detector, point, sense), turning[inside])

        return interpolate(rates, gyro.lock_in_rate, at_point)
    # in a record the rate hardly changes: straight lines between the points of a finer grid are good enough
    volts = np.empty(rates.shape)
    for cell in range(lowest, highest + 1):
        inside: Bools | slice = cells == cell if lowest < highest else slice(None)
        left, right = _real_series(_either_side(gyro, detector, cell, sense), turning[inside])
        volts[inside] = left + (place[inside] - cell) * (right - left)
    return volts


def amplitudes_at(gyro: Gyro, detector: Detector, axis_rate: float) -> Complexes:
    """Complex amplitudes of the harmonics 0, 1, ... behind the filters, V, at a rate beyond lock-in in deg/s."""
    # That of the nearest point of the finer grid, a four thousandth of the rate away at most.
    place = float(grid_place(np.array([abs(axis_rate)]), gyro.lock_in_rate)[0])
    return _between(gyro, detector, round(place * FINER), 1 if axis_rate > 0 else -1)


@lru_cache(maxsize=512)
def _either_side(gyro: Gyro, detector: Detector, finer: int, sense: int) -> Complexes:
    """Harmonics (order, 2, 1) at a point of the finer grid and at the next."""
    low, high = (_between(gyro, detector, point, sense) for point in (finer, finer + 1))
    both = np.zeros((max(low.size, high.size), 2, 1), dtype=np.complex128)
    both[: low.size, 0, 0], both[: high.size, 1, 0] = low, high
    return both


@lru_cache(maxsize=512)
def _between(gyro: Gyro, detector: Detector, finer: int, sense: int) -> Complexes:
    """Harmonics at a point of the finer grid."""
    found = [(_harmonics(gyro, detector, point, sense), weight) for point, weight in weights_at(finer / FINER)]
    total = np.zeros(max(series.size for series, _ in found), dtype=np.complex128)
    for series, weight in found:
        total[: series.size] += weight * series
    return total


def _real_series(amplitudes: Complexes, turning: Complexes) -> Floats:
    """Real part of sum amplitudes_n turning^n, for amplitudes (order, ...) that may hold several series."""
    total = amplitudes[-1] + np.zeros_like(turning)
    for amplitude in amplitudes[-2::-1]:
        total *= turning
        total += amplitude
    return np.ascontiguousarray(total.real)


@lru_cache(maxsize=512)
def _harmonics(gyro: Gyro, detector: Detector, point: int, sense: int) -> Complexes:
    """Complex amplitudes of the harmonics 0, 1, ... behind the filters, V, at one point of the grid."""
    volts = _one_period(gyro, detector, point, sense)
    amplitudes: Complexes = np.fft.rfft(volts) / volts.size
    amplitudes[1:] *= 2
    frequency = gyro.scale_factor * beat_rate_at(point)
    if gyro.winking is not None:
        frequency = gyro.winking.frequency(point, sense)
    amplitudes = amplitudes * detector.response(frequency * np.arange(amplitudes.size, dtype=np.float64))
    kept = np.flatnonzero(np.abs(amplitudes) > _NEGLIGIBLE * np.abs(amplitudes).max())
    return np.asarray(amplitudes[: kept[-1] + 1] if kept.size else amplitudes[:1])


def _one_period(gyro: Gyro, detector: Detector, point: int, sense: int) -> Floats:
    """Volts before any filter, evenly over one period of the beat."""
    if gyro.winking is not None:
        fringe, light = gyro.winking.fringe(point, sense), gyro.winking.light(point, sense)
        if detector.beam:
            return detector.volts(fringe, gyro.backscatter_phase, light[detector.beam - 1])
        unequal = gyro.winking.beam_imbalance
        mean = np.average(light, axis=0, weights=[1 + unequal, 1 - unequal])
        pedestal = detector.amplitude * detector.single_beams * (mean - mean.mean())
        return np.asarray(detector.volts(fringe, gyro.backscatter_phase) + pedestal)
    rate = sense * rate_at(point, gyro.lock_in_rate)
    ratio = float(gyro.harmonic_ratio(np.array(rate)))
    # the harmonics that the grid cannot hold would fold back: they shall be negligible
    wanted = 4 * math.log(_NEGLIGIBLE) / math.log(min(max(ratio, 1e-9), 1 - 1e-9))
    points = 1 << math.ceil(math.log2(min(max(wanted, _FEWEST_POINTS), _MOST_POINTS)))
    phases = sense * np.arange(points, dtype=np.float64) * (2 * np.pi / points)
    return detector.volts(gyro.fringe(np.full(points, rate), phases), gyro.backscatter_phase)


# --------------------
# Signals at the inputs of the oscilloscope, as functions of absolute time


UNSEEN = 5e-4  # of the amplitude: a twentieth of a level on a full screen

_SAME_NOISE_S = 20e-6
_POINTS_A_PERIOD = 6  # of the light, where nothing beats
_LEFT = 1e-4  # of the amplitude, by the polynomials between the points
_NODE_POLYNOMIAL = 16.9 / 720  # of six points at even steps, largest between the outer two, over 6!
_SHARPEST = 0.9  # ratio of successive harmonics


def beat_signal_on_table(gyro: Gyro, detector: Detector, motion: Sequence[RateMotion], times: Floats) -> Floats:
    """Volts at the detector while the table moves."""
    # Shapes: times (n,).
    segments, volts = tuple(motion), np.empty_like(times)
    for number, inside in split(segments, times):
        resting = _resting_volts(gyro, detector, segments[number])
        if resting is not None:
            volts[inside] = resting
            continue
        rates, phases = beat_phase_on_table(gyro, segments, times[inside])
        seen_by = (gyro, detector)
        if segments[number].acceleration_dps2 != 0.0:
            # nobody measures in a slew, and its rates are too many to work out all of their beats
            all_pass = replace(detector, low_pass_hz=0.0, ac_corner_hz=0.0, coupling_hz=0.0)
            seen_by = (gyro.without_winking(), all_pass)
        volts[inside] = detector_signal(*seen_by, rates, phases)
    return np.asarray(volts * detector.swing(times)) if detector.pump_ripple else volts


@lru_cache(maxsize=16)
def _resting_volts(gyro: Gyro, detector: Detector, segment: RateMotion) -> float | None:
    """The constant of a locked gyro on a table at rest; ``None`` where the beat moves."""
    if segment.rate_dps or segment.acceleration_dps2 or gyro.ripple_dps:
        return None
    rate = np.atleast_1d(gyro.axis_rate(0.0, segment.azimuth_deg))
    if not gyro.locked(rate).all():
        return None
    return float(detector_signal(gyro, detector, rate, np.zeros(1))[0])


def smooth_interval(
    gyro: Gyro, detector: Detector, motion: Sequence[RateMotion], start: float, stop: float
) -> float:
    """Distance in s of points between which polynomials of the fifth degree give the signal of the detector."""
    # They leave 1e-4 of its amplitude. 0 where the gyro locks or unlocks: there are no such points then.
    segments = tuple(motion)
    pieces = split(segments, np.array([start, stop]))
    reached = segments[pieces[0][0] : pieces[-1][0] + 1]
    return min(_smooth_interval(gyro, detector, segment) for segment in reached)


@lru_cache(maxsize=16)
def _smooth_interval(gyro: Gyro, detector: Detector, segment: RateMotion) -> float:
    """Of one piece of motion: polynomials are off by that of their nodes times the sixth derivative over 6!."""
    if _resting_volts(gyro, detector, segment) is not None:
        return 1.0 / (_POINTS_A_PERIOD * max(detector.pump_hz, 1.0))
    if segment.acceleration_dps2:
        return 0.0
    low, high, sense = _rates_in(gyro, segment)
    if low <= gyro.lock_in_rate or gyro.harmonic_ratio(np.array(low)) >= _SHARPEST or not sense:
        return 0.0
    # harmonics are largest at the slowest rate, or, behind a high-pass, at the fastest
    slow, fast = (np.abs(amplitudes_at(gyro, detector, sense * rate)[1:]) for rate in (low, high))
    amplitudes = np.zeros(max(slow.size, fast.size))
    amplitudes[: slow.size] = slow
    amplitudes[: fast.size] = np.maximum(amplitudes[: fast.size], fast)
    if not amplitudes.any():  # there is light, and no beat
        return 1.0 / (_POINTS_A_PERIOD * max(detector.pump_hz, 1.0))
    beats = gyro.scale_factor * high * np.arange(1, amplitudes.size + 1) + abs(gyro.ripple_hz)
    swings = amplitudes @ (beats + detector.pump_hz) ** 6 + abs(detector.offset) * detector.pump_hz**6
    sixth_derivative = float(amplitudes @ beats**6 + detector.pump_ripple * swings) * (2 * math.pi) ** 6
    return float((_LEFT * amplitudes.max() / (_NODE_POLYNOMIAL * sixth_derivative)) ** (1 / 6))


def signal_bounds(
    gyro: Gyro, detector: Detector, motion: Sequence[RateMotion], start: float, stop: float
) -> tuple[float, float]:
    """Volts that the signal of the detector does not leave between two absolute times in s; inf: not known."""
    segments = tuple(motion)
    pieces = split(segments, np.array([start, stop]))
    bounds = [_bounds(gyro, detector, piece) for piece in segments[pieces[0][0] : pieces[-1][0] + 1]]
    return min(low for low, _ in bounds), max(high for _, high in bounds)


@lru_cache(maxsize=16)
def _bounds(gyro: Gyro, detector: Detector, segment: RateMotion) -> tuple[float, float]:
    """Of one piece of motion."""
    low, high = -math.inf, math.inf
    if (resting := _resting_volts(gyro, detector, segment)) is not None:
        low = high = resting
    elif not segment.acceleration_dps2:
        slowest, fastest, sense = _rates_in(gyro, segment)
        if sense and slowest > gyro.lock_in_rate:
            low, high = volts_between(gyro, detector, slowest, fastest, sense)
    swing = detector.pump_ripple * max(abs(low), abs(high)) if detector.pump_ripple else 0.0
    return low - swing, high + swing


def signal_above(
    gyro: Gyro, detector: Detector, motion: Sequence[RateMotion], corner_hz: float, start: float, stop: float
) -> Callable[[Floats], Floats] | None:
    """The signal behind an AC coupling of one pole, between two absolute times in s."""
    # Light and rate that swing a little do not show in what the coupling does: their share of it is left out.
    segments = tuple(motion)
    pieces = split(segments, np.array([start, stop]))
    if len(pieces) > 1 or not _coupling_shows_no_swing(gyro, detector, segments[pieces[0][0]], corner_hz):
        return None
    coupled = replace(detector, coupling_hz=corner_hz, pump_ripple=0.0)

    def volts(times: Floats) -> Floats:
        beat = beat_signal_on_table(gyro, coupled, segments, times)
        if not detector.pump_ripple:
            return beat
        swing = detector.swing(times)
        return np.asarray(
            beat * swing + detector.offset * (swing - 1)
        )  # what swings faster than the corner passes

    return volts


@lru_cache(maxsize=16)
def _coupling_shows_no_swing(gyro: Gyro, detector: Detector, segment: RateMotion, corner_hz: float) -> bool:
    """Whether a beat goes on steadily enough to know it behind an AC coupling."""
    if not _smooth_interval(gyro, detector, segment):
        return False
    if _resting_volts(gyro, detector, segment) is not None:
        return not detector.pump_ripple
    slowest = float(gyro.beat_frequency(np.array([_rates_in(gyro, segment)[0]]))[0])
    sideways = (
        gyro.scale_factor * gyro.ripple_dps * corner_hz / slowest**2
    )  # of the side bands that the ripple makes
    faint = detector.pump_ripple < 2 * UNSEEN and detector.pump_hz > 2 * corner_hz
    return sideways < UNSEEN and (faint or not detector.pump_ripple)


def _rates_in(gyro: Gyro, segment: RateMotion) -> tuple[float, float, int]:
    """Slowest and fastest rate on the axis in a turn of the table, deg/s, and their sense; 0: both."""
    rates = gyro.axis_rate(segment.rate_dps, np.arange(0.0, 360.0, 10.0))
    sizes, ripple = np.abs(rates), abs(gyro.ripple_dps)
    senses = np.sign(rates)
    sense = int(senses[0]) if (senses == senses[0]).all() else 0
    return float(np.min(sizes)) - ripple, float(np.max(sizes)) + ripple, sense


@dataclass(frozen=True)
class NoisySignal:
    """A signal at an input with white noise: its two parts can be looked at one by one."""

    smooth: Callable[[Floats], Floats]  # absolute times in s -> V, without noise
    noise_rms: float  # V in each sample
    seed: int  # not negative
    stream: int = 0  # another number, another noise: one for each channel
    # two absolute times in s -> the distance in s of points between which polynomials of the fifth degree give the
    # smooth part; 0 where that is not known
    interval: Callable[[float, float], float] = lambda start, stop: 0.0
    # two absolute times in s -> V that the smooth part does not leave between them
    bounds: Callable[[float, float], tuple[float, float]] = lambda start, stop: (-math.inf, math.inf)
    # A corner in Hz and two absolute times in s -> the smooth part behind a high-pass of one pole, between these
    # times; ``None`` where that is not known
    above: Callable[[float, float, float], Callable[[Floats], Floats] | None] = lambda corner, start, stop: None
    # starts (absolute, s) and times behind each, a corner in Hz (0: none) and its settling time in s -> the mean
    # of the smooth part, behind that high-pass, over all starts; ``None`` where that is not known
    mean: Callable[[Floats, Floats, float, float], Floats | None] = lambda starts, times, corner, settling: None

    def __call__(self, times: Floats) -> Floats:
        """Volts at absolute times in s."""
        return self.smooth(times) + self.noise(times)

    def noise(self, times: Floats) -> Floats:
        """The noise alone, V: another acquisition, another noise, the same for the same sample times."""
        if self.noise_rms == 0 or times.size == 0:
            return np.zeros(times.shape)
        # an input stage that looks at delays of nanoseconds sees one noise
        stamp = math.floor(float(times.flat[0]) / _SAME_NOISE_S) & (2**63 - 1)
        numbers = (self.seed, stamp, times.size, self.stream) if self.stream else (self.seed, stamp, times.size)
        generator = np.random.Generator(np.random.PCG64(_words(*numbers)))
        return self.noise_rms * generator.standard_normal(times.shape)


def _words(*numbers: int) -> NDArray[np.uint32]:
    """The seed that NumPy makes of these numbers, none of them negative: their 32-bit words, the lowest first."""
    words = []
    for number in numbers:
        words.append(number & 0xFFFFFFFF)
        while number := number >> 32:
            words.append(number & 0xFFFFFFFF)
    return np.array(words, dtype=np.uint32)


# --------------------
# The mean of many stretches of a beat, as an oscilloscope averages: without working out each of them.
#
# In stretch k the phase runs as psi_k(t) = psi_0(t) + d_k(t), where d_k changes little in a stretch: it is worked
# out at few times. With the harmonics c_n of the beat the mean of all stretches is
#
#     Re sum c_n exp(i n psi_0(t)) Z_n(t),    Z_n(t) = mean over k of exp(i n d_k(t))


_FEW = 8  # times at which d_k is worked out; as many again for each turn of the ripple
_FEWEST_NODES, _NODES_A_TURN = 8, 24  # of Z_n; 8 for each turn of the third harmonic
_MOST_PHASES = 60_000
_NEGLIGIBLE_MOTION = 1e-5  # of the largest harmonic


def mean_beat_on_table(
    gyro: Gyro,
    detector: Detector,
    motion: Sequence[RateMotion],
    starts: Floats,
    times: Floats,
    *,
    corner_hz: float = 0.0,
    settling_s: float = 0.0,
) -> Floats | None:
    """Mean over several starts of the volts at the detector at some times behind each."""
    # Shapes: starts (k,), times (n,).
    segments, span = tuple(motion), float(times[-1])
    first, last = float(starts[0]), float(starts[-1]) + span
    steady = [piece for piece in segments if piece.start <= last]
    turns = len(steady) == 1 or steady[-1].start <= first - settling_s
    if not turns or detector.pump_ripple >= 2 * UNSEEN or not smooth_interval(gyro, detector, motion, first, last):
        return None
    if corner_hz and signal_above(gyro, detector, motion, corner_hz, first - settling_s, last) is None:
        return None
    middle = starts[len(starts) // 2]
    few = chebyshev.chebpts1(_FEW + math.ceil(_FEW * gyro.ripple_hz * span) if gyro.ripple_dps else _FEW)
    behind = (few + 1) * span / 2
    rates, phases = beat_phase_on_table(gyro, segments, (starts[:, np.newaxis] + behind).ravel())
    # phases over those of the stretch in the middle
    slow = phases.reshape(len(starts), -1) - beat_phase_on_table(gyro, segments, middle + behind)[1]
    rates = rates.reshape(len(starts), -1)
    nodes = _FEWEST_NODES + math.ceil(_NODES_A_TURN * float(np.ptp(slow, axis=1).max()) / (2 * math.pi))
    if nodes * len(starts) > _MOST_PHASES:
        return None
    series = np.linalg.solve(chebyshev.chebvander(few, len(few) - 1), slow.T)
    differences = (chebyshev.chebvander(np.linspace(-1, 1, nodes), len(few) - 1) @ series).T
    coupled = replace(detector, coupling_hz=corner_hz, pump_ripple=0.0)
    begin, end = (amplitudes_at(gyro, coupled, float(rates[:, at].mean())) for at in (0, -1))
    order = int(np.count_nonzero(np.abs(begin) > _NEGLIGIBLE_MOTION * np.abs(begin).max()))
    order, sense = max(min(order + 1, begin.size, end.size), 2), 1 if rates[0, 0] > 0 else -1
    apart = np.exp(1j * sense * differences)
    power, together = np.ones_like(apart), np.empty((order - 1, nodes), dtype=np.complex128)
    for n in range(order - 1):
        power *= apart
        together[n] = power.mean(axis=0)
    places = times / span
    at = places * (together.shape[1] - 1)
    cells = np.minimum(np.maximum(at.astype(np.intp), 2), together.shape[1] - 4)
    weights = six_weights(at - cells).T
    shares = np.asarray(sum(w * together[:, cells + n] for n, w in zip(range(-2, 4), weights, strict=True)))
    turning = np.exp(1j * sense * beat_phase_on_table(gyro, segments, middle + times)[1])
    growing = begin[1:order, np.newaxis] + (end - begin)[1:order, np.newaxis] * (times / span)
    factors, total = growing * shares, np.zeros_like(turning)
    for factor in factors[::-1]:  # the sum of factors[n - 1] turning^n (Horner)
        total += factor
        total *= turning
    volts: Floats = begin[0].real + total.real
    if not detector.pump_ripple:
        return volts
    swing = detector.mean_swing(starts, times)
    return np.asarray(volts * swing + (detector.offset * (swing - 1) if corner_hz else 0.0))
