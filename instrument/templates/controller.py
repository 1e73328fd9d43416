"""A controller that a template describes: it is asked, told and waited for; what can be repeated is repeated."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TypeVar

import pyvisa

from instrument.errors import InstrumentError, LinkError, SettingError, TransferError, WrongInstrument
from instrument.templates.description import ControllerTemplate, Quantity, compiled
from instrument.templates.lines import Lines

T = TypeVar("T")

_POLL_S = (0.1, 10.0)
"""Shortest and longest time in s between two looks whether a quantity is steady."""

_BEYOND = 1.5
"""Longest time for a change over the shortest that the template states."""
_GRACE_S = 5.0
_AGAIN_S = 0.5


class Controller:
    """A rate table, chamber or power supply on a link; a context manager, which leaves it as it is.

    Every question and every order is tried as often as the template says. An order names the value that is wanted,
    never a step from where it is: so it can be given again.
    """

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
        self._lines = Lines(resource_name, template.link, resource_manager)
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

    def _quantity(self, name: str) -> Quantity:
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

    def _number(self, quantity: Quantity) -> float:
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
        until = time.monotonic() + self.template.link.reconnect_s
        while True:
            try:
                self._lines.open()
            except LinkError:
                if time.monotonic() > until:
                    raise
                time.sleep(_AGAIN_S)
            else:
                self._tell(f"the link to {self.name} is there again")
                return

    def _steady(self, name: str, quantity: Quantity, value: float, before: float) -> float:
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
