"""A closed-loop fibre gyro: its coil, and the electronics: converters, loop, 2 pi reset, injection and noise.

    phi_s = (2 pi L D)/(lambda c) Omega           Sagnac phase, Omega in rad/s                           (13)
    tau   = n L / c                               time that the light takes through the coil
    K0    = 2^N L D/(lambda c) (pi/180)           codes per deg/s, when the 2^N codes span exactly 2 pi  (14)

L length of the fibre, D mean diameter of the coil, lambda wavelength in vacuum, n group index, N bits of the
converter. The index is in the transit time only, not in the Sagnac phase. Equations are numbered as in
docs/fibre_gyro.md.

    1 + eps = V_FS/(2 V_pi)       2 pi error: the 2^N codes of the converter span 2 pi (1 + eps)             (15)

V_FS is the range of the converter, V_pi the half-wave voltage of the phase modulator.
"""

from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Bools, Floats, Ints

LIGHT_SPEED = 299_792_458.0  # m/s, exact by definition


@dataclass(frozen=True)
class FibreCoil:
    """A coil of fibre and the light in it.

    Raises
    ------
    ValueError
        One of them is not positive.

    Examples
    --------
    >>> coil = FibreCoil(1000.0, 0.1, 1.55e-6, 1.468)
    >>> round(coil.transit_time * 1e6, 4), round(coil.sagnac_factor, 5), round(coil.nominal_scale(16), 6)
    (4.8967, 1.35216, 246.152866)
    """

    length_m: float = 1000.0
    diameter_m: float = 0.1
    wavelength_m: float = 1.55e-6
    group_index: float = 1.468  # about 1.46 to 1.47 for silica

    def __post_init__(self) -> None:
        for name in ("length_m", "diameter_m", "wavelength_m", "group_index"):
            value = getattr(self, name)
            if not (value > 0 and np.isfinite(value)):
                raise ValueError(f"{name} of a fibre coil must be a positive number, not {value!r}")

    @property
    def transit_time(self) -> float:
        """Time of the light through the coil, s."""
        return self.group_index * self.length_m / LIGHT_SPEED

    @property
    def proper_frequency(self) -> float:
        """Frequency of the bias modulation, 1/(2 tau), Hz."""
        return 1.0 / (2.0 * self.transit_time)

    @property
    def sagnac_factor(self) -> float:
        """Sagnac phase per rate, rad per rad/s, that is s."""
        return 2.0 * np.pi * self.length_m * self.diameter_m / (self.wavelength_m * LIGHT_SPEED)

    @property
    def turns_per_dps(self) -> float:
        """Sagnac phase in whole fringes per deg/s."""
        return self.sagnac_factor / 360.0

    @property
    def fringe_limit_dps(self) -> float:
        """Rate with a Sagnac phase of pi: above it a loop that starts from rest settles on another fringe, deg/s.

        >>> round(FibreCoil().fringe_limit_dps, 1)
        133.1
        """
        return 0.5 / self.turns_per_dps

    def nominal_scale(self, dac_bits: int) -> float:
        """K0 of equation (14), codes per deg/s."""
        return 2.0**dac_bits * self.turns_per_dps

    def scaled(self, factor: float) -> Self:
        """Coil whose L D/lambda is `factor` times this one's and whose transit time is the same.

        >>> round(FibreCoil().scaled(1.0001).nominal_scale(16) / FibreCoil().nominal_scale(16) - 1, 9)
        0.0001
        """
        return replace(self, wavelength_m=self.wavelength_m / factor)


InjectionPath = Literal["shared", "separate"]

GUARD_BITS = 16
"""Bits of the loop's accumulator below the smallest step, so that no error of a sample pair is ever lost."""


@dataclass(frozen=True)
class LoopDesign:
    """Design of the electronics; the errors are those of the real hardware, unknown to the digital part.

    Raises
    ------
    ValueError
        A setting is out of its range.
    """

    dac_bits: int = 16  # N of the phase converter
    fractional_bits: int = 14  # bits of the step below one code
    adc_bits: int = 14  # the detector's converter; its range is the full fringe of a contrast of 1
    # mean light level above a threshold of that converter, in its steps. At 0.5 it lies in the middle of a step,
    # and without noise small errors are not seen at all.
    adc_offset: float = 0.0
    # part of the phase error that one sample pair takes away; stable between 0 and 2, time constant about 2
    # tau/loop_gain
    loop_gain: float = 0.2
    two_pi_error: float = 0.0  # eps of equation (15)
    gated: bool = True  # sample pairs with a reset are left out of the loop; else all of them enter
    # the square-wave bias is added before the modulo, so that the converter needs no codes beyond 2 pi
    bias_in_wrap: bool = False
    inl_quadratic: float = 0.0  # bow of the converter, inl (x^2 - 1/4) of full scale, x = code/2^N - 1/2
    inl_cubic: float = 0.0  # S-shape of the converter, inl x (x^2 - 1/4) of full scale
    # {"shared", "separate"}: the injected staircase goes through the feedback's own adder and converter, or
    # through a second electrode with a converter of its own
    injection_path: InjectionPath = "shared"
    injection_two_pi_error: float = 0.0  # eps of that second path
    closed: bool = True  # the feedback follows the error; else its step stays as it is
    angle_random_walk_deg_per_sqrt_h: float = 0.005  # white noise of the detector
    bias_dph: float = 0.0  # constant false rate of the optics, deg/h
    contrast: float = 1.0  # of the fringe, 0 to 1
    light_level: float = 1.0  # peak intensity over the one that the loop gain was set for
    # second loop: part of the 2 pi error that one reset takes away, by trimming the converter's reference; 0: off
    two_pi_loop_gain: float = 0.0
    wrap_codes: int | None = None  # codes at which the staircase falls back; 2^N if not given

    def __post_init__(self) -> None:
        for name, lowest, highest in _RANGES:
            value = getattr(self, name)
            if not lowest <= value <= highest:
                raise ValueError(f"{name} must be from {lowest:g} to {highest:g}, not {value!r}")
        if self.injection_path not in ("shared", "separate"):
            raise ValueError(f"injection_path must be 'shared' or 'separate', not {self.injection_path!r}")
        if not 0.9 * self.codes <= self.wrap <= 1.1 * self.codes:
            raise ValueError(
                f"wrap_codes must be within 10 % of 2^dac_bits = {self.codes}, not {self.wrap_codes!r}"
            )

    @property
    def codes(self) -> int:
        """Number of codes of the converter, 2^N."""
        return 1 << self.dac_bits

    @property
    def wrap(self) -> int:
        """Codes at which the staircase falls back."""
        return self.codes if self.wrap_codes is None else self.wrap_codes

    @property
    def step_resolution(self) -> float:
        """Smallest step, codes."""
        return 2.0**-self.fractional_bits

    @property
    def largest_step(self) -> float:
        """Largest step, codes: just less than half of the staircase's range, a phase of pi."""
        return (self.wrap // 2) - self.step_resolution

    @property
    def adc_half_range(self) -> float:
        """Half of the range of the detector's converter, its counts: the level A of the mean intensity."""
        return 2.0 ** (self.adc_bits - 1)

    def injected_units(self, steps: ArrayLike) -> Ints:
        """Injected steps, given in codes, in whole units of 2^-fractional_bits codes."""
        codes = np.asarray(steps, dtype=np.float64)
        beyond = codes[~(np.abs(codes) <= self.largest_step)]
        if beyond.size:
            raise ValueError(
                f"an injected step of {beyond[0]:.7g} codes is beyond half of the range of a {self.dac_bits}-bit "
                f"converter: at most {self.largest_step:.7g} codes"
            )
        return np.rint(codes * 2.0**self.fractional_bits).astype(np.int64)

    def converter_phase(self) -> Floats:
        """Modulator phase of every code, turns, without the 2 pi error; the bias reaches to 5/4 of the range."""
        code = np.arange(self.codes + self.codes // 2)
        x = code / self.codes - 0.5
        bow = (self.inl_quadratic + self.inl_cubic * x) * (x * x - 0.25)
        return np.asarray(code / self.codes + bow, dtype=np.float64)

    def error_gain(self) -> int:
        """Change of the accumulator per ADC count of the demodulated error; the accumulator has guard bits."""
        per_count = self.loop_gain * self.codes / (2.0 * np.pi) / (2.0 * self.adc_half_range)
        return round(per_count * 2.0 ** (self.fractional_bits + GUARD_BITS))

    def detector_noise(self, coil: FibreCoil) -> float:
        """Standard deviation of one detector sample in ADC counts, from the angle random walk."""
        # White phase noise sigma_phi per sample pair is a rate noise of sigma_phi/(sagnac factor), and pairs come
        # every 2 tau; the difference of two samples of noise sigma is 2 A sigma_phi.
        walk = np.deg2rad(self.angle_random_walk_deg_per_sqrt_h) / 60.0
        per_pair = coil.sagnac_factor * walk / np.sqrt(2.0 * coil.transit_time)
        return float(np.sqrt(2.0) * self.adc_half_range * self.light_level * self.contrast * per_pair)


# the bits are such that 64 hold the sums over an hour
_RANGES = (
    ("dac_bits", 8, 18),
    ("fractional_bits", 0, 18),
    ("adc_bits", 8, 24),
    ("adc_offset", -0.5, 0.5),
    ("loop_gain", 0.0, 2.0),
    ("two_pi_error", -0.1, 0.1),
    ("injection_two_pi_error", -0.1, 0.1),
    ("inl_quadratic", -0.1, 0.1),
    ("inl_cubic", -0.1, 0.1),
    ("angle_random_walk_deg_per_sqrt_h", 0.0, 100.0),
    ("contrast", 0.01, 1.0),
    ("light_level", 0.01, 1.0),
    ("two_pi_loop_gain", 0.0, 1.0),
)


# --------------------
# Output periods in whole sample pairs: each holds the pairs that end in it, so times are exact on average


class OutputClock:
    """Time and sample pairs since the start of a gyro."""

    def __init__(self, coil: FibreCoil) -> None:
        self.pair_time = 2.0 * coil.transit_time
        self.time, self.pairs = 0.0, 0

    def next_outputs(self, n_outputs: int, period: float) -> tuple[Floats, Ints]:
        """End of each of the next output periods, s, and its number of pairs; the clock goes on."""
        if n_outputs < 1:
            raise ValueError(f"the number of outputs must be at least 1, not {n_outputs}")
        if not self.pair_time <= period < np.inf:
            raise ValueError(
                f"the output period must be at least one sample pair, {self.pair_time:.4g} s, not {period!r}"
            )
        ends: Floats = self.time + period * np.arange(1, n_outputs + 1, dtype=np.float64)
        last = np.rint(ends / self.pair_time).astype(np.int64)
        in_output: Ints = last - np.concatenate(([self.pairs], last[:-1]))
        self.time, self.pairs = float(ends[-1]), int(last[-1])
        return ends, in_output


# --------------------
# What a fibre gyro gives: output words, and a trace of its staircase and detector signal


@dataclass(frozen=True)
class OutputBlock:
    """Consecutive output words; shape (n,), or (runs, n) of several gyros side by side."""

    times_s: Floats  # (n,): end of each output period since the start of the gyro
    interval_s: float
    counts: Floats  # mean feedback step over the period with its sign reversed, codes each transit time
    # mean demodulated error, counts of the detector's converter, of the sample pairs without and with a 2 pi
    # reset; nan where there was none
    normal_error: Floats
    reset_error: Floats
    reset_pairs: Ints  # number of sample pairs with a reset


@dataclass(frozen=True)
class LoopTrace:
    """The signals of one gyro at every transit time; shape (n,) each."""

    times_s: Floats  # since the start of the gyro
    staircase: Ints  # the staircase in whole codes, without the bias
    code: Ints  # what the converter gets: staircase and bias
    # phase of the modulator, with the errors of converter and 2 pi voltage, without a second electrode
    modulator_rad: Floats
    # phase difference of the two beams: Sagnac phase and modulator now less modulator one transit time ago
    difference_rad: Floats
    intensity: Floats  # at the detector without noise; 1 is the peak of the fringe
    adc: Ints  # as converted, with noise
    reset: Bools  # the staircase or the code wrapped since the sample before
