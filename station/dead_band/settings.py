"""Settings of ``gyrolock deadband``: ``config/dead_band.toml``, and a user's file that holds what differs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from station.controllers.settings import ControllersSettings, with_controllers
from station.errors import SettingsError
from station.ring_laser.settings import GyroSettings, ScopeSettings, SimulationSettings
from station.settings.load import SettingsKind
from station.settings.parts import Finite, Limit, NotNegative, OutputSettings, SettingsSection, SiteSettings


class TableSettings(SettingsSection):
    """The rate table under the gyro."""

    kind: Literal["simulated", "manual", "controller"]
    settle_s: NotNegative
    tilt_deg: Annotated[float, Field(ge=0, lt=90)]
    north_azimuth_deg: Finite
    rate_u_dps: NotNegative


class SweepSettings(SettingsSection):
    """Rates, how many records at each, and what a record shall look like."""

    highest_over_lock_in: Annotated[float, Field(gt=1, le=1000)]
    steps: Annotated[int, Field(ge=2, le=10_000)]
    rates_over_lock_in: tuple[Annotated[float, Field(gt=0, le=1000)], ...] = ()
    records: Annotated[int, Field(ge=1, le=1000)]
    periods_min: Annotated[float, Field(ge=3, le=500)]
    samples_per_period_min: Annotated[float, Field(ge=5, le=500)]
    fill_levels: Annotated[float, Field(ge=10, le=120)]


class LimitSettings(SettingsSection):
    """Limits; one that is absent is not tested. Names as in the JSON of a result."""

    dead_band_dps: Limit = None
    lock_in_rate_dps: Limit = None
    lock_in_rate_u_dps: Limit = None
    bias_rate_dps: Limit = None
    hysteresis_dps: Limit = None
    bias_drift_dps: Limit = None


class DeadBandSettings(SettingsSection):
    """All settings of a sweep. ``simulation`` is absent on a real bench."""

    gyro: GyroSettings
    site: SiteSettings
    table: TableSettings
    scope: ScopeSettings
    sweep: SweepSettings
    output: OutputSettings
    controllers: ControllersSettings | None = None
    simulation: SimulationSettings | None = None
    limits: LimitSettings = LimitSettings()

    @property
    def simulated(self) -> bool:
        """Whether the bench is simulated: no oscilloscope is named."""
        return not self.scope.resource

    @property
    def turning_dps(self) -> float:
        """A simulated table rests at the beginning."""
        return 0.0


def _adapt(values: dict[str, Any]) -> None:
    """Let an operator turn the table under a real gyro: a simulated one cannot."""
    scope, table = values.get("scope"), values.get("table")
    if isinstance(scope, dict) and scope.get("resource"):
        values.pop("simulation", None)
        if isinstance(table, dict) and table.get("kind") == "simulated":
            table["kind"] = "manual"


def _check(settings: DeadBandSettings, path: Path) -> DeadBandSettings:
    if settings.simulated and settings.simulation is None:
        raise SettingsError(f"{path}: scope.resource is empty and there is no [simulation]: name the oscilloscope")
    if settings.simulated and settings.table.kind == "manual":
        raise SettingsError(f'{path}: table.kind = "manual": an operator cannot turn a simulated table')
    rates = settings.sweep.rates_over_lock_in
    if rates and max(rates) <= 1:
        raise SettingsError(
            f"{path}: sweep.rates_over_lock_in: the highest, {max(rates):g}, must lie beyond lock-in: above 1"
        )
    if settings.scope.quadrature_channel:
        raise SettingsError(f"{path}: scope.quadrature_channel: a sweep needs one channel only")
    return with_controllers(settings, settings.table.kind, path)


DEAD_BAND = SettingsKind(
    model=DeadBandSettings,
    shipped=lambda given: "dead_band",
    adapt=_adapt,
    check=_check,
    knowledge=("limits.*", "table.tilt_deg", "table.north_azimuth_deg", "table.rate_u_dps"),
)
