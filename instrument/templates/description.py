"""What a template says: the commands of a controller, its units and its limits.

A template is a table of values as it stands in a TOML file; ``docs/rate_table.md`` explains every name.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from instrument.errors import SettingError

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Lines = tuple[Annotated[str, Field(min_length=1)], ...]

KINDS = ("rate table", "chamber", "power supply")
_NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"


class TemplateSection(BaseModel):
    """A section of a template: an unknown name is a mistake."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class LinkSection(TemplateSection):
    """How lines travel."""

    baud_rate: Annotated[int, Field(ge=50, le=4_000_000)] = 9600
    data_bits: Literal[7, 8] = 8
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: Literal[1, 2] = 1
    line_end: Annotated[str, Field(min_length=1)] = "\n"
    answer_end: Annotated[str, Field(min_length=1)] = "\n"
    answer_s: Positive = 2.0
    pause_s: NotNegative = 0.0
    attempts: Annotated[int, Field(ge=1, le=100)] = 3
    reconnect_s: NotNegative = 30.0


class QuestionSection(TemplateSection):
    """A question, and what of its answer is meant: the first group of a regular expression."""

    ask: Annotated[str, Field(min_length=1)]
    answer: str = "(.+)"

    @field_validator("answer")
    @classmethod
    def _has_a_group(cls, text: str) -> str:
        if _compiled(text).groups < 1:
            raise ValueError("needs a group in round brackets round what is meant")
        return text


class AnswersSection(TemplateSection):
    """What the controller answers to an order, where it answers at all."""

    understood: str = ""
    refused: str = ""

    @field_validator("understood", "refused")
    @classmethod
    def _is_an_expression(cls, text: str) -> str:
        _compiled(text)
        return text


class ErrorsSection(QuestionSection):
    """How the controller is asked for errors, and what it answers when there is none."""

    none: Annotated[str, Field(min_length=1)] = r"[+]?0\b.*"


class ActionsSection(TemplateSection):
    """Orders without a value."""

    on: Lines = ()
    off: Lines = ()
    home: Lines = ()
    stop: Lines = ()


class Quantity(TemplateSection):
    """Something that is set, read, or both; the names in the file end in the unit."""

    unit: ClassVar[str] = ""

    set: Lines = ()
    ask: str = ""
    answer: str = _NUMBER
    per_unit: Finite = 1.0
    offset: Finite = 0.0
    lowest: Finite = -math.inf
    highest: Finite = math.inf
    steady_within: NotNegative = 0.0
    steady_for_s: NotNegative = 0.0
    change_per_s: Positive = math.inf

    @field_validator("set")
    @classmethod
    def _has_a_place_for_the_value(cls, lines: tuple[str, ...]) -> tuple[str, ...]:
        try:
            texts = [line.format(value=1.0) for line in lines]
        except (KeyError, IndexError, ValueError) as error:
            raise ValueError(f"write {{value:.6f}} where the number stands ({error})") from None
        if lines and all(text == line for text, line in zip(texts, lines, strict=True)):
            raise ValueError("no line has a place for the number: write {value:.6f} there")
        return lines

    @field_validator("answer")
    @classmethod
    def _has_a_group(cls, text: str) -> str:
        if _compiled(text).groups < 1:
            raise ValueError("needs a group in round brackets round the number")
        return text

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if not self.set and not self.ask:
            raise ValueError("needs set, ask or both")
        if not self.per_unit:
            raise ValueError("the controller's units for one of ours cannot be 0")
        if not self.lowest < self.highest:
            raise ValueError("the lowest value must lie below the highest")
        if self.steady_within and not self.ask:
            raise ValueError("without ask nothing tells when the value is steady")
        return self


def _with_unit(unit: str) -> ConfigDict:
    names = {
        "per_unit": f"per_{unit}",
        "offset": f"offset_{unit}",
        "lowest": f"lowest_{unit}",
        "highest": f"highest_{unit}",
        "steady_within": f"steady_within_{unit}",
        "change_per_s": f"change_{unit}_per_s",
    }
    return ConfigDict(extra="forbid", frozen=True, alias_generator=lambda name: names.get(name, name))


class Rate(Quantity):
    """Rate of a table, deg/s, positive anticlockwise seen from above."""

    unit: ClassVar[str] = "dps"
    model_config = _with_unit("dps")


class Position(Quantity):
    """Angle of a table, deg."""

    unit: ClassVar[str] = "deg"
    model_config = _with_unit("deg")


class Temperature(Quantity):
    """Temperature of a chamber, deg C."""

    unit: ClassVar[str] = "degc"
    model_config = _with_unit("degc")


class Humidity(Quantity):
    """Relative humidity of a chamber, percent."""

    unit: ClassVar[str] = "percent"
    model_config = _with_unit("percent")


class Voltage(Quantity):
    """Voltage of a supply, V."""

    unit: ClassVar[str] = "v"
    model_config = _with_unit("v")


class Current(Quantity):
    """Current of a supply, A."""

    unit: ClassVar[str] = "a"
    model_config = _with_unit("a")


class ControllerTemplate(TemplateSection):
    """The commands of a controller."""

    kind: Literal["rate table", "chamber", "power supply"]
    name: Annotated[str, Field(min_length=1)]
    link: LinkSection = LinkSection()
    identity: QuestionSection | None = None
    answers: AnswersSection = AnswersSection()
    errors: ErrorsSection | None = None
    actions: ActionsSection = ActionsSection()
    rate: Rate | None = None
    position: Position | None = None
    temperature: Temperature | None = None
    humidity: Humidity | None = None
    voltage: Voltage | None = None
    current: Current | None = None

    @model_validator(mode="after")
    def _can_do_its_work(self) -> Self:
        needed = {"rate table": self.rate, "chamber": self.temperature, "power supply": self.voltage}[self.kind]
        name = {"rate table": "rate", "chamber": "temperature", "power supply": "voltage"}[self.kind]
        if needed is None:
            raise ValueError(f"the template of a {self.kind} needs a section [{name}]")
        if self.kind == "rate table" and not needed.set:
            raise ValueError("rate.set: a rate table must take a rate")
        return self

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Everything that it sets or reads, by name."""
        names = ("rate", "position", "temperature", "humidity", "voltage", "current")
        return {name: found for name in names if (found := getattr(self, name)) is not None}

    @property
    def stops_by(self) -> Lines:
        """Lines that stop a table."""
        return self.actions.stop or (self.rate.set if self.rate is not None else ())


def parse_template(values: Mapping[str, Any], where: str) -> ControllerTemplate:
    """Read a template.

    Parameters
    ----------
    values : mapping
        As they stand in its TOML file.
    where : str
        Its file, for the text of an error.

    Raises
    ------
    SettingError
        Every mistake of it in one text.
    """
    try:
        return ControllerTemplate.model_validate(dict(values))
    except ValidationError as error:
        found = error.errors(include_url=False, include_context=False)
        said = (f"{'.'.join(map(str, one['loc'])) or 'template'}: {one['msg']}" for one in found)
        raise SettingError(f"{where}: {'; '.join(said)}") from None


def compiled(text: str) -> re.Pattern[str]:
    """Return the regular expression of a template, which was checked when it was read."""
    return re.compile(text)


def _compiled(text: str) -> re.Pattern[str]:
    try:
        return re.compile(text)
    except re.error as error:
        raise ValueError(f"is no regular expression: {error}") from None
