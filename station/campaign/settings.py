"""What may stand in a campaign file: every name, its unit and what it may hold."""

from __future__ import annotations

import difflib
from datetime import date
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, WithJsonSchema, model_validator

from station.measurements import MEASUREMENTS
from station.settings.parts import Finite, NotNegative, OutputSettings, Positive, SettingsSection

Text = Annotated[str, Field(min_length=1, max_length=200)]
GuardBand = Literal["none", "U95", "simple"]
Sections = dict[str, dict[str, Any]]
"""Settings of measurements by section and name, as they stand in a settings file."""


def _is_measurement(name: str) -> str:
    if name not in MEASUREMENTS:
        like = difflib.get_close_matches(name, MEASUREMENTS, 1)
        hint = f"did you mean {like[0]}?" if like else f"there are {', '.join(MEASUREMENTS)}"
        raise ValueError(f"no such measurement; {hint}")
    return name


MeasurementName = Annotated[
    str, AfterValidator(_is_measurement), WithJsonSchema({"type": "string", "enum": list(MEASUREMENTS)})
]


class CampaignSection(SettingsSection):
    """The campaign as a whole."""

    name: Text
    unit_type: Text
    station: Text
    guard_band: GuardBand = "U95"
    doubtful: Literal["marginal", "as_it_is"] = "marginal"
    attempts: Annotated[int, Field(ge=1, le=100)] = 3
    retry_after_s: NotNegative = 10.0
    reports: bool = True
    switch_off_afterwards: bool = False
    ask_for_unit: bool = False


class ReferenceSection(SettingsSection):
    """The unit that is measured regularly to see whether the bench is in control."""

    unit: Text
    every_h: Positive = 24.0


class InstrumentSection(SettingsSection):
    """An instrument of the bench, as its papers say."""

    role: Text
    model: str = ""
    serial: str = ""
    calibrated_on: date | None = None
    calibration_due: date | None = None

    @model_validator(mode="after")
    def _due_after_calibration(self) -> Self:
        if self.calibrated_on and self.calibration_due and self.calibration_due <= self.calibrated_on:
            raise ValueError("calibration_due must lie after calibrated_on")
        return self


class LimitSection(SettingsSection):
    """What a number of a result has to keep to."""

    number: Text
    at_least: Finite | None = None
    at_most: Finite | None = None
    guard_band: GuardBand | None = None
    highest_risk_percent: Annotated[float, Field(gt=0, le=50)] = 50.0

    @model_validator(mode="after")
    def _has_an_end(self) -> Self:
        if self.at_least is None and self.at_most is None:
            raise ValueError("a limit needs at_least, at_most or both")
        if self.at_least is not None and self.at_most is not None and self.at_least >= self.at_most:
            raise ValueError("at_least must lie below at_most")
        return self


class ConditionsSection(SettingsSection):
    """What chamber and power supply are set to."""

    temperature_degc: Annotated[float, Field(gt=-273.15, le=1000)] | None = None
    voltage_v: Annotated[float, Field(ge=-1000, le=1000)] | None = None


class StepSection(SettingsSection):
    """One measurement, with its repeats and limits."""

    name: Text
    measurement: MeasurementName
    repeat: Annotated[int, Field(ge=1, le=10_000)] = 1
    warm_up_s: NotNegative = 0.0
    settle_s: NotNegative = 0.0
    conditions: ConditionsSection = ConditionsSection()
    settings: Sections = Field(default={})
    limit: tuple[LimitSection, ...] = ()


class CampaignFile(SettingsSection):
    """A campaign file."""

    campaign: CampaignSection
    output: OutputSettings = OutputSettings(directory="tests")
    reference: ReferenceSection | None = None
    instrument: tuple[InstrumentSection, ...] = ()
    bench: Sections = Field(default={})
    unit: dict[str, Sections] = Field(default={})
    step: Annotated[tuple[StepSection, ...], Field(min_length=1)]
