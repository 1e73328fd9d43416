"""A table of a settings file, read strictly: every entry is asked for by name, and none may be left over."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from instrument.errors import FrameFormatError

_MISSING: Any = object()


class Description:
    """One table and the place where it stands, for error texts."""

    def __init__(self, entries: object, where: str) -> None:
        self.where = where
        if not isinstance(entries, Mapping):
            raise FrameFormatError(f"{where or 'the frame format'} must be a table of named entries")
        self._entries = dict(entries)

    def name(self, key: str) -> str:
        """Full name of an entry."""
        return f"{self.where}.{key}" if self.where else key

    def error(self, key: str, problem: str) -> FrameFormatError:
        """The error that says what is wrong with an entry."""
        return FrameFormatError(f"{self.name(key)} {problem}")

    def refuse(self, wrong: bool, key: str, problem: str) -> None:
        """Raise the error if something is wrong."""
        if wrong:
            raise self.error(key, problem)

    def has(self, key: str) -> bool:
        """Whether an entry is there that was not taken yet."""
        return key in self._entries

    def peek(self, key: str) -> Any:
        """Value of an entry that is taken later, None without one."""
        return self._entries.get(key)

    def take(self, key: str, default: Any = _MISSING) -> Any:
        """Value of an entry of any type; each can be taken once."""
        if key in self._entries:
            return self._entries.pop(key)
        if default is _MISSING:
            raise self.error(key, "is missing")
        return default

    def text(self, key: str, default: str | None = None) -> str:
        """Value of an entry that holds text of ASCII characters."""
        value = self.take(key, _MISSING if default is None else default)
        if not isinstance(value, str) or not value.isascii():
            raise self.error(key, f"must be text of ASCII characters, not {value!r}")
        return value

    def choice(self, key: str, choices: tuple[str, ...], default: str | None = None) -> str:
        """Value of an entry that is one of some words."""
        value = self.take(key, _MISSING if default is None else default)
        if value not in choices:
            raise self.error(key, f"must be one of {', '.join(choices)}, not {value!r}")
        return str(value)

    def whole(self, key: str, default: int | None = None, *, lowest: int = 0, highest: int | None = None) -> int:
        """Value of an entry that is a whole number within limits."""
        value = self.take(key, _MISSING if default is None else default)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(key, f"must be a whole number, not {value!r}")
        if value < lowest or (highest is not None and value > highest):
            limits = f"at least {lowest}" if highest is None else f"from {lowest} to {highest}"
            raise self.error(key, f"must be {limits}, not {value}")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """Value of an entry that is true or false."""
        value = self.take(key, default)
        if not isinstance(value, bool):
            raise self.error(key, f"must be true or false, not {value!r}")
        return value

    def number(self, key: str, default: float | None = None, *, positive: bool = False) -> float:
        """Value of an entry that is a number, infinite only where the default is."""
        value = self.take(key, _MISSING if default is None else default)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(key, f"must be a number, not {value!r}")
        if math.isnan(value) or (math.isinf(value) and value != default):
            raise self.error(key, f"must be a finite number, not {value}")
        if positive and not value > 0:
            raise self.error(key, f"must be positive, not {value}")
        return float(value)

    def octets(self, key: str, default: str | None = None) -> bytes:
        """Value of an entry that spells bytes in hex, ``"55 AA"``."""
        value = self.text(key, default)
        try:
            return bytes.fromhex(value)
        except ValueError:
            raise self.error(key, f'must be bytes in hex such as "55 AA", not {value!r}') from None

    def table(self, key: str) -> Description | None:
        """A table within this one, None if there is none."""
        value = self.take(key, None)
        return None if value is None else Description(value, self.name(key))

    def tables(self, key: str) -> list[Description]:
        """A list of tables within this one."""
        value = self.take(key)
        if not isinstance(value, list) or not value:
            raise self.error(key, "must be a list of tables, one for each field of a frame")
        return [Description(entry, f"{self.name(key)}[{number}]") for number, entry in enumerate(value, start=1)]

    def finish(self) -> None:
        """Refuse what nobody asked for: a misspelt entry would be ignored otherwise."""
        if self._entries:
            key = sorted(map(str, self._entries))[0]
            raise self.error(key, "is not an entry that is known here; check its spelling")
