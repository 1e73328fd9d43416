"""The one way from values to plain JSON: what is not finite becomes null, arrays become lists."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """Return a value as plain JSON.

    Examples
    --------
    >>> plain({"a": np.float64("nan"), "b": np.arange(2), "c": (1.5, None)})
    {'a': None, 'b': [0, 1], 'c': [1.5, None]}
    """
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(name): plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(one) for one in value]
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    return str(value) if isinstance(value, Path) else value


def picked(source: object, names: Mapping[str, str]) -> dict[str, Any]:
    """Return attributes of an object under the names that programs rely on."""
    return {key: getattr(source, attribute) for key, attribute in names.items()}
