"""Settings of any measurement: commented TOML files, checked as a whole before anything moves.

The defaults stand in the files of ``config/`` and nowhere else. A user's file holds only what differs from one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import ValidationError

from station.errors import RunError, SettingsError, UsageError
from station.settings.parts import SettingsSection
from station.settings.toml_files import merged, mistakes, read_toml

S = TypeVar("S", bound=SettingsSection)
Values = Mapping[str, Mapping[str, object]]
"""Settings by section and name, as the command line gives them."""

_FREE = ("limits", "output")
"""Sections that say nothing of what is measured."""


@dataclass(frozen=True)
class SettingsKind(Generic[S]):
    """How the settings of one kind of measurement are read."""

    model: type[S]  # what may stand in a file
    # name of the shipped file that gives the defaults, for what the user has given
    shipped: Callable[[Mapping[str, Any]], str]
    # changes defaults that do not go with what the user has given; gets all values
    adapt: Callable[[dict[str, Any]], None]
    # checks what no single value shows, and completes the settings; gets them and the file's path. Raises
    # SettingsError.
    check: Callable[[S, Path], S]
    # shipped file that gives what a run of an earlier version was saved without; empty: the model's defaults
    later: str = ""
    # what is known of the bench, with which a saved run can be evaluated later: ``section.name``, ``section.*``
    # for each of its values, or ``section`` where its values belong together and are replaced together
    knowledge: tuple[str, ...] = ("limits.*",)

    def with_knowledge(self, saved: S, path: Path, overrides: Values | None = None) -> S:
        """Return saved settings with what a file states of the bench today; what it does not state stays."""
        now, stated = load(self, path, overrides), _given(path, overrides)
        updates: dict[str, Any] = {}
        for place in self.knowledge:
            section, _, name = place.partition(".")
            before = updates.get(section, getattr(saved, section))
            said = stated.get(section, {})
            if name and before is not None:
                names = [one for one in said if name in ("*", one)]
                updates[section] = before.model_copy(
                    update={one: getattr(getattr(now, section), one) for one in names}
                )
            elif said:
                updates[section] = getattr(now, section)
        return saved.model_copy(update=updates)

    def is_knowledge(self, place: str) -> bool:
        """Whether a value, as ``section.name``, is one of those."""
        section = place.split(".")[0]
        return not {place, section, f"{section}.*"}.isdisjoint(self.knowledge)


def shipped_settings(name: str) -> Path:
    """Find a settings file that came with the package."""
    package = Path(__file__).resolve().parent.parent
    for folder in (package / "config", package.parent / "config"):
        if (file := folder / f"{name}.toml").is_file():
            return file
    raise SettingsError(
        f"the settings file {name}.toml did not come with this installation: install gyrolock again"
    )


def load(kind: SettingsKind[S], path: Path | None = None, overrides: Values | None = None) -> S:
    """Read the settings of a run."""
    given = _given(path, overrides)
    shipped = shipped_settings(kind.shipped(given))
    values = merged(read_toml(shipped), given)
    kind.adapt(values)
    return kind.check(_validated(kind, values, path or shipped), path or shipped)


def saved_settings(kind: SettingsKind[S], values: Mapping[str, Any], place: str) -> S:
    """Return the settings that a run was taken with."""
    if values and kind.later:
        values = merged(read_toml(shipped_settings(kind.later)), values)
    try:
        return kind.model.model_validate(dict(values))
    except ValidationError:
        raise RunError(f"{place}: the settings of this run cannot be read") from None


def settings_to_resume(
    kind: SettingsKind[S], saved: S, path: Path | None, overrides: Values | None, run: Path
) -> S:
    """Return the settings of a run that is gone on with, with what a file knows of the bench now.

    What is given must not change what is measured.
    """
    if path is not None or overrides:
        load(kind, path, overrides)  # its mistakes come first
    before = dict(_flat(saved.model_dump(mode="json")))
    changed = [
        f"{place} is {before.get(place)!r} in the run, not {value!r}"
        for place, value in _flat(_given(path, overrides))
        if place.split(".")[0] not in _FREE and not kind.is_knowledge(place) and before.get(place) != value
    ]
    if changed:
        raise UsageError(
            f"{run}: cannot be gone on with, other settings would change what is measured: {'; '.join(changed)}"
        )
    return kind.with_knowledge(saved, path, overrides) if path is not None else saved


def _given(path: Path | None, overrides: Values | None) -> dict[str, Any]:
    user = read_toml(path) if path is not None else {}
    # a section that a saved run does not have is None there
    stated = {section: dict(names) for section, names in (overrides or {}).items() if names is not None}
    return merged(user, stated)


def _validated(kind: SettingsKind[S], values: Mapping[str, Any], path: Path) -> S:
    try:
        return kind.model.model_validate(dict(values))
    except ValidationError as error:
        raise SettingsError(mistakes(path, error, kind.model)) from None


def _flat(values: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Walk through all values: dotted place, and value."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value
