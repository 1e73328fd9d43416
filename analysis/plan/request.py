"""What somebody who plans a measurement knows and wants."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from analysis.budget import BenchKnowledge, Reference, TableGeometry
from analysis.rotation import earth_rate_on_axis

SAFE_ABOVE_LOCK_IN = 1.5
"""The rate stays so far above the largest lock-in rate to be expected: no table turns perfectly steadily."""

FASTEST_OVER_LOCK_IN = 100.0


@dataclass(frozen=True)
class OscilloscopeSteps:
    """What the knobs of an oscilloscope allow."""

    time_bases: Sequence[float]  # s/div, ascending
    vertical_scales: Sequence[float]  # v/div at the input, ascending
    # of a record: its samples, its horizontal divisions, the converter's levels per vertical division
    samples: int = 2500
    divisions: int = 10
    levels_per_division: int = 25

    def time_base(self, frequency: float, periods_min: float, samples_per_period_min: float) -> float:
        """The fastest step that holds so many periods of the beat, s/div.

        Where that would leave too few samples in a period it is the slowest step that leaves enough.
        """
        slowest = self.samples / (self.divisions * frequency * samples_per_period_min)
        sampled = [base for base in self.time_bases if base <= slowest * (1 + 1e-9)] or [self.time_bases[0]]
        enough = periods_min / (self.divisions * frequency)
        return next((base for base in sampled if base >= enough * (1 - 1e-9)), sampled[-1])

    def vertical_scale(self, amplitude: float, levels: float) -> float:
        """The most sensitive step, V/div, on which an amplitude in V stays within so many levels of the middle."""
        wanted = amplitude * self.levels_per_division / levels
        found = next((scale for scale in self.vertical_scales if scale >= wanted * (1 - 1e-9)), None)
        if found is None:
            highest = self.vertical_scales[-1] * levels / self.levels_per_division
            raise ValueError(
                f"an amplitude of {amplitude:g} V does not fit on the screen, which takes {highest:g} V at most: "
                "use a probe that divides"
            )
        return found


@dataclass(frozen=True)
class TableSpread:
    """How well the rate on the axis is known where it is the reference; see `TableGeometry`."""

    tilt_deg: float
    tilt_u_deg: float
    latitude_deg: float
    latitude_u_deg: float
    rate_u_ppm: float
    azimuth_deg: float = math.nan
    azimuth_u_deg: float = 0.0

    def at(self, input_rate: float) -> TableGeometry:
        """The geometry that gives a rate on the axis, deg/s."""
        azimuth = self.azimuth_deg if math.isfinite(self.azimuth_deg) else 90.0
        earth = float(earth_rate_on_axis(self.latitude_deg, self.tilt_deg, azimuth))
        table_rate = (input_rate - earth) / math.cos(math.radians(self.tilt_deg))
        return TableGeometry(
            table_rate=table_rate,
            table_rate_u=1e-6 * self.rate_u_ppm * abs(table_rate),
            tilt_deg=self.tilt_deg,
            tilt_u_deg=self.tilt_u_deg,
            latitude_deg=self.latitude_deg,
            latitude_u_deg=self.latitude_u_deg,
            azimuth_deg=self.azimuth_deg,
            azimuth_u_deg=self.azimuth_u_deg,
        )


@dataclass(frozen=True)
class PlanRequest:
    """What is wanted, and what is known beforehand."""

    lock_in_rate: float  # as expected, deg/s
    wanted_u: float  # relative standard uncertainty of the lock-in rate that is wanted
    scale_factor: float  # k, pulses per degree
    amplitude: float  # of the beat, and of the white noise in each sample, at the input, V
    noise_rms: float
    oscilloscope: OscilloscopeSteps
    knowledge: BenchKnowledge  # its `table` is made from `table` below
    lock_in_factor: float = 2.0  # it may be this factor larger or smaller
    noise_levels: float = 0.0  # noise of the oscilloscope itself, rms, levels
    reference: Reference = "beat"  # {"beat", "rate"}
    table: TableSpread | None = None
    rates_over_lock_in: tuple[float, ...] = ()  # w/WL to measure at; empty: the best one is looked for
    both_senses: bool = False  # every rate in both senses of rotation
    phase: float = math.nan  # readout phase less backscatter phase, rad; nan: unknown
    scatter: float = 0.0  # standard deviation of the lock-in rate itself from record to record, relative
    periods_min: float = 15.0  # how a record is to be taken
    samples_per_period_min: float = 20.0
    fill_levels: float = 100.0
    seconds_between_records: float = 0.0  # for the transfer

    def __post_init__(self) -> None:
        for name in ("lock_in_rate", "wanted_u", "scale_factor", "amplitude"):
            if not (getattr(self, name) > 0 and math.isfinite(getattr(self, name))):
                raise ValueError(f"{name} must be a positive number, not {getattr(self, name)!r}")
        if not 1 <= self.lock_in_factor <= FASTEST_OVER_LOCK_IN / 2:
            raise ValueError(f"the lock-in rate can be wrong by a factor of 1 to 50, not {self.lock_in_factor!r}")
        for ratio in self.rates_over_lock_in:
            if not 1.05 <= ratio <= 1000:
                raise ValueError(f"a rate must be 1.05 to 1000 times the lock-in rate, not {ratio:g} times")
        if self.reference == "rate" and self.table is None:
            raise ValueError("with the rate as reference, say how well table rate and tilt are known")

    @property
    def slowest_over_lock_in(self) -> float:
        """W/WL below which the gyro could be locked, WL being known only within its factor."""
        return SAFE_ABOVE_LOCK_IN * self.lock_in_factor

    @property
    def distortion_separated(self) -> bool:
        """Whether the rates can tell distortion from lock-in: two rates, or both senses."""
        return self.both_senses or len(set(self.rates_over_lock_in)) > 1
