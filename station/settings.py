"""Settings of any measurement: commented TOML files, checked as a whole before anything moves.

The defaults stand in the files of ``config/`` and nowhere else. A user's file holds only what differs from one.
"""

import difflib
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar, cast, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from instrument.errors import FileFormatError
from instrument.text_files import read_small_file
from station.errors import RunError, SettingsError, UsageError

# --------------------
# TOML files: read, laid over each other, and their mistakes put into words with line and suggestion


_LARGEST_FILE = 1_000_000  # bytes; ours have some kB
_DEEPEST = 8  # levels; ours have three
_TOLD = 20  # mistakes that are told one by one
_LONGEST_VALUE = 80  # letters of a wrong value that are told
_HEADER = re.compile(r"\s*\[\[?\s*([^\]]+?)\s*\]\]?")
_NAME = re.compile(r"\"[^\"]*\"|'[^']*'|[^.]+")
_KEY = re.compile(r"\s*([A-Za-z0-9_.\-\"' ]+?)\s*=")


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file."""
    try:
        found = tomllib.loads(read_text(path))
    except (ValueError, ArithmeticError) as error:  # also for a number of too many digits
        raise SettingsError(f"{path}: is not valid TOML: {error}") from None
    except RecursionError:
        raise SettingsError(f"{path}: is nested too deeply for a settings file") from None
    if _deeper(found, _DEEPEST):
        raise SettingsError(f"{path}: is nested too deeply for a settings file")
    return found


def read_text(path: Path) -> str:
    """Read a file of settings, or one that they name; SettingsError if it cannot be, or is none."""
    try:
        return read_small_file(path, _LARGEST_FILE).decode("utf-8-sig")
    except FileFormatError as error:
        raise SettingsError(str(error)) from None
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise SettingsError(f"{path}: is not a text file (byte {error.start} is not UTF-8)") from None


def _deeper(value: object, levels: int) -> bool:
    """Whether tables or lists lie in each other more than so many levels."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return any(levels == 0 or _deeper(one, levels - 1) for one in inner if isinstance(one, dict | list))


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Lay one tree of values over another; neither is changed."""
    both: dict[str, Any] = {
        key: merged(value, {}) if isinstance(value, dict) else value for key, value in below.items()
    }
    for key, value in above.items():
        if isinstance(value, dict) and isinstance(both.get(key), dict):
            both[key] = merged(both[key], value)
        else:
            both[key] = value
    return both


def mistakes(path: Path, error: ValidationError, model: type[BaseModel]) -> str:
    """Put every mistake of a file into one sentence: file, place, what is wrong, what was perhaps meant."""
    found = []
    every = error.errors(include_url=False, include_context=False)
    for mistake in every[:_TOLD]:
        place = [str(part) for part in mistake["loc"]]
        unknown = mistake["type"] == "extra_forbidden"
        text = f"no such setting{_meant(place, model)}" if unknown else _told(mistake)
        line = line_of(path, place)
        found.append(f"{'.'.join(place)}{f' (line {line})' if line else ''}: {text}")
    if len(every) > _TOLD:
        found.append(f"and {len(every) - _TOLD} more")
    return f"{path}: " + "; ".join(found)


def _told(mistake: Mapping[str, Any]) -> str:
    said = mistake["msg"].partition(" after validation")[0]
    return f"{said[0].lower()}{said[1:]}, not {_shown(mistake['input'])}"


def _shown(value: object) -> str:
    """A value as it is told, shortened; a number of thousands of digits cannot be written at all."""
    try:
        text = repr(value)
    except ValueError:
        return f"a {type(value).__name__} that is too long to show"
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}..."


def _meant(place: Sequence[str], model: type[BaseModel]) -> str:
    """Suggest a name like the one that is not known; of limits all, for there are few."""
    section = model_at(model, place[:-1])
    if section is None:
        return ""
    known = list(section.model_fields)
    if like := difflib.get_close_matches(place[-1], known, 1):
        return f"; did you mean {like[0]}?"
    return f"; there are {', '.join(known)}" if place[0] == "limits" else ""


def model_at(model: type[BaseModel], place: Sequence[str]) -> type[BaseModel] | None:
    """Return the model of a section within another one's, through arrays of tables; ``None`` if there is none."""
    section: type[BaseModel] | None = model
    for name in place:
        if section is None:
            return None
        if not name.isdecimal():  # a number stands for one of an array of tables
            field = section.model_fields.get(name)
            section = _model_in(getattr(field, "annotation", None))
    return section


def _model_in(annotation: object) -> type[BaseModel] | None:
    """The model that an annotation names: itself, or that of which it is a tuple or an alternative to nothing."""
    if hasattr(annotation, "model_fields"):
        return cast("type[BaseModel]", annotation)
    inner = (_model_in(one) for one in get_args(annotation))
    return next((one for one in inner if one is not None), None)


def line_of(path: Path, place: Sequence[str]) -> int | None:
    """Find the line of a TOML file that a value stands in."""
    try:
        lines = read_text(path).splitlines()
    except SettingsError:
        return None
    section: list[str] = []
    counts: dict[tuple[str, ...], int] = {}
    found, depth = None, 0
    for number, line in enumerate(lines, start=1):
        if header := _HEADER.match(line):
            section = _numbered(_names(header[1]), counts, begins_another="[[" in line)
            here = section
        elif key := _KEY.match(line):
            here = section + _names(key[1])
        else:
            continue
        if len(here) > depth and list(place[: len(here)]) == here:
            found, depth = number, len(here)
    return found


def _numbered(names: Sequence[str], counts: dict[tuple[str, ...], int], *, begins_another: bool) -> list[str]:
    """Put numbers, from 0, behind the names of arrays of tables: ``[[step]]`` is step 0, then step 1."""
    place: list[str] = []
    for depth, name in enumerate(names, start=1):
        place.append(name)
        array = tuple(place)
        if begins_another and depth == len(names):
            counts[array] = counts.get(array, -1) + 1
        if array in counts:
            place.append(str(counts[array]))
    return place


def _names(dotted: str) -> list[str]:
    return [name.strip().strip("\"'") for name in _NAME.findall(dotted)]


# --------------------
# What settings files of every measurement share: sections that take no unknown name, and what values may be


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class SettingsSection(BaseModel):
    """A section of a settings file: an unknown name is a mistake, and nothing changes once it is read."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Limits(SettingsSection):
    """Limits; one that is absent is not tested. Names as in the JSON of a result."""


class SiteSettings(SettingsSection):
    """Where the bench stands."""

    latitude_deg: Annotated[float, Field(ge=-90, le=90)]
    mains_hz: Annotated[float, Field(ge=10, le=1000)] | None = None  # not stated: 50 or 60


class OutputSettings(SettingsSection):
    """Where results go."""

    directory: Annotated[str, Field(min_length=1)]


S = TypeVar("S", bound=SettingsSection)
Values = Mapping[str, Mapping[str, object]]  # settings by section and name, as the command line gives them
_FREE = ("limits", "output")  # sections that say nothing of what is measured


@dataclass(frozen=True)
class SettingsKind(Generic[S]):
    """How the settings of one kind of measurement are read."""

    sections: type[S]  # what may stand in a file, but for the names of its limits
    limits: Callable[[], Sequence[str]]  # names that [limits] may have: numbers that measurements declare
    # name of the shipped file that gives the defaults, for what the user has given
    shipped: Callable[[Mapping[str, Any]], str]
    # changes defaults that do not go with what the user has given; gets all values
    adapt: Callable[[dict[str, Any]], None]
    # checks what no single value shows, and completes the settings; gets them and the file's path. Raises
    # SettingsError.
    check: Callable[[S, Path], S]
    # shipped file that gives what a run of an earlier version was saved without; empty: the model's defaults
    later: str = ""
    # sections that single measurements have for themselves, by their names
    further: Callable[[], Mapping[str, type[SettingsSection]]] = dict
    # what is known of the bench, with which a saved run can be evaluated later: ``section.name``, ``section.*``
    # for each of its values, or ``section`` where its values belong together and are replaced together
    knowledge: tuple[str, ...] = ("limits.*",)

    @cached_property
    def model(self) -> type[S]:
        """What may stand in a file."""
        names: dict[str, Any] = dict.fromkeys(self.limits(), (Positive | None, None))
        limits = create_model(f"{self.sections.__name__}Limits", __base__=Limits, __doc__=Limits.__doc__, **names)
        fields: dict[str, Any] = {name: (section, ...) for name, section in self.further().items()}
        return create_model(
            self.sections.__name__,
            __base__=self.sections,
            __doc__=self.sections.__doc__,
            limits=(limits, limits()),
            **fields,
        )

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
    try:
        return kind.check(_validated(kind, values, path or shipped, overrides or {}), path or shipped)
    except SettingsError as error:
        if path is not None:
            raise
        raise SettingsError(str(error).removeprefix(f"{shipped}: ")) from None  # what is wrong was an option


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
    """Return the settings of a run that is gone on with, with what a file knows of the bench now."""
    # What is given must not change what is measured.
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


def _validated(kind: SettingsKind[S], values: Mapping[str, Any], path: Path, overrides: Values) -> S:
    try:
        return kind.model.model_validate(dict(values))
    except ValidationError as error:
        for mistake in error.errors():
            section, name, *_ = *map(str, mistake["loc"]), "", ""
            if name in (overrides.get(section) or {}) and mistake["type"] != "extra_forbidden":
                raise SettingsError(f"{section}.{name}: {_told(mistake)}") from None
        raise SettingsError(mistakes(path, error, kind.model)) from None


def _flat(values: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Walk through all values: dotted place, and value."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value
