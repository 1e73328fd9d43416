"""What a template says: the commands of a controller, its units and its limits.

A template is a table of values as it stands in a TOML file; ``docs/rate_table.md`` explains every name.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from instrument.errors import SettingError

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Lines = tuple[Annotated[str, Field(min_length=1)], ...]

KINDS = ("rate table", "chamber", "power supply")
_NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"


def compiled(text: str) -> re.Pattern[str]:
    """Return the regular expression of a template; ValueError if it is none."""
    try:
        return re.compile(text)
    except re.error as error:
        raise ValueError(f"is no regular expression: {error}") from None


def _expression(text: str) -> str:
    compiled(text)
    return text


def _with_a_group(text: str) -> str:
    if compiled(text).groups < 1:
        raise ValueError("needs a group in round brackets round what is meant")
    return text


Expression = Annotated[str, AfterValidator(_expression)]
"""Regular expression that a whole answer is to match."""

Meant = Annotated[str, AfterValidator(_with_a_group)]
"""Regular expression to be found in an answer, whose first group is what is meant."""


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
    answer: Meant = "(.+)"


class AnswersSection(TemplateSection):
    """What the controller answers to an order, where it answers at all."""

    understood: Expression = ""
    refused: Expression = ""


class ErrorsSection(QuestionSection):
    """How the controller is asked for errors, and what it answers when there is none."""

    none: Annotated[Expression, Field(min_length=1)] = r"[+]?0\b.*"


class ActionsSection(TemplateSection):
    """Orders without a value."""

    on: Lines = ()
    off: Lines = ()
    home: Lines = ()
    stop: Lines = ()


class InUnit:
    """Names in a file for the attributes of a quantity: those of numbers have its unit.

    Examples
    --------
    >>> InUnit("dps")("change_per_s"), InUnit("v")("highest"), InUnit("v")("ask")
    ('change_dps_per_s', 'highest_v', 'ask')
    """

    def __init__(self, unit: str) -> None:
        self.unit = unit

    def __call__(self, name: str) -> str:
        """Name of an attribute in the file."""
        if name in ("offset", "lowest", "highest", "steady_within"):
            return f"{name}_{self.unit}"
        return {"per_unit": f"per_{self.unit}", "change_per_s": f"change_{self.unit}_per_s"}.get(name, name)


class Quantity(TemplateSection):
    """Something that is set, read, or both; the names in the file end in the unit."""

    set: Lines = ()
    ask: str = ""
    answer: Meant = _NUMBER
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

    @property
    def unit(self) -> str:
        """Its unit, as names end in it."""
        names = self.model_config.get("alias_generator")
        return names.unit if isinstance(names, InUnit) else ""

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


class Rate(Quantity, alias_generator=InUnit("dps")):
    """Rate of a table, deg/s, positive anticlockwise seen from above."""


class Position(Quantity, alias_generator=InUnit("deg")):
    """Angle of a table, deg."""


class Temperature(Quantity, alias_generator=InUnit("degc")):
    """Temperature of a chamber, deg C."""


class Humidity(Quantity, alias_generator=InUnit("percent")):
    """Relative humidity of a chamber, percent."""


class Voltage(Quantity, alias_generator=InUnit("v")):
    """Voltage of a supply, V."""


class Current(Quantity, alias_generator=InUnit("a")):
    """Current of a supply, A."""


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
    """Read a template."""
    try:
        return ControllerTemplate.model_validate(dict(values))
    except ValidationError as error:
        found = error.errors(include_url=False, include_context=False)
        said = (f"{'.'.join(map(str, one['loc'])) or 'template'}: {one['msg']}" for one in found)
        raise SettingError(f"{where}: {'; '.join(said)}") from None
