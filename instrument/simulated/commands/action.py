"""Commands and queries that are more than a stored setting."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from instrument.simulated.panel.event_table import Guess, Refusal
from instrument.simulated.panel.formats import Leaf
from instrument.simulated.panel.kinds import number
from instrument.simulated.panel.parsing import Argument
from instrument.simulated.state import ScopeState

Query = Callable[[ScopeState], list[Leaf]]
Order = Callable[[ScopeState, tuple[Argument, ...]], Iterator[bytes | None] | None]
Condition = Callable[[ScopeState], bool]


@dataclass(frozen=True)
class Action:
    """What a header does: `query` answers, `order` acts, and both wait while `waits` is true.

    An order that carries out a message of its own returns its steps, as `ScopeState.execute` gives them.
    """

    query: Query | None = None
    order: Order | None = None
    waits: Condition | None = None
    ends_message: bool = False  # *IDN? and ID?: a query after it is refused with event 440


def answer(header: str, value: Callable[[ScopeState], str]) -> Query:
    """A query with one value; `header` is spelled as in the manual, empty for `*` queries."""
    path = tuple(header.split(":")) if header else ()
    return lambda state: [(path, value(state))]


def no_argument(arguments: tuple[Argument, ...]) -> None:
    """Refuse any argument."""
    if arguments:
        raise Refusal(Guess.SURPLUS_ARGUMENT)


def one_argument(arguments: tuple[Argument, ...]) -> Argument:
    """The only argument; refuse none and several."""
    if not arguments:
        raise Refusal(Guess.MISSING_ARGUMENT)
    if len(arguments) > 1:
        raise Refusal(Guess.SURPLUS_ARGUMENT)
    return arguments[0]


def one_string(arguments: tuple[Argument, ...]) -> str:
    """The only argument, in quotes."""
    argument = one_argument(arguments)
    if not argument.quoted:
        raise Refusal(Guess.STRING_EXPECTED)
    return argument.text


def one_number(arguments: tuple[Argument, ...], low: int, high: int, event: int) -> int:
    """The only argument as a whole number; `event` refuses one out of range."""
    value = round(number(one_argument(arguments)))
    if not low <= value <= high:
        raise Refusal(event)
    return value
