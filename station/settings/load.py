"""Settings: commented TOML files, checked as a whole before anything moves.

The defaults stand in ``config/simulated.toml`` and ``config/bench.toml`` and nowhere else. A user's file
holds only what differs from one of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Literal

from pydantic import ValidationError

from station.errors import SettingsError
from station.lock_in.response_file import check_response, read_response
from station.lock_in.settings import (
    MeasurementSettings,
    ScopeSettings,
    Settings,
    SimulationSettings,
)
from station.settings.toml_files import merged, mistakes, read_toml

__all__ = [
    "MeasurementSettings",
    "ScopeSettings",
    "Settings",
    "ShippedName",
    "SimulationSettings",
    "default_settings",
    "load_settings",
    "shipped_settings",
]

ShippedName = Literal["simulated", "bench", "fibre_gyro", "fibre_gyro_serial", "fibre_gyro_frames"]
BenchName = Literal["simulated", "bench"]


def shipped_settings(name: ShippedName) -> Path:
    """Find a settings file that came with the package.

    Parameters
    ----------
    name : {"simulated", "bench", "fibre_gyro", "fibre_gyro_serial", "fibre_gyro_frames"}

    Returns
    -------
    Path
        In an installed package ``station/config``, in a source tree ``config`` beside the package.

    Raises
    ------
    SettingsError
        If the installation is incomplete.
    """
    here = Path(__file__).resolve().parent.parent
    for folder in (here / "config", here.parent / "config"):
        if (file := folder / f"{name}.toml").is_file():
            return file
    raise SettingsError(
        f"the settings file {name}.toml did not come with this installation: install gyrolock again"
    )


def load_settings(
    path: Path | None = None,
    *,
    resource: str | None = None,
    overrides: Mapping[str, Mapping[str, object]] | None = None,
) -> Settings:
    """Read the settings of a run.

    Parameters
    ----------
    path : Path, optional
        The user's file. Only what differs from the shipped file need stand in it.
    resource : str, optional
        VISA resource name from the command line. Where one is given, here or in the file, the defaults
        are those of ``bench.toml``, else those of ``simulated.toml``.
    overrides : mapping of mapping, optional
        Values from the command line, by section and name; they win over the file.

    Returns
    -------
    Settings

    Raises
    ------
    SettingsError
        With every mistake of the file in one text: file, place, what is wrong.
    """
    user = read_toml(path) if path is not None else {}
    scope = user.get("scope")
    named = resource or (scope.get("resource") if isinstance(scope, dict) else None)
    shipped = shipped_settings("bench" if named else "simulated")
    values = merged(read_toml(shipped), user)
    if named and path is not None:
        # a file made for the simulated bench may be used with a real scope: its truth then means nothing
        values.pop("simulation", None)
        table = values.get("table")
        if isinstance(table, dict) and table.get("kind") == "simulated":
            table["kind"] = "none"
    values = merged(values, {section: dict(names) for section, names in (overrides or {}).items()})
    if resource:
        values = merged(values, {"scope": {"resource": resource}})
    try:
        settings = Settings.model_validate(values)
    except ValidationError as error:
        raise SettingsError(mistakes(path or shipped, error)) from None
    _check_whole(path or shipped, settings)
    return _with_response(path or shipped, settings)


def _with_response(path: Path, settings: Settings) -> Settings:
    """Read the response of the channel from the file that is named, so that a run carries it along."""
    front_end = settings.front_end
    if not front_end.response_file:
        if front_end.response:
            check_response(front_end.response, f"{path}: front_end.response")
        return settings
    if front_end.response:
        raise SettingsError(f"{path}: front_end: give either response or response_file, not both")
    # a relative name is meant from where the settings stand
    rows = read_response(path.parent / front_end.response_file)
    return settings.model_copy(update={"front_end": front_end.model_copy(update={"response": rows})})


def default_settings(name: BenchName = "simulated") -> Settings:
    """Return the settings of a shipped file as they stand."""
    return _shipped(name)


@cache
def _shipped(name: BenchName) -> Settings:
    return Settings.model_validate(read_toml(shipped_settings(name)))


def _check_whole(path: Path, settings: Settings) -> None:
    """Check what no single value shows."""
    if settings.simulated and settings.simulation is None:
        raise SettingsError(f"{path}: scope.resource is empty and there is no [simulation]: name the oscilloscope")
    if settings.simulated and settings.table.kind == "manual":
        raise SettingsError(
            f'{path}: table.kind: an operator cannot turn a simulated table; use "simulated" or "none"'
        )
    if settings.measurement.rates_over_lock_in and settings.table.kind == "none":
        raise SettingsError(
            f"{path}: measurement.rates_over_lock_in: several rates need a table that can be set; "
            'table.kind = "none" has none'
        )
    if settings.scope.quadrature_channel == settings.scope.channel:
        raise SettingsError(f"{path}: scope.quadrature_channel: is the same as scope.channel")
    if not settings.simulated and settings.table.kind == "simulated":
        raise SettingsError(
            f'{path}: table.kind: a simulated table cannot turn a real gyro; use "manual" or "none"'
        )
