"""The tree of headers, found by any spelling, and what a header does."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

from instrument.simulated.panel.events import Guess, Refusal
from instrument.simulated.panel.parsing import Argument, Leaf, Mnemonics, abbreviations
from instrument.simulated.panel.settings import Row, number
from instrument.simulated.state import ScopeState


@dataclass(eq=False)
class Node:
    """One mnemonic of the tree: a setting if it has a `row`, another command if it has an `action`."""

    path: Mnemonics = ()
    parent: Node | None = None
    children: dict[str, Node] = field(default_factory=dict)
    row: Row | None = None
    action: str = ""

    def child(self, mnemonic: str) -> Node:
        """The node below this one, made if it is new. An exact short form wins over an abbreviation."""
        exact = self.children.get(mnemonic.upper())
        if exact is not None and exact.path[-1].upper() == mnemonic.upper():
            return exact
        node = Node(path=(*self.path, mnemonic), parent=self)
        shortest, *longer = abbreviations(mnemonic)
        for spelling in longer:
            self.children.setdefault(spelling, node)
        self.children[shortest] = node
        self.children[mnemonic.upper()] = node
        return node

    def find(self, header: str) -> Node | None:
        """Follow a header given in any spelling; None if there is no such command."""
        node: Node | None = self
        for mnemonic in header.upper().split(":"):
            node = node.children.get(mnemonic) if node else None
        return node


class CommandTree:
    """All headers of a model."""

    def __init__(self, rows: Iterable[Row], actions: Iterable[str]) -> None:
        self.root = Node()
        self.rows = tuple(rows)
        for row in self.rows:
            for header in (row.header, *row.aliases):
                self._place(header).row = row
        for header in actions:
            self._place(header).action = header

    def _place(self, header: str) -> Node:
        node = self.root
        for mnemonic in header.split(":"):
            node = node.child(mnemonic)
        return node

    def rows_below(self, node: Node) -> list[Row]:
        """The settings that a branch query answers, in the order of the table."""
        branch = ":".join(node.path) + ":"
        return [row for row in self.rows if row.in_branch and row.header.startswith(branch)]


# --------------------
# Commands and queries that are more than a stored setting


Query = Callable[[ScopeState], list[Leaf]]
Order = Callable[[ScopeState, tuple[Argument, ...]], Iterator[bytes | None] | None]
Condition = Callable[[ScopeState], bool]


@dataclass(frozen=True)
class Action:
    """What a header does: `query` answers, `order` acts, and both wait while `waits` is true."""

    # An order that carries out a message of its own returns its steps, as `ScopeState.execute` gives them.

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


def plain(do: Callable[[ScopeState], object]) -> Order:
    """An order without an argument."""

    def order(state: ScopeState, arguments: tuple[Argument, ...]) -> None:
        no_argument(arguments)
        do(state)

    return order


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
