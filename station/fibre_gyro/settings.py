"""Settings of ``gyrolock fog``: ``config/fibre_gyro.toml``, and a user's file that holds what differs."""

import math
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field

from analysis.fibre_gyro import FibreCoil
from station.controllers import ControllersSettings, with_controllers
from station.errors import SettingsError
from station.measurements import FIBRE_GYRO_TESTS, limits_of, sections_of
from station.settings import (
    Finite,
    Limits,
    NotNegative,
    OutputSettings,
    Positive,
    SettingsKind,
    SettingsSection,
    SiteSettings,
    Values,
    load,
)

Rates = Annotated[list[Positive], Field(min_length=1)]
Name = Annotated[str, Field(min_length=1, pattern=r"^\S+$")]
RateUnit = Literal["deg/s", "deg/h", "rad/s", "mdeg/s", "mrad/s", "urad/s", "arcsec/s"]
AngleUnit = Literal["deg", "rad", "mdeg", "mrad", "urad", "arcsec"]


class FibreGyroSettings(SettingsSection):
    """The gyro by design."""

    name: str
    coil_length_m: Positive
    coil_diameter_m: Positive
    wavelength_um: Positive
    fibre_index: Annotated[float, Field(ge=1, le=3)]
    dac_bits: Annotated[int, Field(ge=8, le=20)]
    fraction_bits: Annotated[int, Field(ge=0, le=24)]
    counts_per_code: Positive
    output_resolution: NotNegative
    gated_resets: bool


class LinkSettings(SettingsSection):
    """The gyro's serial port."""

    port: str
    frame_format: str
    frame_format_file: str
    speed: Positive


class LogSettings(SettingsSection):
    """How logs are read; what is empty is found out from each file."""

    columns: list[str]
    time_unit: Literal["", "s", "ms", "us", "min", "h"]
    units: Literal["", "counts"] | RateUnit | AngleUnit
    output_rate_hz: NotNegative
    skip_bad_rows: Annotated[int, Field(ge=0, le=1_000_000)] = 0


class FogTableSettings(SettingsSection):
    """The rate-table run."""

    kind: Literal["simulated", "manual", "controller"]
    axes: Annotated[list[Name], Field(min_length=1)]
    rates_dps: Rates
    both_ends_up: bool
    turns: Annotated[int, Field(ge=1, le=100_000)]
    window_s: NotNegative
    settle_s: NotNegative
    rate_tolerance_ppm: Positive
    irreproducibility_ppm: NotNegative | None = None
    rate_u_ppm: NotNegative | None = None


class SelfcalSettings(SettingsSection):
    """The self-calibration by injected staircase."""

    axis: Name
    rates_dps: Annotated[list[Positive], Field(min_length=2)]
    numbers: Literal["differences", "fit", "nominal"]
    path: Literal["shared", "separate"]
    step_s: Positive
    static_s: Positive
    settle_s: NotNegative


class FiguresSettings(SettingsSection):
    """Runs for the figures of merit."""

    axis: Name
    rates_dps: Annotated[list[Positive], Field(min_length=2)]
    runs: Annotated[int, Field(ge=1, le=1000)]
    temperatures_c: list[Finite]
    reference_temperature_c: Finite
    seconds: Positive
    static_s: Positive
    settle_s: NotNegative
    misalignment_mrad: NotNegative
    turn_on_s: NotNegative
    turn_on_rate_dps: NotNegative
    warm_up_bound_dph: Positive
    warm_up_bound_ppm: Positive


class FogSimulationSettings(SettingsSection):
    """The truth of the simulated gyro and table."""

    model: Literal["auto", "output", "transit"]
    seed: Annotated[int, Field(ge=0)]
    output_rate_hz: Positive
    output_filter_hz: NotNegative
    angle_random_walk: NotNegative
    bias_dph: Finite
    two_pi_error: Annotated[float, Field(ge=-0.1, le=0.1)]
    injection_error: Annotated[float, Field(ge=-0.1, le=0.1)]
    scale_change_ppm: Finite
    misalignment_mrad: Finite
    table_irreproducibility_ppm: NotNegative
    table_encoder: bool
    switch_on_scatter_ppm: NotNegative
    temperature_coefficient_ppm: Finite
    asymmetry_ppm: Finite
    cubic_ppm: Finite
    dead_zone_dps: NotNegative
    largest_rate_dps: Positive
    recovery_time_s: NotNegative
    scale_curvature_ppm_per_k2: Finite
    bias_dph_per_k: Finite
    bias_dph_per_k2: Finite
    bias_dph_per_k_per_min: Finite
    bias_dph_per_stimulus: Finite
    scale_ppm_per_stimulus: Finite
    temperature_noise_c: NotNegative
    switch_on_bias_dph: NotNegative
    warm_up_bias_dph: Finite
    warm_up_scale_ppm: Finite
    warm_up_time_s: Positive
    half_wave_v: Positive
    scope_gain_error: Annotated[float, Field(ge=-0.1, le=0.1)]


class FogSettings(SettingsSection):
    """All settings of ``gyrolock fog``."""

    gyro: FibreGyroSettings
    site: SiteSettings
    link: LinkSettings
    logs: LogSettings
    table: FogTableSettings
    selfcal: SelfcalSettings
    figures: FiguresSettings
    controllers: ControllersSettings | None = None
    simulation: FogSimulationSettings
    limits: Limits
    output: OutputSettings

    @property
    def simulated(self) -> bool:
        """Whether the gyro is simulated: no port is named."""
        return not self.link.port

    @property
    def nominal_scale_factor(self) -> float:
        """Scale factor by design, counts per deg/s."""
        return self.coil.nominal_scale(self.gyro.dac_bits) * self.gyro.counts_per_code

    @property
    def gyro_is_described(self) -> bool:
        """Whether anything that the scale factor by design rests on differs from what is shipped."""
        return not math.isclose(self.nominal_scale_factor, load_fog_settings().nominal_scale_factor, rel_tol=1e-12)

    @property
    def coil(self) -> FibreCoil:
        """The coil by design."""
        gyro = self.gyro
        return FibreCoil(gyro.coil_length_m, gyro.coil_diameter_m, 1e-6 * gyro.wavelength_um, gyro.fibre_index)


class TestSettings(SettingsSection):
    """The section of one test, which stands with the test."""

    __test__ = False  # pytest takes whatever begins with Test for one of its own

    @classmethod
    def of(cls, settings: FogSettings) -> Self:
        """Return this section of all settings."""
        return next(section for _, section in settings if isinstance(section, cls))

    def wrong(self) -> str:
        """Say what no single value shows; empty where all is well."""
        return ""


def load_fog_settings(path: Path | None = None, overrides: Values | None = None) -> FogSettings:
    """Read the settings; arguments and errors as :func:`station.settings.load`."""
    return load(FIBRE_GYRO, path, overrides)


def _adapt(values: dict[str, Any]) -> None:
    """Let an operator turn the table under a real gyro: a simulated table cannot."""
    table, link = values.get("table"), values.get("link")
    named = isinstance(link, dict) and link.get("port")
    if named and isinstance(table, dict) and table.get("kind") == "simulated":
        table["kind"] = "manual"


def _check(settings: FogSettings, path: Path) -> FogSettings:
    axes = settings.table.axes
    if len(set(axes)) != len(axes):
        raise SettingsError(f"{path}: table.axes: {', '.join(axes)}: an axis stands there twice")
    for name, section in settings:
        if isinstance(section, TestSettings) and (wrong := section.wrong()):
            raise SettingsError(f"{path}: {name}.{wrong}")
    if settings.simulated and settings.table.kind == "manual":
        raise SettingsError(f'{path}: table.kind = "manual": an operator cannot turn a simulated gyro')
    if settings.simulated and settings.table.kind == "controller":
        raise SettingsError(f'{path}: table.kind = "controller": a controller cannot turn a simulated fibre gyro')
    return with_controllers(settings, settings.table.kind, path)


FIBRE_GYRO = SettingsKind(
    sections=FogSettings,
    limits=lambda: limits_of(*FIBRE_GYRO_TESTS),
    further=lambda: sections_of(*FIBRE_GYRO_TESTS),
    shipped=lambda given: "fibre_gyro",
    adapt=_adapt,
    check=_check,
    later="fibre_gyro",
)
