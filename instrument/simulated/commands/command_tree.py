"""The tree of headers: finds a command by any spelling between its short and its long form."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from instrument.simulated.panel.formats import Mnemonics, abbreviations
from instrument.simulated.panel.settings_table import Row


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
