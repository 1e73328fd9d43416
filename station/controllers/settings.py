"""Which controllers stand on the bench: where they are connected, and the template of their commands."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

from pydantic import Field, ValidationError

from instrument.templates.description import ControllerTemplate
from station.errors import SettingsError
from station.settings.load import shipped_settings
from station.settings.parts import SettingsSection
from station.settings.toml_files import mistakes, read_toml

KINDS = {"rate_table": "rate table", "chamber": "chamber", "power_supply": "power supply"}
"""Name of a controller in the settings, and of its kind in a template."""


class ControllerSettings(SettingsSection):
    """One controller."""

    resource: str = ""  # VISA resource name; empty: the one that is simulated
    file: str = ""  # template; empty: the one that comes with the program
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
    file = path.parent / one.file if one.file else shipped_settings(f"controllers/{name}")
    values = read_toml(file)
    try:
        template = ControllerTemplate.model_validate(values)
    except ValidationError as error:
        raise SettingsError(mistakes(file, error, ControllerTemplate)) from None
    if template.kind != KINDS[name]:
        raise SettingsError(f"{file}: is the template of a {template.kind}, not of a {KINDS[name]}")
    return one.model_copy(update={"template": values})
