"""Rate table, chamber or supply by a template: how it is described, asked, told, waited for; lines on a link."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Annotated, Any, Literal, Self, TypeVar

import pyvisa
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)
from pyvisa import constants
from pyvisa.constants import InterfaceType, StatusCode
from pyvisa.resources import MessageBasedResource, SerialInstrument

from instrument.claims import claim
from instrument.errors import InstrumentError, LinkError, SettingError, TransferError, WrongInstrument
from instrument.pyvisa_sessions import visa_manager

T = TypeVar("T")

_POLL_S = (0.1, 10.0)  # shortest and longest time in s between two looks whether a quantity is steady
_BEYOND = 1.5  # longest time for a change over the shortest that the template states
_GRACE_S = 5.0
_AGAIN_S = 0.5


class Controller:
    """A rate table, chamber or power supply on a link; a context manager, which leaves it as it is."""

    # Every question and every order is tried as often as the template says. An order names the value that is
    # wanted, never a step from where it is: so it can be given again.

    def __init__(
        self,
        resource_name: str,
        template: ControllerTemplate,
        *,
        resource_manager: pyvisa.ResourceManager | None = None,
        sleep: Callable[[float], None] = time.sleep,
        now: Callable[[], float] = time.monotonic,
        tell: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.template = template
        self._sleep, self._now, self._tell = sleep, now, tell
        self._last_set: dict[str, float] = {}
        self._lines = LineDialogue(resource_name, template.link, resource_manager)
        self.repeated = 0
        """Questions and orders that were given again."""
        try:
            self.identity = self._who()
        except BaseException:  # Ctrl-C, too
            self._lines.close()
            raise

    def __enter__(self) -> Controller:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def name(self) -> str:
        """Of the template, with the place where it is connected."""
        return f"{self.template.name} on {self._lines.name}"

    def close(self) -> None:
        """Close the link; the controller stays as it is."""
        self._lines.close()

    def read(self, name: str) -> float:
        """Return a quantity, in our unit."""
        quantity = self._quantity(name)
        if not quantity.ask:
            raise SettingError(f"{self.name}: its template does not say how the {name} is read")
        return self._persist(lambda: self._number(quantity))

    def readings(self) -> dict[str, float]:
        """Return everything that can be read, under names with their units: ``temperature_degc``."""
        there = self.template.quantities.items()
        return {f"{name}_{quantity.unit}": self.read(name) for name, quantity in there if quantity.ask}

    def set(self, name: str, value: float) -> float:
        """Bring a quantity to a value and return when it is steady there."""
        quantity = self._quantity(name)
        if not quantity.lowest <= value <= quantity.highest:
            raise SettingError(
                f"{self.name}: {name} {value:g} {quantity.unit} is beyond its limits, {quantity.lowest:g} to "
                f"{quantity.highest:g} {quantity.unit}"
            )
        before = self.read(name) if quantity.ask else self._last_set.get(name, 0.0)
        number = (value + quantity.offset) * quantity.per_unit
        self._order([line.format(value=number) for line in quantity.set])
        self._last_set[name] = value
        return self._steady(name, quantity, value, before)

    def do(self, action: str) -> None:
        """Give an order without a value: ``"on"``, ``"off"``, ``"home"``, ``"stop"``; nothing where there is none.

        Raises as :meth:`set`.
        """
        lines: Sequence[str] = getattr(self.template.actions, action)
        if lines:
            self._order(lines)

    def stop(self) -> None:
        """Stop a table, as fast as it does that. Raises as :meth:`set`."""
        self._last_set["rate"] = 0.0
        if self.template.actions.stop:
            self.do("stop")
        elif self.template.rate is not None:
            self._order([line.format(value=self.template.rate.offset) for line in self.template.rate.set])

    def errors(self) -> str:
        """Return what the controller reports; empty if there is nothing, or nothing to ask."""
        asked = self.template.errors
        if asked is None:
            return ""
        answer = self._persist(lambda: self._answer(asked.ask, asked.answer))
        return "" if compiled(asked.none).fullmatch(answer) else answer

    def _who(self) -> str:
        asked = self.template.identity
        if asked is None:
            return ""
        answer = self._persist(lambda: self._answer(asked.ask, "(.*)"))
        found = compiled(asked.answer).search(answer)
        if found is None:
            raise WrongInstrument(f"{self.name}: something else answers there: {answer!r:.80}")
        return str(found[1])

    def _quantity(self, name: str) -> ControlledQuantity:
        quantity = self.template.quantities.get(name)
        if quantity is None:
            raise SettingError(f"{self.name}: its template has no section [{name}]")
        return quantity

    def _order(self, lines: Sequence[str]) -> None:
        self._persist(lambda: self._tell_lines(lines))
        if said := self.errors():
            raise SettingError(f"{self.name} reports an error after {' '.join(lines)!r}: {said}")

    def _tell_lines(self, lines: Sequence[str]) -> None:
        answers = self.template.answers
        for line in lines:
            self._lines.send(line)
            if not answers.understood:
                continue
            answer = self._lines.read()
            if answers.refused and compiled(answers.refused).fullmatch(answer):
                raise SettingError(f"{self.name} refuses {line!r}: {answer}")
            if not compiled(answers.understood).fullmatch(answer):
                raise TransferError(f"{self.name} answered {answer!r:.60} to {line!r}")

    def _answer(self, question: str, expression: str) -> str:
        self._lines.send(question)
        answer = self._lines.read()
        found = compiled(expression).search(answer)
        if found is None:
            raise TransferError(f"{self.name} answered {answer!r:.60} to {question!r}")
        return str(found[1])

    def _number(self, quantity: ControlledQuantity) -> float:
        text = self._answer(quantity.ask, quantity.answer)
        with suppress(ValueError):
            if math.isfinite(number := float(text)):
                return number / quantity.per_unit - quantity.offset
        raise TransferError(f"{self.name} answered {text!r:.60} to {quantity.ask!r}, no number")

    def _persist(self, once: Callable[[], T]) -> T:
        """Do what can be done again as a whole, as often as the template says; open a lost link again."""
        for left in reversed(range(self.template.link.attempts)):
            try:
                return once()
            except (TransferError, LinkError) as error:
                if not left:
                    raise LinkError(f"{error}; tried {self.template.link.attempts} times") from None
                self.repeated += 1
                if isinstance(error, LinkError):
                    self._open_again(error)
                self._lines.drain()
        raise LinkError(f"{self.name} was not asked")

    def _open_again(self, lost: LinkError) -> None:
        self._tell(f"{lost}: trying again for {self.template.link.reconnect_s:g} s")
        until = self._now() + self.template.link.reconnect_s
        while True:
            try:
                self._lines.open()
            except LinkError:
                if self._now() > until:
                    raise
                self._sleep(_AGAIN_S)
            else:
                self._tell(f"the link to {self.name} is there again")
                return

    def _steady(self, name: str, quantity: ControlledQuantity, value: float, before: float) -> float:
        """Wait until a quantity has been steady for long enough."""
        shortest = abs(value - before) / quantity.change_per_s
        if not quantity.steady_within:
            self._sleep(shortest + quantity.steady_for_s)
            return self.read(name) if quantity.ask else value
        patience = _BEYOND * shortest + quantity.steady_for_s + _GRACE_S
        began, steady_since = self._now(), math.inf
        while True:
            now, found = self._now(), self.read(name)
            if abs(found - value) > quantity.steady_within:
                steady_since = math.inf
            elif math.isinf(steady_since):
                steady_since = now
            if now - steady_since >= quantity.steady_for_s:
                return found
            if now - began > patience:
                raise SettingError(
                    f"{self.name}: the {name} was to be {value:g} {quantity.unit} and reads {found:g} after "
                    f"{now - began:.0f} s; is the drive on, and free to move?"
                )
            self._sleep(min(max(quantity.steady_for_s / 10, _POLL_S[0]), _POLL_S[1]))


def stop_by_all_means(controller: Controller, tell: Callable[[str], None]) -> None:
    """Stop a table at the end of a program, whatever it takes; says so where it cannot be stopped."""
    try:
        controller.stop()
    except (InstrumentError, OSError) as error:
        tell(f"THE RATE TABLE MAY STILL TURN, stop it by hand: {error}")
    finally:
        with suppress(InstrumentError, OSError):
            controller.close()


# --------------------
# What a template says: the commands of a controller, its units and its limits.
#
# A template is a table of values as it stands in a TOML file; ``docs/rate_table.md`` explains every name


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


def _with_a_group(text: str) -> str:
    if compiled(text).groups < 1:
        raise ValueError("needs a group in round brackets round what is meant")
    return text


# regular expression that a whole answer is to match
Expression = Annotated[str, AfterValidator(lambda text: compiled(text).pattern)]

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
    """Names in a file for the attributes of a quantity: those of numbers have its unit."""

    def __init__(self, unit: str) -> None:
        self.unit = unit

    def __call__(self, name: str) -> str:
        """Name of an attribute in the file."""
        if name in ("offset", "lowest", "highest", "steady_within"):
            return f"{name}_{self.unit}"
        return {"per_unit": f"per_{self.unit}", "change_per_s": f"change_{self.unit}_per_s"}.get(name, name)


class ControlledQuantity(TemplateSection):
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


class Rate(ControlledQuantity, alias_generator=InUnit("dps")):
    """Rate of a table, deg/s, positive anticlockwise seen from above."""


class Position(ControlledQuantity, alias_generator=InUnit("deg")):
    """Angle of a table, deg."""


class Temperature(ControlledQuantity, alias_generator=InUnit("degc")):
    """Temperature of a chamber, deg C."""


class Humidity(ControlledQuantity, alias_generator=InUnit("percent")):
    """Relative humidity of a chamber, percent."""


class Voltage(ControlledQuantity, alias_generator=InUnit("v")):
    """Voltage of a supply, V."""


class Current(ControlledQuantity, alias_generator=InUnit("a")):
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
    def quantities(self) -> dict[str, ControlledQuantity]:
        """Everything that it sets or reads, by name."""
        names = ("rate", "position", "temperature", "humidity", "voltage", "current")
        return {name: found for name in names if (found := getattr(self, name)) is not None}


def parse_template(values: Mapping[str, Any], where: str) -> ControllerTemplate:
    """Read a template."""
    try:
        return ControllerTemplate.model_validate(dict(values))
    except ValidationError as error:
        found = error.errors(include_url=False, include_context=False)
        said = (f"{'.'.join(map(str, one['loc'])) or 'template'}: {one['msg']}" for one in found)
        raise SettingError(f"{where}: {'; '.join(said)}") from None


# --------------------
# Lines to and from a controller through PyVISA: GPIB, USB, RS-232 and TCP


_PARITY = {"none": constants.Parity.none, "even": constants.Parity.even, "odd": constants.Parity.odd}
_STOP = {1: constants.StopBits.one, 2: constants.StopBits.two}
_LATE_MS = 30  # longest silence between two bytes of an answer that comes too late
_LONGEST = 4096  # bytes of an answer


class LineDialogue:
    """A link that carries lines; a context manager."""

    def __init__(
        self, resource_name: str, link: LinkSection, resource_manager: pyvisa.ResourceManager | None = None
    ) -> None:
        self.name = resource_name
        self._link, self._manager = link, resource_manager
        self._resource: MessageBasedResource | None = None
        self._claim = claim(resource_name)
        try:
            self.open()
        except BaseException:
            self._claim.release()
            raise

    def __enter__(self) -> LineDialogue:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def open(self) -> None:
        """Open the link, or open it again; other programs are kept from it meanwhile."""
        self._hang_up()
        try:
            manager = self._manager or visa_manager()
            resource = manager.open_resource(self.name)
        except (pyvisa.Error, OSError, ValueError, AttributeError) as error:
            raise LinkError(
                f"{self.name} cannot be opened ({_why(error)}); is it switched on and connected?"
            ) from None
        if not isinstance(resource, MessageBasedResource):
            resource.close()
            raise LinkError(f"{self.name} takes no messages; see `gyrolock list`")
        self._resource = resource
        try:
            self._configure(resource)
        except (pyvisa.Error, OSError, ValueError) as error:
            self._hang_up()
            raise LinkError(f"{self.name} cannot be set up ({_why(error)})") from None

    def close(self) -> None:
        """Close the link; never raises."""
        self._hang_up()
        self._claim.release()

    def _hang_up(self) -> None:
        if self._resource is not None:
            with suppress(pyvisa.Error, OSError):
                self._resource.close()
            self._resource = None

    def send(self, line: str) -> None:
        """Send one line; its end is added here. LinkError if it cannot be sent."""
        try:
            self._opened.write_raw((line + self._link.line_end).encode("ascii"))
        except UnicodeEncodeError:
            raise TransferError(f"{line!r} cannot be sent to {self.name}: it is not ASCII") from None
        except (pyvisa.Error, OSError, ValueError) as error:
            raise LinkError(f"{self.name} takes no data ({_why(error)})") from None
        if self._link.pause_s:
            time.sleep(self._link.pause_s)

    def read(self) -> str:
        """Read one line, without its end."""
        end, found = self._link.answer_end.encode("ascii"), b""
        until = time.monotonic() + self._link.answer_s
        while not found.endswith(end):
            left = until - time.monotonic()
            if left <= 0 or len(found) > _LONGEST:
                raise TransferError(
                    f"{self.name} gave no whole answer within {self._link.answer_s:g} s: {found[:60]!r}"
                )
            found += self._some(max(1, int(1000 * left)))
        try:
            return found[: -len(end)].decode("ascii").strip()
        except UnicodeDecodeError:
            raise TransferError(f"{self.name} answered what is no text: {found[:60]!r}") from None

    def drain(self) -> None:
        """Throw away what comes late, so that the next answer is that of the next question."""
        with suppress(TransferError):
            while self._some(_LATE_MS):
                pass

    @property
    def _opened(self) -> MessageBasedResource:
        if self._resource is None:
            raise LinkError(f"{self.name} is not open")
        return self._resource

    def _some(self, patience_ms: int) -> bytes:
        """At least one byte, as many as are there up to the end of a line; none if the time is over."""
        resource = self._opened
        try:
            resource.timeout = patience_ms
            with resource.ignore_warning(StatusCode.success_max_count_read, StatusCode.success_device_not_present):
                return bytes(resource.visalib.read(resource.session, 1 if self._streamed else _LONGEST)[0])
        except pyvisa.VisaIOError as error:
            if error.error_code == StatusCode.error_timeout:
                return b""
            raise LinkError(f"the link to {self.name} is lost ({_why(error)})") from None
        except (pyvisa.Error, OSError, ValueError) as error:
            raise LinkError(f"the link to {self.name} is lost ({_why(error)})") from None

    @property
    def _streamed(self) -> bool:
        """Whether nothing but its end tells where an answer ends."""
        serial = self._opened.interface_type == InterfaceType.asrl
        return serial or self.name.upper().rstrip().endswith("SOCKET")

    def _configure(self, resource: MessageBasedResource) -> None:
        if isinstance(resource, SerialInstrument):
            resource.baud_rate = self._link.baud_rate
            resource.data_bits = self._link.data_bits
            resource.parity = _PARITY[self._link.parity]
            resource.stop_bits = _STOP[self._link.stop_bits]
        resource.read_termination = None
        if self._streamed:
            with suppress(pyvisa.Error, NotImplementedError):
                resource.set_visa_attribute(constants.ResourceAttribute.termchar_enabled, False)


def _why(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
