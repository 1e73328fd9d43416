"""Chamber and power supply of a campaign: brought to the conditions of a step, read, switched off."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from instrument import InstrumentError
from station.campaign.plan import CampaignPlan, PlannedStep
from station.controllers.open import open_chamber_or_supply
from station.controllers.settings import ControllerSettings, ControllersSettings
from station.runs.progress import Progress

CONTROLLER_OF = {"temperature_degc": ("chamber", "temperature"), "voltage_v": ("power_supply", "voltage")}
"""Condition of a step, the controller that brings it about, and the quantity of its template."""


def controllers_of(settings: Mapping[str, Any]) -> ControllersSettings:
    """Return the controllers that the settings of a step name; nothing where they name none."""
    return ControllersSettings.model_validate(settings.get("controllers") or {})


@dataclass(frozen=True)
class Surroundings:
    """What stands round the unit."""

    plan: CampaignPlan
    progress: Progress

    def bring_about(self, step: PlannedStep) -> dict[str, float]:
        """Set what a step asks for, and wait until it is steady."""
        reached: dict[str, float] = {}
        for name, one in controllers_of(step.settings).there.items():
            wanted = {
                quantity: step.conditions[condition]
                for condition, (controller, quantity) in CONTROLLER_OF.items()
                if controller == name and condition in step.conditions
            }
            if wanted:
                reached |= self._set(one, name, wanted)
        if reached:
            self.progress.events.emit("conditions", **reached)
        return reached

    def switch_off(self) -> None:
        """Switch chamber and power supply off; one that does not answer is told."""
        named = [controllers_of(step.settings).there for step in self.plan.steps]
        there = {name: one for controllers in named for name, one in controllers.items() if name != "rate_table"}
        for name, one in there.items():
            try:
                with self._open(one, name) as controller:
                    controller.do("off")
                self.progress.note(f"the {name.replace('_', ' ')} is switched off")
            except (InstrumentError, OSError) as error:
                self.progress.note(f"the {name.replace('_', ' ')} could not be switched off: {error}")

    def _set(self, one: ControllerSettings, name: str, wanted: Mapping[str, float]) -> dict[str, float]:
        with self._open(one, name) as controller:
            controller.do("on")
            for quantity, value in wanted.items():
                self.progress.note(f"{name.replace('_', ' ')}: {quantity} to {value:g}")
                controller.set(quantity, value)
            return {f"{name}_{what}": value for what, value in controller.readings().items()}

    def _open(self, one: ControllerSettings, name: str) -> Any:
        return open_chamber_or_supply(one, name, tell=self.progress.note, simulated=self.plan.simulated)
