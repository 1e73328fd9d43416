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
    """An instrument of the bench, as its papers say."""

    role: str  # ``"oscilloscope"``, ``"rate table"``, ``"chamber"``, ..
    model: str = ""  # empty where nobody has stated them
    serial: str = ""
    firmware: str = ""
    calibrated_on: date | None = None  # ``None``: it needs no calibration, or nobody has stated it
    calibration_due: date | None = None


@dataclass(frozen=True)
class PlannedStep:
    """One measurement of a campaign."""

    key: str  # unique in the campaign: ``"2 lock-in, 1 of 3"``
    name: str  # as the campaign calls it; the same for its repeats
    number: int  # place in the sequence, from 1
    measurement: str  # name that the run is marked with: ``"measure"``
    repeat: int  # which of how many, from 1
    of_repeats: int
    settings: Mapping[str, Any]  # complete settings of the measurement, plain JSON
    # what the controllers are set to before it: ``temperature_degc``, ``voltage_v``
    conditions: Mapping[str, float]
    warm_up_s: float  # time that passes before it: with the unit on, and at its conditions
    settle_s: float
    limits: tuple[Limit, ...]
    doubtful: str = "marginal"  # {"marginal", "as_it_is"}: Verdict of a limit on a result that does not stand


@dataclass(frozen=True)
class ReferenceUnit:
    """The unit that tells whether the bench is in control: units are tested only after it."""

    unit: str
    every_h: float


@dataclass(frozen=True)
class CampaignPlan:
    """A campaign as it is carried out with one unit."""

    name: str
    file: Path  # where the campaign was read from
    file_sha256: str  # of its bytes and of those of the files that it names
    settings: Mapping[str, Any]  # the whole campaign with every default, plain JSON
    station: str
    unit: str  # serial number
    unit_type: str  # model of the unit: histories are kept for each
    directory: Path  # where the folders of all tested units lie
    simulated: bool  # whether all of its benches are
    steps: tuple[PlannedStep, ...]
    instruments: tuple[InstrumentCard, ...] = ()
    reference: ReferenceUnit | None = None
    attempts: int = 1  # how often a step that the bench ended is begun or gone on with in all
    retry_after_s: float = 0.0  # time between two attempts
    reports: bool = True  # whether every run gets a report of its own
    # whether chamber and power supply are switched off when the test has ended
    switch_off_afterwards: bool = False
    ask_for_unit: bool = False  # whether an operator is asked to bring the unit before it begins

    @property
    def is_reference(self) -> bool:
        """Whether the unit is the reference unit of the bench."""
        return self.reference is not None and self.reference.unit == self.unit
