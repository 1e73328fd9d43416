"""Packages that only some need, imported when they are."""

from __future__ import annotations

import importlib
from typing import Any

from station.errors import UsageError


class MissingPackage(UsageError, ImportError):
    """An extra is not installed."""


def package(name: str, extra: str = "data") -> Any:
    """Import a package of an extra."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise MissingPackage(
            f"{name.partition('.')[0]} is not installed: pip install 'gyrolock[{extra}]'"
        ) from None
