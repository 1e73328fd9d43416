"""The controllers of a bench: their settings, opening them, what is read beside each record."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from pydantic import Field, ValidationError

from instrument.controllers import Controller, ControllerTemplate, parse_template
from instrument.errors import InstrumentError
from instrument.rate_table import ControlledRateTable, Guard
from instrument.simulated import SimulatedRateTable
from instrument.simulated.clock import Clock, VirtualClock
from instrument.simulated.controllers import (
    LineDevice,
    LineServer,
    RateTableController,
    SimulatedChamber,
    SimulatedPowerSupply,
)
from station.errors import SettingsError
from station.settings import SettingsSection, mistakes, read_toml, shipped_settings

Tell = Callable[[str], None]


@contextmanager
def open_controller(
    settings: ControllerSettings, name: str, *, tell: Tell, clock: Clock | None = None
) -> Iterator[Controller]:
    """Open one controller; it is left as it is."""
    template = parse_template(settings.template, settings.file or name)
    sleep, now = (time.sleep, time.monotonic) if clock is None else (clock.sleep, clock.now)
    with Controller(settings.resource, template, tell=tell, sleep=sleep, now=now) as controller:
        yield controller


@contextmanager
def open_rate_table(settings: ControllerSettings, *, tell: Tell) -> Iterator[ControlledRateTable]:
    """Open the rate table; whatever ends this stops it, a killed program too."""
    with open_controller(settings, "rate_table", tell=tell) as controller:
        guard = Guard(settings.resource, settings.template)
        table = ControlledRateTable(controller, guard, tell)
        try:
            yield table
        finally:
            table.close()


@contextmanager
def open_simulated_rate_table(
    device: LineDevice, settings: ControllerSettings, clock: Clock, tell: Tell
) -> Iterator[ControlledRateTable]:
    """Open a simulated table through its bytes: it ends with the program, and needs no guard."""
    with served_device(device) as server:
        named = settings.model_copy(update={"resource": server.resource_name})
        with open_controller(named, "rate_table", tell=tell, clock=clock) as controller:
            table = ControlledRateTable(controller, tell=tell, now=clock.now)
            try:
                yield table
            finally:
                if server.error is None:  # else the simulation has failed, and says why: nothing turns any more
                    table.close()


@contextmanager
def served_device(device: LineDevice) -> Iterator[LineServer]:
    """Serve a simulated device on a serial terminal, or on TCP where the system has none."""
    try:
        server = LineServer(device)
    except OSError:
        server = LineServer(device, tcp_port=0)
    with server:
        yield server


@contextmanager
def served_controllers(table: SimulatedRateTable | None, *, tcp: bool) -> Iterator[dict[str, str]]:
    """Serve the controller of a simulated table, a chamber and a power supply in real time."""
    devices: dict[str, LineDevice] = {}
    if table is not None:
        devices["rate_table"] = RateTableController(table)
        devices |= {"chamber": SimulatedChamber(), "power_supply": SimulatedPowerSupply()}
    with ExitStack() as stack:
        port = 0 if tcp else None
        servers = {name: stack.enter_context(LineServer(one, tcp_port=port)) for name, one in devices.items()}
        yield {name: server.resource_name for name, server in servers.items()}


@functools.cache
def simulated_device(name: str) -> tuple[LineDevice, Clock]:
    """Return the simulated chamber or power supply of this program, and the clock that it lives by."""
    # There is one of each: what one measurement has set, the next one finds.
    clock = VirtualClock()
    return (SimulatedChamber(clock) if name == "chamber" else SimulatedPowerSupply()), clock


@contextmanager
def open_chamber_or_supply(
    settings: ControllerSettings, name: str, *, tell: Tell, simulated: bool
) -> Iterator[Controller]:
    """Open a chamber or a power supply; on a simulated bench one without a resource is simulated as well."""
    if settings.resource or not simulated:
        with open_controller(settings, name, tell=tell) as controller:
            yield controller
        return
    device, clock = simulated_device(name)
    with served_device(device) as server:
        named = settings.model_copy(update={"resource": server.resource_name})
        with open_controller(named, name, tell=tell, clock=clock) as controller:
            yield controller


@dataclass
class EnvironmentControllers:
    """Chamber and power supply, read beside each record."""

    # One that does not answer is told once and not asked again: the record is taken all the same, without it.

    tell: Tell
    controllers: dict[str, Controller] = field(default_factory=dict)

    def __call__(self) -> dict[str, float]:
        """Return what they read, under names with their units: ``chamber_temperature_degc``."""
        found: dict[str, float] = {}
        for name, controller in list(self.controllers.items()):
            try:
                found |= {f"{name}_{what}": value for what, value in controller.readings().items()}
            except InstrumentError as error:
                del self.controllers[name]
                self.tell(f"records are taken without the {name.replace('_', ' ')} from here on: {error}")
        return found


@contextmanager
def open_surroundings(
    controllers: ControllersSettings | None, *, tell: Tell, simulated: bool = False
) -> Iterator[EnvironmentControllers]:
    """Open chamber and power supply, where there are any. Raises as :func:`open_chamber_or_supply`."""
    opened = EnvironmentControllers(tell)
    with ExitStack() as stack:
        for name, one in ({} if controllers is None else controllers.there).items():
            if name != "rate_table":
                opening = open_chamber_or_supply(one, name, tell=tell, simulated=simulated)
                opened.controllers[name] = stack.enter_context(opening)
        yield opened


# --------------------
# Which controllers stand on the bench: where they are connected, and the template of their commands


TABLES = ("rate_table", "acutrol", "ideal_aerosmith")
KINDS = {"rate_table": "rate table", "chamber": "chamber", "power_supply": "power supply"}
"""Name of a controller in the settings, and of its kind in a template."""


class ControllerSettings(SettingsSection):
    """One controller."""

    resource: str = ""  # VISA resource name; empty: the one that is simulated
    file: str = ""  # template, or the name of one that comes with the program; empty: the plain one
    template: dict[str, Any] = Field(default={})  # what stands in that file: a run carries it along


class ControllersSettings(SettingsSection):
    """Controllers of the bench; those that are absent are not there."""

    rate_table: ControllerSettings | None = None
    chamber: ControllerSettings | None = None
    power_supply: ControllerSettings | None = None

    @property
    def there(self) -> dict[str, ControllerSettings]:
        """Those that are there, by name."""
        return {name: one for name in KINDS if (one := getattr(self, name)) is not None}


S = TypeVar("S", bound=SettingsSection)


def with_controllers(settings: S, table_kind: str, path: Path) -> S:
    """Return settings whose controllers have their templates with them, so that a run carries them along."""
    controllers: ControllersSettings | None = getattr(settings, "controllers", None)
    if table_kind == "controller" and (controllers is None or controllers.rate_table is None):
        raise SettingsError(
            f'{path}: table.kind = "controller" needs a section [controllers.rate_table] with resource and file'
        )
    if controllers is None:
        return settings
    simulated = bool(getattr(settings, "simulated", False))
    for name, one in controllers.there.items():
        if not one.resource and not simulated:
            raise SettingsError(f"{path}: controllers.{name}.resource: is empty, and the bench is a real one")
        if one.resource and simulated and name == "rate_table":
            raise SettingsError(
                f"{path}: controllers.rate_table.resource: a real table cannot turn a simulated gyro"
            )
    there = {name: _with_template(one, name, path) for name, one in controllers.there.items()}
    return settings.model_copy(update={"controllers": controllers.model_copy(update=there)})


def _with_template(one: ControllerSettings, name: str, path: Path) -> ControllerSettings:
    if one.template:
        return one
    file = path.parent / one.file
    if not one.file or one.file in TABLES:
        file = shipped_settings(f"controllers/{one.file or name}")
    values = read_toml(file)
    try:
        template = ControllerTemplate.model_validate(values)
    except ValidationError as error:
        raise SettingsError(mistakes(file, error, ControllerTemplate)) from None
    if template.kind != KINDS[name]:
        raise SettingsError(f"{file}: is the template of a {template.kind}, not of a {KINDS[name]}")
    return one.model_copy(update={"template": values})
