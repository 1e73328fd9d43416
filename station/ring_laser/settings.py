"""What settings of every measurement of a ring laser hold: gyro, oscilloscope, and the truth of a simulated bench.

Values that came later have defaults here as well: a run that was saved without them can still be read.
"""

from typing import Annotated, Literal, Protocol

from pydantic import Discriminator, Field, Tag

from station.controllers import ControllersSettings
from station.settings import Finite, NotNegative, Positive, SettingsSection, SiteSettings

Dbc = Annotated[float, Field(ge=-200, le=0)]
Channel = Literal["CH1", "CH2", "CH3", "CH4"]


class RingLaserSettings(SettingsSection):
    """The gyro under test, as far as it is known beforehand."""

    name: str
    scale_factor_pulses_per_deg: Positive
    expected_lock_in_rate_dps: Positive


class ScopeSettings(SettingsSection):
    """The oscilloscope and its input."""

    resource: str
    channel: Channel
    quadrature_channel: Literal["", "CH1", "CH2", "CH3", "CH4"] = ""
    coupling: Literal["DC", "AC"]
    probe: Literal[1, 10, 100, 1000]
    bandwidth_limit: bool
    baud_rate: Literal[0, 300, 600, 1200, 2400, 4800, 9600, 19200]
    reconnect_s: NotNegative = 90.0


class BeamsSettings(SettingsSection):
    """Photodiodes on the single beams, and what is known of their channels; 0 and empty: not known."""

    channels: Annotated[tuple[Channel, ...], Field(max_length=2)] = ()
    coupling: Literal["DC", "AC"] = "AC"
    level_v: Annotated[tuple[Positive, ...], Field(max_length=2)] = ()
    level_u_percent: NotNegative = 0.0
    crosstalk_limit_db: Annotated[float, Field(ge=-200, le=0)] = 0.0
    unequal_limit_percent: Annotated[float, Field(ge=0, le=100)] = 0.0
    bandwidth_hz: NotNegative = 0.0
    dead_band_dps: NotNegative = 0.0
    dead_band_u_dps: NotNegative = 0.0


class DitherSettings(SettingsSection):
    """A dither of the gyro's body, records of it, and the random walk that its counts have; 0: not known."""

    on: bool = False
    frequency_hz: NotNegative = 0.0
    rate_dps: Positive = 100.0
    periods: Annotated[float, Field(ge=0.6, le=20)] = 2.0
    records: Annotated[int, Field(ge=1, le=10_000)] = 20
    random_walk_deg_per_sqrt_h: NotNegative = 0.0
    random_walk_u_deg_per_sqrt_h: NotNegative = 0.0
    counts: Annotated[
        Annotated[str, Tag("file")] | Annotated[tuple[int, ...], Field(max_length=100_000), Tag("gates")],
        Discriminator(lambda value: "file" if isinstance(value, str) else "gates"),
    ] = ()
    gate_s: Positive = 1.0


class DitherMotionSettings(SettingsSection):
    """The dither of a simulated bench, and the receiver that follows its beats."""

    frequency_hz: Positive = 403.0
    rate_dps: Positive = 100.0
    noise_percent: Annotated[float, Field(ge=0, le=20)] = 2.0
    bandwidth_hz: Positive = 2e6


class BeamLightSettings(SettingsSection):
    """The single beams of a simulated bench."""

    level_v: Annotated[tuple[Positive, ...], Field(min_length=2, max_length=2)] = (1.0, 0.8)
    noise_v: NotNegative = 0.0001
    crosstalk_db: Dbc | None = None


class ContaminantSettings(SettingsSection):
    """What spoils the measurement on a simulated bench; everything is absent unless it is named."""

    second_harmonic_dbc: Dbc | None = None
    third_harmonic_dbc: Dbc | None = None
    bandwidth_hz: NotNegative = 0.0
    ac_corner_hz: NotNegative = 0.0
    gain_corner_hz: NotNegative = 0.0
    cross_saturation: Annotated[float, Field(ge=0, lt=1)] = 0.5
    backscatter_phase_sum_deg: Annotated[float, Field(gt=-170, lt=170)] = 0.0
    backscatter_ratio: Annotated[float, Field(gt=0, le=100)] = 1.0
    beam_imbalance: Annotated[float, Field(gt=-1, lt=1)] = 0.0
    gain_dispersion: Annotated[float, Field(ge=-1, le=1)] = 0.0
    single_beams: Annotated[float, Field(ge=0, le=10)] = 0.0
    rate_ripple_dps: NotNegative = 0.0
    rate_ripple_hz: NotNegative = 1.0
    pump_ripple: Annotated[float, Field(ge=0, lt=1)] = 0.0
    pump_ripple_hz: NotNegative = 100.0
    scale_factor_error_ppm: Annotated[float, Field(gt=-1e6, lt=1e6)] = 0.0
    scale_factor_drift_ppm_per_hour: Annotated[float, Field(gt=-1e6, lt=1e6)] = 0.0
    quadrature_gain_error: Annotated[float, Field(gt=-1, lt=1)] = 0.0
    quadrature_phase_error_deg: Annotated[float, Field(gt=-80, lt=80)] = 0.0


class SimulationSettings(SettingsSection):
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
    beams: BeamLightSettings = BeamLightSettings()
    dither: DitherMotionSettings = DitherMotionSettings()


class TableMount(Protocol):
    """The rate table, as the bench sees it."""

    @property
    def kind(self) -> Literal["simulated", "manual", "controller", "none"]:
        """``"none"``: it turns already, and cannot be set."""

    @property
    def north_azimuth_deg(self) -> float:
        """Table reading at which the horizontal part of the gyro's axis points north."""


class BenchSettings(Protocol):
    """What a bench is opened with: the part of a measurement's settings that it needs."""

    @property
    def gyro(self) -> RingLaserSettings:
        """The gyro under test."""

    @property
    def site(self) -> SiteSettings:
        """Where the bench stands."""

    @property
    def table(self) -> TableMount:
        """The rate table."""

    @property
    def scope(self) -> ScopeSettings:
        """The oscilloscope."""

    @property
    def beams(self) -> BeamsSettings:
        """Photodiodes on the single beams."""

    @property
    def dither(self) -> DitherSettings:
        """The dither of the gyro's body."""

    @property
    def simulation(self) -> SimulationSettings | None:
        """The truth of a simulated bench; ``None`` on a real one."""

    @property
    def controllers(self) -> ControllersSettings | None:
        """Controllers of the bench; ``None`` where there are none."""

    @property
    def simulated(self) -> bool:
        """Whether the bench is simulated."""

    @property
    def turning_dps(self) -> float:
        """Rate in deg/s at which a simulated table turns from the beginning."""
