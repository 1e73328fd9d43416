"""A form of a measurement's settings: fields, defaults and help from its shipped file, choices from its model.

Nothing here knows a measurement: what the registry lists has a form.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel

from station.errors import SettingsError, UsageError
from station.measurements import MEASUREMENTS, Measurement, measurement
from station.results.quantity import UNITS
from station.settings import load, model_at, shipped_settings

Kind = Literal["text", "switch", "choice", "list"]

REAL: dict[str, dict[str, object]] = {"scope": {"resource": "?"}, "link": {"port": "?"}}
"""What a user names who has a real bench."""

_SECTION = re.compile(r"\[([\w.]+)\]\s*$")
_SETTING = re.compile(r"(# )?(\w+) = (.*?)(?:\s+#\s*(.*))?$")
_MISTAKE = re.compile(r"([a-z_]+(?:\.\w+)+)(?: \(line \d+\))?: ")


@dataclass(frozen=True)
class FormField:
    """One setting."""

    place: str  # "measurement.records"
    default: str  # as it is typed; empty where the file leaves it out
    help: str
    kind: Kind
    choices: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Its name as a person reads it, without its unit."""
        name = self.place.rpartition(".")[2]
        stem = name.removesuffix(f"_{self._unit}") if self._unit else name
        return stem.replace("_", " ").replace("lock in", "lock-in")

    @property
    def unit(self) -> str:
        """Its unit, by the end of its name."""
        return UNITS.get(self._unit, "")

    @property
    def _unit(self) -> str:
        name = self.place.rpartition(".")[2]
        return max((one for one in UNITS if name.endswith(f"_{one}")), key=len, default="")


@dataclass(frozen=True)
class FormSection:
    """Settings that stand together."""

    name: str
    fields: tuple[FormField, ...]


def measurements() -> dict[str, str]:
    """Return what can be measured: name and title."""
    return {name: measurement(name).title for name in MEASUREMENTS if name != "program"}


def kind_of(name: str) -> Measurement[Any, Any]:
    """Return a measurement by its name; UsageError if there is none."""
    if name not in measurements():
        raise UsageError(f"there is no measurement {name!r}")
    return measurement(name)


def form_of(name: str, *, real: bool = False) -> list[FormSection]:
    """Return the sections that a measurement has, its own first."""
    kind = kind_of(name).kind
    file = shipped_settings(kind.shipped(REAL if real else {}))
    found: dict[str, dict[str, FormField]] = {}
    for section, field in _fields(file, kind.model):
        before = found.setdefault(section, {}).get(field.place)
        if before is None or field.default:  # in comments a setting may stand as an example
            found[section][field.place] = field
    # of settings that several measurements share, the sections of the others are of no use
    others = {one for one in MEASUREMENTS if measurement(one).kind is kind and one not in (name, "table")}
    sections = [FormSection(one, tuple(fields.values())) for one, fields in found.items() if one not in others]
    return sorted(sections, key=lambda one: one.name != name)


def _fields(file: Path, model: type[BaseModel]) -> Iterator[tuple[str, FormField]]:
    section, said = "", list[str]()
    for line in file.read_text(encoding="utf-8").splitlines():
        if found := _SECTION.match(line):
            section, said = found[1], []
        elif (found := _SETTING.match(line)) and section:
            commented, key, value, behind = found.groups()
            if (field := _field(section, key, value, model, stated=not commented)) is not None:
                helped = " ".join([*said, behind or ""]).strip()
                yield section, FormField(field.place, field.default, helped, field.kind, field.choices)
                said = []
            elif commented:
                said.append(line.removeprefix("# "))
        elif line.startswith("# "):
            said.append(line.removeprefix("# "))
        else:
            said = []


def _field(section: str, key: str, text: str, model: type[BaseModel], *, stated: bool) -> FormField | None:
    """A field of the model, by what the file has behind its name; ``None`` if there is none."""
    inside = model_at(model, section.split("."))
    if inside is None or key not in inside.model_fields:
        return None
    try:
        value = tomllib.loads(f"x = {text}")["x"]
    except tomllib.TOMLDecodeError:
        return None
    annotation = inside.model_fields[key].annotation
    choices = tuple(map(str, _literals(annotation)))
    if choices and re.search(r"\bbool\b", str(annotation)):
        choices += ("true", "false")
    kind: Kind = "switch" if isinstance(value, bool) else "text"
    if isinstance(value, list) or re.search(r"(list|tuple)\[", str(annotation)):
        kind = "list"
    elif choices and not isinstance(value, bool) and not re.search(r"\b(int|float|str)\b", str(annotation)):
        kind = "choice"
    return FormField(f"{section}.{key}", _typed(value) if stated else "", "", kind, choices)


def _literals(annotation: Any) -> Iterator[object]:
    if get_origin(annotation) is Literal:
        yield from get_args(annotation)
    else:
        for part in get_args(annotation):
            yield from _literals(part)


def _typed(value: object) -> str:
    """A value as a person types it."""
    if isinstance(value, list):
        return ", ".join(map(_typed, value))
    return {True: "true", False: "false"}[value] if isinstance(value, bool) else str(value)


def settings_text(sections: list[FormSection], given: Mapping[str, str]) -> str:
    """Return what differs from the defaults as TOML."""
    lines: list[str] = []
    for section in sections:
        changed = [
            (one, given[one.place].strip())
            for one in section.fields
            if one.place in given and given[one.place].strip() != one.default
        ]
        if changed:
            lines += ["", f"[{section.name}]"]
            lines += [f"{one.place.rpartition('.')[2]} = {_literal(one, text)}" for one, text in changed]
    return "\n".join(lines[1:]) + "\n" if lines else ""


def _literal(field: FormField, text: str) -> str:
    if field.kind == "list" and text not in field.choices:
        return f"[{', '.join(_scalar(one.strip()) for one in text.strip('[]').split(',') if one.strip())}]"
    return text if field.kind != "text" and text in ("true", "false") else _scalar(text)


def _scalar(text: str) -> str:
    """A number as it is, anything else as a text."""
    try:
        float(text)
    except ValueError:
        quoted = text.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{quoted}"'
    return text


def checked(name: str, file: Path) -> tuple[Any, dict[str, str]]:
    """Return the settings of a file, or what is wrong by the places of its settings; "" is none of them."""
    try:
        return load(kind_of(name).kind, file), {}
    except SettingsError as error:
        said = str(error).removeprefix(f"{file}: ")
        parts = _MISTAKE.split(said)
        found = {place: text.strip("; ") for place, text in zip(parts[1::2], parts[2::2], strict=True)}
        return None, found or {"": said}
