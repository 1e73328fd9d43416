"""The sections of a settings file: every name, its unit and what it may hold.

Sections that came later have defaults here as well: a run that was saved without them can still be read.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Dbc = Annotated[float, Field(ge=-200, le=0)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class GyroSettings(_Section):
    """The gyro under test, as far as it is known beforehand."""

    name: str
    scale_factor_pulses_per_deg: Positive
    expected_lock_in_rate_dps: Positive


class SiteSettings(_Section):
    """Where the bench stands."""

    latitude_deg: Annotated[float, Field(ge=-90, le=90)]


class TableSettings(_Section):
    """The rate table and what it is asked to do."""

    kind: Literal["simulated", "manual", "none"]
    fast_rate_dps: Positive
    both_senses: bool
    slow_rate_over_lock_in: Annotated[float, Field(gt=1.05, le=1000)]
    settle_s: NotNegative
    north_azimuth_deg: Finite


class ScopeSettings(_Section):
    """The oscilloscope and its input."""

    resource: str
    channel: Annotated[str, Field(pattern=r"^CH[1-4]$")]
    quadrature_channel: Annotated[str, Field(pattern=r"^(CH[1-4])?$")] = ""
    coupling: Literal["DC", "AC"]
    probe: Literal[1, 10, 100, 1000]
    bandwidth_limit: bool
    baud_rate: Literal[0, 300, 600, 1200, 2400, 4800, 9600, 19200]


class FrontEndSettings(_Section):
    """What is known of the channel between photodiode and converter; 0 and empty: nothing to correct."""

    low_pass_hz: NotNegative = 0.0
    ac_corner_hz: NotNegative = 0.0
    response_file: str = ""
    response: tuple[tuple[Positive, Positive, Finite], ...] = ()


class MeasurementSettings(_Section):
    """How many records of which shape, at which rates."""

    records: Annotated[int, Field(ge=1, le=1_000_000)]
    rates_over_lock_in: tuple[Annotated[float, Field(gt=1.05, le=1000)], ...] = ()
    both_senses: bool = False
    tilt_records: Annotated[int, Field(ge=1, le=1000)]
    periods_min: Annotated[float, Field(ge=3, le=500)]
    samples_per_period_min: Annotated[float, Field(ge=5, le=500)]
    fill_levels: Annotated[float, Field(ge=10, le=120)]


class ContaminantSettings(_Section):
    """What spoils the measurement on a simulated bench; everything is absent unless it is named."""

    second_harmonic_dbc: Dbc | None = None
    third_harmonic_dbc: Dbc | None = None
    bandwidth_hz: NotNegative = 0.0
    ac_corner_hz: NotNegative = 0.0
    gain_corner_hz: NotNegative = 0.0
    cross_saturation: Annotated[float, Field(ge=0, lt=1)] = 0.5
    backscatter_phase_sum_deg: Annotated[float, Field(gt=-170, lt=170)] = 0.0
    single_beams: Annotated[float, Field(ge=0, le=10)] = 0.0
    rate_ripple_dps: NotNegative = 0.0
    rate_ripple_hz: NotNegative = 1.0
    pump_ripple: Annotated[float, Field(ge=0, lt=1)] = 0.0
    pump_ripple_hz: NotNegative = 100.0
    scale_factor_error_ppm: Annotated[float, Field(gt=-1e6, lt=1e6)] = 0.0
    scale_factor_drift_ppm_per_hour: Annotated[float, Field(gt=-1e6, lt=1e6)] = 0.0
    quadrature_gain_error: Annotated[float, Field(gt=-1, lt=1)] = 0.0
    quadrature_phase_error_deg: Annotated[float, Field(gt=-80, lt=80)] = 0.0


class SimulationSettings(_Section):
    """The truth of a simulated bench."""

    seed: Annotated[int, Field(ge=0)]
    link: Literal["auto", "pty", "tcp"]
    scope_model: str
    lock_in_rate_dps: NotNegative
    tilt_deg: Annotated[float, Field(ge=0, lt=90)]
    backscatter_phase_deg: Finite
    readout_phase_deg: Finite
    amplitude_v: NotNegative
    offset_v: Finite
    detector_noise_v: NotNegative
    scope_noise_levels: NotNegative
    table_acceleration_dps2: Positive
    contaminants: ContaminantSettings = ContaminantSettings()


class BudgetSettings(_Section):
    """What is known of the bench, for the uncertainty budget; 0 where a comment of the file says "not known"."""

    scale_factor_u_ppm: NotNegative
    time_base_limit_ppm: NotNegative
    distortion_limit_dbc: Annotated[float, Field(le=0, ge=-200)]
    bandwidth_hz: NotNegative
    front_end_u_percent: NotNegative = 5.0
    gain_corner_hz: NotNegative
    table_rate_u_ppm: NotNegative
    latitude_u_deg: NotNegative


class OutputSettings(_Section):
    """Where results go."""

    directory: Annotated[str, Field(min_length=1)]


class Settings(_Section):
    """All settings of a run. ``simulation`` is absent on a real bench."""

    gyro: GyroSettings
    site: SiteSettings
    table: TableSettings
    scope: ScopeSettings
    front_end: FrontEndSettings = FrontEndSettings()
    measurement: MeasurementSettings
    output: OutputSettings
    budget: BudgetSettings | None = None  # runs of earlier versions were saved without it
    simulation: SimulationSettings | None = None

    @property
    def simulated(self) -> bool:
        """Whether the bench is simulated: no oscilloscope is named."""
        return not self.scope.resource
