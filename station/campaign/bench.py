"""The bench of a campaign: looked at, kept from others, chamber and supply brought to conditions."""

import json
import os
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime
from typing import Any

from instrument import InstrumentError
from instrument.claims import claim
from instrument.pyvisa_sessions import meant_by
from station.campaign.journal import CampaignPlan, InstrumentCard, PlannedStep, read_journal, tests_of
from station.controllers import ControllerSettings, ControllersSettings, open_chamber_or_supply
from station.errors import RunError
from station.live.events import Progress
from station.measurements import measurement
from station.results.result import Check
from station.results.verdict import limit_words

CONTROLLER_OF = {"temperature_degc": ("chamber", "temperature"), "voltage_v": ("power_supply", "voltage")}
"""Condition of a step, the controller that brings it about, and the quantity of its template."""


def controllers_of(settings: Mapping[str, Any]) -> ControllersSettings:
    """Return the controllers that the settings of a step name; nothing where they name none."""
    return ControllersSettings.model_validate(settings.get("controllers") or {})


@dataclass(frozen=True)
class Environment:
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


# --------------------
# One campaign on a bench: its instruments are kept from other programs from the first step to the last


_PLACES = (("scope", "resource"), ("link", "port"), ("witness", "resource"))
"""Sections of the measurements' settings that name an instrument of a real bench."""


@contextmanager
def bench_in_use(plan: CampaignPlan) -> Iterator[None]:
    """Keep other programs of this computer from every instrument that a campaign names."""
    # A simulated bench is a program's own and names none.
    doing = f"campaign {plan.name}, unit {plan.unit}"
    with ExitStack() as claims:
        names = [(step.settings.get(section) or {}).get(name) for step in plan.steps for section, name in _PLACES]
        names += [one.resource for step in plan.steps for one in controllers_of(step.settings).there.values()]
        for name in dict.fromkeys(filter(None, names)):
            claims.enter_context(claim(name, doing, means=meant_by(name)))
        yield


# --------------------
# Everything that a campaign will need, looked at before it begins: `gyrolock doctor --station FILE`


_SOON_DAYS = 30
_FAR = 20.0  # times what is expected

_SPARE_BYTES = 50 * 2**20
_STEP_BYTES = 20 * 2**20  # 1000 records with their conditions and a page, at most
_EARLIEST = datetime(2025, 1, 1, tzinfo=UTC)


def examine_campaign(plan: CampaignPlan) -> list[Check]:
    """Look at everything that a campaign will need, in the order in which a person would."""
    summary = f"{plan.file}: {len(plan.steps)} steps, {sum(len(step.limits) for step in plan.steps)} limits"
    far = (Check("limits", "note", text) for text in far_limits(plan))
    checks = [Check("campaign", "ok", summary), *far, disk_space(plan), *_clock(plan)]
    today = datetime.now(UTC).date()
    checks += [_calibration(card, today) for card in plan.instruments]
    looked = [check for found in _benches(plan) for check in found]
    return [*checks, *looked, *_identities(plan.instruments, looked), *_unfinished(plan)]


def far_limits(plan: CampaignPlan) -> Iterator[str]:
    """Say which limits no unit can miss, or none can keep to: far beyond what the settings expect."""
    for step in plan.steps:
        kind = measurement(step.measurement)
        settings = kind.kind.model.model_validate(dict(step.settings))
        declared = (one for group in kind.quantities for one in group.quantities)
        expected = {one.limit_name: one.expected_by(settings) for one in declared if one.limit_name}
        for limit in step.limits:
            about = None if limit.relation else expected.get(limit.number)
            high, low = limit.at_most, limit.at_least
            if about and ((high and not 1 / _FAR <= high / about <= _FAR) or (low and low / about > _FAR)):
                end = f"{limit_words(limit, '')}, {about:g} is expected"
                yield f"{step.key}: {limit.number} {end}: is it in another unit, or a slip of the comma?"


def disk_space(plan: CampaignPlan) -> Check:
    """Look whether a test has room; before its first step, not after hours."""
    directory = plan.directory.absolute()
    existing = next(folder for folder in (directory, *directory.parents) if folder.exists())
    if not os.access(existing, os.W_OK):
        return Check("disk", "bad", f"{directory} cannot be written: choose another output.directory")
    free, needed = shutil.disk_usage(existing).free, len(plan.steps) * _STEP_BYTES
    text = f"{free / 2**20:.0f} MB free for {directory}, a test takes {needed / 2**20:.0f} MB at most"
    return (
        Check("disk", "ok", text) if free > needed + _SPARE_BYTES else Check("disk", "bad", f"{text}: make room")
    )


def _clock(plan: CampaignPlan) -> Iterator[Check]:
    """The time of day stands in records and file names; durations do not depend on it."""
    now = datetime.now(UTC)
    newest = max(
        (path.stat().st_mtime for path in plan.directory.glob("*/*/test.jsonl") if path.is_file()), default=0.0
    )
    if now < _EARLIEST:
        yield Check("clock", "bad", f"it says {now:%Y-%m-%d %H:%M} UTC: set it")
    elif newest > time.time() + 60:
        last = datetime.fromtimestamp(newest, UTC)
        yield Check(
            "clock", "bad", f"it says {now:%Y-%m-%d %H:%M} UTC, the last test was at {last:%Y-%m-%d %H:%M}"
        )
    else:
        yield Check("clock", "ok", f"{now:%Y-%m-%d %H:%M:%S} UTC: compare it with your watch")


def _calibration(card: InstrumentCard, today: date) -> Check:
    name = " ".join(filter(None, (card.role, card.model, card.serial)))
    if card.calibrated_on is not None and card.calibrated_on > today:
        return Check(
            "calibration", "bad", f"{name}: calibrated on {card.calibrated_on}, a day to come: correct it"
        )
    if card.calibration_due is None:
        return Check("calibration", "note", f"{name}: no calibration_due is stated")
    left = (card.calibration_due - today).days
    if left < 0:
        return Check("calibration", "bad", f"{name}: was due on {card.calibration_due}: have it calibrated")
    if left < _SOON_DAYS:
        return Check("calibration", "note", f"{name}: is due on {card.calibration_due}, in {left} days")
    return Check("calibration", "ok", f"{name}: until {card.calibration_due}")


def _benches(plan: CampaignPlan) -> Iterator[list[Check]]:
    """Look at each bench once: steps that differ in what they measure there share it."""
    seen: set[str] = set()
    for step in plan.steps:
        kind = measurement(step.measurement)
        parts = {name: step.settings.get(name) for name in ("scope", "table", "link", "controllers")}
        bench = json.dumps({**parts, "examine": str(kind.examine)}, sort_keys=True)
        if kind.examine is None or bench in seen:
            continue
        seen.add(bench)
        found = kind.examine(kind.kind.model.model_validate(dict(step.settings)))
        yield [replace(one, text=f"{one.text} (for {step.name})") for one in found]


def _identities(cards: tuple[InstrumentCard, ...], looked: list[Check]) -> Iterator[Check]:
    """Compare who answers with who should."""
    answered = [check.text for check in looked if check.name == "oscilloscope" and check.state == "ok"]
    for card in cards:
        if card.role != "oscilloscope" or not (card.serial or card.model):
            continue
        for text in answered:
            for word in filter(None, (card.model, card.serial)):
                if word.replace(" ", "").lower() not in text.replace(" ", "").lower():
                    advice = "connect the right one, or correct [[instrument]]"
                    yield Check(
                        "identity", "bad", f"the oscilloscope is to be {word}, and answers {text}: {advice}"
                    )


def _unfinished(plan: CampaignPlan) -> Iterator[Check]:
    folders = [path for path in plan.directory.glob("*") if path.is_dir()] if plan.directory.is_dir() else []
    left: list[str] = []
    for test in (path for folder in folders for path in tests_of(plan.directory, folder.name)):
        with suppress(RunError):
            left += [str(test)] if read_journal(test).left else []
    if left:
        text = f"not come to their end: {', '.join(left[-5:])}: go on with --resume, or leave them"
        yield Check("tests", "note", text)
