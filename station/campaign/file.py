"""A campaign file becomes the plan of a unit's test, every mistake told at once; its settings and schema."""

from __future__ import annotations

import copy
import difflib
import hashlib
import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, Field, ValidationError, WithJsonSchema, model_validator

from instrument.controllers import ControllerTemplate
from station.campaign.bench import CONTROLLER_OF, controllers_of
from station.campaign.journal import CampaignPlan, InstrumentCard, PlannedStep, ReferenceUnit
from station.errors import SettingsError
from station.measurements import MEASUREMENTS, Measurement, measurement
from station.results.verdict import RESULT, Limit
from station.settings import (
    Finite,
    NotNegative,
    OutputSettings,
    Positive,
    SettingsSection,
    line_of,
    merged,
    mistakes,
    model_at,
    read_toml,
    shipped_settings,
)

_OURS = ("limits", "output")  # sections of a measurement's settings that the campaign has in its own way

_END_OF_INTERVAL = re.compile(r"_(u|u95|low_95|high_95)(_|$)")
"""In the name of a number that has no uncertainty of its own."""

_INSTEAD = {"limits": "limits of a step stand in [[step.limit]]", "output": "runs go into the test's own folder"}


@dataclass
class _FileReading:
    """A file that is being read, and what is wrong with it so far."""

    path: Path
    wrong: list[str] = field(default_factory=list)

    def tell(self, place: Sequence[str], text: str) -> None:
        line = line_of(self.path, place)
        self.wrong.append(f"{'.'.join(place)}{f' (line {line})' if line else ''}: {text}")


def read_campaign(path: Path, unit: str) -> CampaignPlan:
    """Read a campaign file for one unit."""
    given = read_toml(path)
    reading = _FileReading(path)
    try:
        campaign = CampaignFile.model_validate(given)
    except ValidationError as error:
        reading.wrong.append(mistakes(path, error, CampaignFile).removeprefix(f"{path}: "))
        rest = _without(given, error)
        if rest is None:
            raise SettingsError(f"{path}: {reading.wrong[0]}") from None
        campaign = rest  # the mistakes of the steps' settings are told as well
    kinds = {step.measurement: measurement(step.measurement) for step in campaign.step}
    _check_shared(reading, campaign, kinds)
    steps = tuple(_steps(reading, campaign, kinds, unit))
    if reading.wrong:
        raise SettingsError(f"{path}: {'; '.join(reading.wrong)}")
    about, reference = campaign.campaign, campaign.reference
    return CampaignPlan(
        **about.model_dump(exclude={"guard_band", "doubtful", "picture"}),
        file=path,
        file_sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
        settings=campaign.model_dump(mode="json"),
        unit=unit,
        directory=Path(campaign.output.directory),
        simulated=all(
            kind.simulated(kind.kind.model.model_validate(dict(step.settings)))
            for step, kind in ((step, kinds[step.measurement]) for step in steps)
        ),
        steps=steps,
        instruments=tuple(InstrumentCard(**dict(one)) for one in campaign.instrument),
        reference=None if reference is None else ReferenceUnit(reference.unit, reference.every_h),
    )


def _without(given: Mapping[str, Any], error: ValidationError) -> CampaignFile | None:
    """Return what is left of a file without its mistakes; ``None`` if that is no campaign."""
    left = copy.deepcopy(dict(given))
    for mistake in error.errors(include_url=False, include_context=False, include_input=False):
        inner: Any = left
        for name in mistake["loc"][:-1]:
            listed = isinstance(inner, list) and isinstance(name, int) and name < len(inner)
            inner = inner[name] if listed else inner.get(name) if isinstance(inner, dict) else None
        if isinstance(inner, dict) and mistake["loc"]:
            inner.pop(mistake["loc"][-1], None)
    try:
        return CampaignFile.model_validate(left)
    except ValidationError:
        return None


def _check_shared(
    reading: _FileReading, campaign: CampaignFile, kinds: Mapping[str, Measurement[Any, Any]]
) -> None:
    """Names under [bench] and [unit] have to be known to at least one of the measurements."""
    models = [kind.kind.model for kind in kinds.values()]
    places = [(("bench",), campaign.bench), *((("unit", name), one) for name, one in campaign.unit.items())]
    for above, sections in places:
        for section in sections:
            if section in _OURS:
                reading.tell((*above, section), _INSTEAD[section])
        for place in _unknown(sections, models):
            if place[0] not in _OURS:
                reading.tell((*above, *place), f"no such setting{_meant(place, models)}")
    names = [step.name for step in campaign.step]
    for number, name in enumerate(names):
        if name in names[:number]:
            reading.tell(("step", str(number), "name"), f"{name!r} is the name of another step already")
        asked = campaign.step[number].only_if
        if asked is not None and asked.step not in names[:number]:
            before = f"there are {', '.join(names[:number])}" if number else "it is the first"
            reading.tell(("step", str(number), "only_if", "step"), f"no step before is {asked.step!r}: {before}")


def _unknown(
    values: Mapping[str, Any], models: Sequence[type[BaseModel]], above: tuple[str, ...] = ()
) -> Iterator[tuple[str, ...]]:
    """Places that none of the models knows."""
    for name, value in values.items():
        knowing = [model for model in models if name in model.model_fields]
        if not knowing:
            yield (*above, name)
        elif isinstance(value, Mapping):
            inner = [found for model in knowing if (found := model_at(model, [name])) is not None]
            if inner:
                yield from _unknown(value, inner, (*above, name))


def _meant(place: Sequence[str], models: Sequence[type[BaseModel]]) -> str:
    inner = [found for model in models if (found := model_at(model, place[:-1])) is not None]
    known = sorted({name for model in inner for name in model.model_fields})
    like = difflib.get_close_matches(place[-1], known, 1)
    return f"; did you mean {like[0]}?" if like else ""


def _known(values: Mapping[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    """What of values that several measurements share one of them knows."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        if name in model.model_fields:
            inner = model_at(model, [name])
            found[name] = _known(value, inner) if inner is not None and isinstance(value, Mapping) else value
    return found


def _steps(
    reading: _FileReading, campaign: CampaignFile, kinds: Mapping[str, Measurement[Any, Any]], unit: str
) -> Iterator[PlannedStep]:
    before: dict[str, Mapping[str, str]] = {}
    for place, step in enumerate(campaign.step):
        kind = kinds[step.measurement]
        shared = merged(campaign.bench, campaign.unit.get(unit, {}))
        settings = _settings(reading, place, step, kind, shared, unit)
        declared = kind.quantities_in({} if settings is None else settings.model_dump())
        gives = {one.limit_name: one.text_of_unit for group in declared for one in group.quantities if one.limit}
        limits = tuple(_limits(reading, place, step, gives, campaign, before))
        repeats = [
            f", {repeat} of {step.repeat}" if step.repeat > 1 else "" for repeat in range(1, step.repeat + 1)
        ]
        before |= {f"{step.name}{repeat}": gives for repeat in repeats}
        if settings is None:
            continue
        controllers = controllers_of(settings.model_dump())
        for name in step.conditions.model_dump(exclude_none=True):
            controller, _ = CONTROLLER_OF[name]
            if controller not in controllers.there:
                text = f"there is no [bench.controllers.{controller}] to bring it about"
                reading.tell(("step", str(place), "conditions", name), text)
        for repeat, told in enumerate(repeats, start=1):
            values = settings.model_dump(mode="json")
            simulation = values.get("simulation")
            if isinstance(simulation, dict) and isinstance(simulation.get("seed"), int):
                # noise of its own for every unit, step and repeat, the same at each time
                own = zlib.crc32(f"{unit}/{place}/{repeat}".encode())
                simulation["seed"] = (simulation["seed"] + own) % 2**31
            yield PlannedStep(
                key=f"{place + 1:02d} {step.name}{told}",
                name=step.name,
                number=place + 1,
                measurement=step.measurement,
                repeat=repeat,
                of_repeats=step.repeat,
                settings=values,
                conditions=step.conditions.model_dump(exclude_none=True),
                warm_up_s=step.warm_up_s if repeat == 1 else 0.0,
                settle_s=step.settle_s if repeat == 1 else 0.0,
                limits=limits,
                doubtful=campaign.campaign.doubtful,
                only_if=None if step.only_if is None else step.only_if.model_dump(mode="json"),
            )


def _settings(
    reading: _FileReading,
    place: int,
    step: StepSection,
    kind: Measurement[Any, Any],
    shared: Mapping[str, Any],
    unit: str,
) -> BaseModel | None:
    """Settings of one step: shipped defaults, [bench], [unit], then its own; ``None`` if they hold mistakes."""
    model = kind.kind.model
    given = merged(_known(shared, model), step.settings)
    values = merged(read_toml(shipped_settings(kind.kind.shipped(given))), given)
    for section in _OURS:
        if section in step.settings:
            reading.tell(("step", str(place), "settings", section), _INSTEAD[section])
            values.pop(section)
    values["limits"] = {}
    kind.kind.adapt(values)
    try:
        found = model.model_validate(values)
    except ValidationError as error:
        for mistake in error.errors(include_url=False, include_context=False):
            loc = [str(part) for part in mistake["loc"] if part not in ("value", "auto")]
            if mistake["type"] == "extra_forbidden":
                text = f"no such setting{_meant(loc, [model])}"
            else:
                text = f"{mistake['msg'][0].lower()}{mistake['msg'][1:]}, not {mistake['input']!r:.80}"
            places = (["step", str(place), "settings", *loc], ["unit", unit, *loc], ["bench", *loc])
            written = read_toml(reading.path)
            where = next((one for one in places if _is_written(written, one)), places[0])
            if f"{'.'.join(where)}" not in {one.split(" (line")[0].split(":")[0] for one in reading.wrong}:
                reading.tell(where, text if where is places[0] else f"{text} (for step {step.name!r})")
        return None
    try:
        checked: BaseModel = kind.kind.check(found, reading.path)
    except SettingsError as error:
        reading.wrong.append(f"step {step.name!r}: {str(error).removeprefix(f'{reading.path}: ')}")
        return None
    return checked


def _is_written(values: Any, place: Sequence[str]) -> bool:
    for name in place:
        try:
            values = values[int(name)] if isinstance(values, list) else values[name]
        except (KeyError, IndexError, TypeError, ValueError):
            return False
    return True


def _limits(
    reading: _FileReading,
    place: int,
    step: StepSection,
    gives: Mapping[str, str],
    campaign: CampaignFile,
    before: Mapping[str, Mapping[str, str]],
) -> Iterator[Limit]:
    for number, one in enumerate(step.limit):
        above = ("step", str(place), "limit", str(number))
        where = (*above, "number")
        if not (one.number.startswith(RESULT) and not (one.less or one.over)) and one.number not in gives:
            text = _no_such_number(one.number, step.name, gives)
            reading.tell(where, f"{text} (any other number of its JSON: {RESULT}NAME)")
        of: dict[str, str] = {}
        for name in ("less", "over"):
            if text := getattr(one, name):
                named, _, other = text.rpartition(": ") if text not in before else (text, "", one.number)
                of[name] = f"{named}: {other}" if named else other
                if named and named not in before:
                    known = f"there are {', '.join(before)}" if before else "this is the first"
                    reading.tell((*above, name), f"no step before is {named!r}: {known}")
                elif other not in (its := before.get(named, gives)):
                    reading.tell((*above, name), _no_such_number(other, named or step.name, its))
                elif name == "less" and its[other] != gives.get(one.number, its[other]):
                    text = f"is in {its[other] or 'no unit'}, and {one.number} in {gives[one.number] or 'no unit'}"
                    reading.tell((*above, name), f"{text}: only over goes")
        rule = one.guard_band or campaign.campaign.guard_band
        limit = Limit(one.number, one.at_least, one.at_most, rule, one.highest_risk_percent / 100, **of)
        if limit.rule != "none" and _END_OF_INTERVAL.search(limit.number):
            text = f'is an uncertainty or an end of an interval itself: use guard_band = "none", not {limit.rule}'
            reading.tell(where, text)
        yield limit


def _no_such_number(number: str, step: str, gives: Mapping[str, str]) -> str:
    like = difflib.get_close_matches(number, gives, 1)
    hint = f"did you mean {like[0]}?" if like else f"it gives {', '.join(gives)}"
    return f"{number!r} is no number that the step {step!r} gives: {hint}"


# --------------------
# What may stand in a campaign file: every name, its unit and what it may hold


Text = Annotated[str, Field(min_length=1, max_length=200)]
GuardBand = Literal["none", "U95", "simple"]
Sections = dict[str, dict[str, Any]]
"""Settings of measurements by section and name, as they stand in a settings file."""


def _is_measurement(name: str) -> str:
    if name not in MEASUREMENTS:
        like = difflib.get_close_matches(name, MEASUREMENTS, 1)
        hint = f"did you mean {like[0]}?" if like else f"there are {', '.join(MEASUREMENTS)}"
        raise ValueError(f"no such measurement; {hint}")
    return name


MeasurementName = Annotated[
    str, AfterValidator(_is_measurement), WithJsonSchema({"type": "string", "enum": list(MEASUREMENTS)})
]


class CampaignSection(SettingsSection):
    """The campaign as a whole."""

    name: Text
    unit_type: Text
    station: Text
    guard_band: GuardBand = "U95"
    doubtful: Literal["marginal", "as_it_is"] = "marginal"
    attempts: Annotated[int, Field(ge=1, le=100)] = 3
    retry_after_s: NotNegative = 10.0
    reports: bool = True
    switch_off_afterwards: bool = False
    stop_after_failure: bool = False
    on_record: str = ""
    ask_for_unit: bool = False
    picture: str = ""  # for who is asked in the panel


class ReferenceSection(SettingsSection):
    """The unit that is measured regularly to see whether the bench is in control."""

    unit: Text
    every_h: Positive = 24.0


class InstrumentSection(SettingsSection):
    """An instrument of the bench, as its papers say."""

    role: Text
    model: str = ""
    serial: str = ""
    calibrated_on: date | None = None
    calibration_due: date | None = None

    @model_validator(mode="after")
    def _due_after_calibration(self) -> Self:
        if self.calibrated_on and self.calibration_due and self.calibration_due <= self.calibrated_on:
            raise ValueError("calibration_due must lie after calibrated_on")
        return self


class LimitSection(SettingsSection):
    """What a number of a result has to keep to."""

    number: Text
    at_least: Finite | None = None
    at_most: Finite | None = None
    guard_band: GuardBand | None = None
    highest_risk_percent: Annotated[float, Field(gt=0, le=50)] = 50.0
    # another number: of this step, ``"NUMBER"``, of a step before, ``"STEP: NUMBER"``, or the same one, ``"STEP"``
    less: Text | None = None
    over: Text | None = None

    @model_validator(mode="after")
    def _has_an_end(self) -> Self:
        if self.at_least is None and self.at_most is None:
            raise ValueError("a limit needs at_least, at_most or both")
        if self.at_least is not None and self.at_most is not None and self.at_least >= self.at_most:
            raise ValueError("at_least must lie below at_most")
        if self.less and self.over:
            raise ValueError("a limit is on a difference (less) or on a ratio (over), not on both")
        return self


class OnlyIfSection(SettingsSection):
    """How a step before must have ended for this one to be taken."""

    step: Text
    verdict: Annotated[tuple[Literal["PASS", "MARGINAL", "FAIL", "ERROR"], ...], Field(min_length=1)]
    instead: bool = False  # whether this one's verdict then counts in the place of that one's


class ConditionsSection(SettingsSection):
    """What chamber and power supply are set to."""

    temperature_degc: Annotated[float, Field(gt=-273.15, le=1000)] | None = None
    voltage_v: Annotated[float, Field(ge=-1000, le=1000)] | None = None


class StepSection(SettingsSection):
    """One measurement, with its repeats and limits."""

    name: Text
    measurement: MeasurementName
    repeat: Annotated[int, Field(ge=1, le=10_000)] = 1
    warm_up_s: NotNegative = 0.0
    settle_s: NotNegative = 0.0
    conditions: ConditionsSection = ConditionsSection()
    only_if: OnlyIfSection | None = None
    settings: Sections = Field(default={})
    limit: tuple[LimitSection, ...] = ()


class CampaignFile(SettingsSection):
    """A campaign file."""

    campaign: CampaignSection
    output: OutputSettings = OutputSettings(directory="tests")
    reference: ReferenceSection | None = None
    instrument: tuple[InstrumentSection, ...] = ()
    bench: Sections = Field(default={})
    unit: dict[str, Sections] = Field(default={})
    step: Annotated[tuple[StepSection, ...], Field(min_length=1)]


# --------------------
# JSON Schemas of the files that a person writes, for the completion and the checks of an editor


_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def settings_schema(name: str) -> dict[str, Any]:
    """Return the schema of a measurement's settings file; nothing is required, since a file holds what differs."""
    return {"$schema": _DIALECT, **_partial(measurement(name).kind.model.model_json_schema())}


def template_schema() -> dict[str, Any]:
    """Return the schema of a controller's template."""
    return {"$schema": _DIALECT, **ControllerTemplate.model_json_schema()}


def campaign_schema() -> dict[str, Any]:
    """Return the schema of a campaign file: the settings of each step are those of its measurement."""
    schema = CampaignFile.model_json_schema()
    definitions = schema["$defs"]
    cases = []
    for name in MEASUREMENTS:
        of_settings = _partial(
            measurement(name).kind.model.model_json_schema(ref_template=f"#/$defs/{name}.{{model}}")
        )
        for inner, found in of_settings.pop("$defs", {}).items():
            definitions[f"{name}.{inner}"] = found
        for ours in ("limits", "output"):
            of_settings["properties"].pop(ours, None)
        definitions[f"{name}.settings"] = of_settings
        cases.append(
            {
                "if": {"properties": {"measurement": {"const": name}}, "required": ["measurement"]},
                "then": {"properties": {"settings": {"$ref": f"#/$defs/{name}.settings"}}},
            }
        )
    definitions["StepSection"]["allOf"] = cases
    return {"$schema": _DIALECT, **schema}


def _partial(schema: Any) -> Any:
    """The same without anything that is required: what is absent stands in the shipped file."""
    if isinstance(schema, dict):
        return {name: _partial(value) for name, value in schema.items() if name != "required"}
    return [_partial(one) for one in schema] if isinstance(schema, list) else schema
