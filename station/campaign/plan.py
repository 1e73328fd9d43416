"""What a campaign is going to do with a unit: instruments, steps in their order, limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from station.results.verdict import Limit


@dataclass(frozen=True)
class InstrumentCard:
    """An instrument of the bench, as its papers say.

    Attributes
    ----------
    role : str
        ``"oscilloscope"``, ``"rate table"``, ``"chamber"``, ...
    model, serial, firmware : str
        Empty where nobody has stated them.
    calibrated_on, calibration_due : date or None
        ``None``: it needs no calibration, or nobody has stated it.
    """

    role: str
    model: str = ""
    serial: str = ""
    firmware: str = ""
    calibrated_on: date | None = None
    calibration_due: date | None = None


@dataclass(frozen=True)
class PlannedStep:
    """One measurement of a campaign.

    Attributes
    ----------
    key : str
        Unique in the campaign: ``"2 lock-in, 1 of 3"``.
    name : str
        As the campaign calls it; the same for its repeats.
    number : int
        Place in the sequence, from 1.
    measurement : str
        Name that the run is marked with: ``"measure"``.
    repeat, of_repeats : int
        Which of how many, from 1.
    settings : mapping
        Complete settings of the measurement, plain JSON.
    conditions : mapping
        What the controllers are set to before it: ``temperature_degc``, ``voltage_v``.
    warm_up_s, settle_s : float
        Time that passes before it: with the unit on, and at its conditions.
    limits : tuple of Limit
    doubtful : {"marginal", "as_it_is"}
        Verdict of a limit on a result that does not stand.
    """

    key: str
    name: str
    number: int
    measurement: str
    repeat: int
    of_repeats: int
    settings: Mapping[str, Any]
    conditions: Mapping[str, float]
    warm_up_s: float
    settle_s: float
    limits: tuple[Limit, ...]
    doubtful: str = "marginal"


@dataclass(frozen=True)
class ReferenceUnit:
    """The unit that tells whether the bench is in control: units are tested only after it."""

    unit: str
    every_h: float


@dataclass(frozen=True)
class CampaignPlan:
    """A campaign as it is carried out with one unit.

    Attributes
    ----------
    file : Path
        Where the campaign was read from.
    file_sha256 : str
        Of its bytes and of those of the files that it names.
    settings : mapping
        The whole campaign with every default, plain JSON.
    unit : str
        Serial number.
    unit_type : str
        Model of the unit: histories are kept for each.
    directory : Path
        Where the folders of all tested units lie.
    simulated : bool
        Whether all of its benches are.
    attempts : int
        How often a step that the bench ended is begun or gone on with in all.
    retry_after_s : float
        Time between two attempts.
    reports : bool
        Whether every run gets a report of its own.
    switch_off_afterwards : bool
        Whether chamber and power supply are switched off when the test has ended.
    ask_for_unit : bool
        Whether an operator is asked to bring the unit before it begins.
    """

    name: str
    file: Path
    file_sha256: str
    settings: Mapping[str, Any]
    station: str
    unit: str
    unit_type: str
    directory: Path
    simulated: bool
    steps: tuple[PlannedStep, ...]
    instruments: tuple[InstrumentCard, ...] = ()
    reference: ReferenceUnit | None = None
    attempts: int = 1
    retry_after_s: float = 0.0
    reports: bool = True
    switch_off_afterwards: bool = False
    ask_for_unit: bool = False

    @property
    def is_reference(self) -> bool:
        """Whether the unit is the reference unit of the bench."""
        return self.reference is not None and self.reference.unit == self.unit
