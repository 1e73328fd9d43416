"""Two outputs compared as numbers with an uncertainty are: 1e-3 of it, whatever processor rounded them.

A number stands beside its uncertainty by its name: ``ratio`` and ``ratio_u``, ``lock_in_rate_dps`` and
``lock_in_rate_noise_u_dps`` or ``lock_in_rate_low_95_dps`` and ``lock_in_rate_high_95_dps``. One that has none may
move by 1e-6 of itself. A sum of squares of what is measured in uncertainties, S, moves by 2e-3 sqrt(S) when one of
them moves by 1e-3, and its chance by 4e-4, which is 1e-3 times the greatest height of a normal density.
"""

from __future__ import annotations

import ast
import csv
import io
import json
import math
import re
from collections.abc import Mapping
from typing import Any

OF_U, OF_ITSELF = 1e-3, 1e-6
PLACES = ("run", "report", "file", "page")  # where something lies differs from machine to machine
OF_THE_MACHINE = (
    "software",
    "content_sha256",
    "run_sha256",
    "records_sha256",
    "source_sha256",
    "sha256",
    "analysis",
)

# what is measured in uncertainties, or as a share of a whole, moves by what the uncertainty may move
ABSOLUTE = {
    "deviation_in_u": 1e-3,
    "_ppm": 1e-6,
    "share_of_variance": 1e-6,
    "_rad": 1e-5,  # a phase of the ratio of one record is known to some milliradians at best
    "p_value": 4e-4,
    "p_value_by_all": 4e-4,
    "least_error_seen": 1e-6,
    "push": 1e-9,  # of the beat, as a share: one in 10^9 is nothing
    "_re": 1e-6,
    "_im": 1e-6,
}
_BESIDE = {"u", "low", "high", "95", "noise"}
_NUMBER = re.compile(r"(?<![\w.])[-+\u2212]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?:\(\d+(?:\.\d+)?\))?(?![\w])")


def stem(name: str) -> str:
    """Name of the number that a name is of: ``lock_in_rate_dps`` of ``lock_in_rate_low_95_dps``."""
    return "_".join(part for part in name.split("_") if part not in _BESIDE)


def uncertainties(numbers: Mapping[str, Any]) -> dict[str, float]:
    """The uncertainty of each number of an object, by its stem: the largest that stands there."""
    found: dict[str, float] = {}
    for name, value in numbers.items():
        is_one = "u" in name.split("_") or name.startswith("contribution_")  # a line of a budget is one itself
        if isinstance(value, float) and is_one and math.isfinite(value):
            found[stem(name)] = max(found.get(stem(name), 0.0), abs(value))
    for name, low in numbers.items():
        if "_low_95" not in name or not isinstance(low, float):
            continue
        high, value = numbers.get(name.replace("_low_95", "_high_95")), numbers.get(stem(name))
        if isinstance(high, float) and math.isfinite(high - low):
            found.setdefault(stem(name), abs(high - low) / 4)
        elif high is None and isinstance(value, float):
            found.setdefault(stem(name), abs(value - low) / 2)
    return found


def differences(then: Any, now: Any, place: str = "", u: float | list[float] = 0.0) -> list[str]:
    """Say where `now` lacks or changes something of `then`; `u` is that of the number."""
    if isinstance(then, dict):
        if not isinstance(now, dict):
            return [f"{place}: {then!r} became {now!r}"]
        found, us = [], uncertainties(then)
        lists = {stem(name): value for name, value in then.items() if "u" in name.split("_")}
        for name, value in then.items():
            if name in PLACES or name in OF_THE_MACHINE:
                continue
            if name not in now:
                found.append(f"{place}.{name} is missing")
                continue
            of = lists.get(stem(name)) if isinstance(value, list) else us.get(stem(name), 0.0)
            found += differences(value, now[name], f"{place}.{name}", of if isinstance(of, list | float) else 0.0)
        return found
    if isinstance(then, list):
        if not isinstance(now, list) or len(now) != len(then):
            return [f"{place}: {then!r} became {now!r}"]
        us = u if isinstance(u, list) and len(u) == len(then) else [0.0] * len(then)
        return [
            text
            for row, value in enumerate(then)
            for text in differences(value, now[row], f"{place}[{row}]", us[row] or 0.0)
        ]
    if isinstance(then, float) and isinstance(now, int | float) and not isinstance(u, list):
        least = next((small for end, small in ABSOLUTE.items() if place.endswith(end)), 1e-15)
        if place.endswith("chi_square"):
            least = 2 * OF_U * math.sqrt(abs(then))
        same = math.isclose(then, now, rel_tol=OF_ITSELF, abs_tol=max(least, OF_U * u)) or then is now
        same = same or (math.isnan(then) and math.isnan(now))
    elif isinstance(then, str) and isinstance(now, str) and " " in then:
        return differences_of_text(place, then, now)
    else:
        same = then == now
    return [] if same else [f"{place}: {then!r} became {now!r}"]


def differences_of_output(name: str, then: str, now: str) -> list[str]:
    """The same of what a command printed or wrote; the kind goes by its content and its name."""
    if then.startswith("{") and ".jsonl" in name.replace("_jsonl.out", ".jsonl"):
        a, b = ([json.loads(line) for line in text.splitlines()] for text in (then, now))
        return differences(a, b, name)
    if then.startswith("{") and now.startswith("{"):
        return differences(json.loads(then), json.loads(now), name)
    if name.endswith(".csv"):
        a, b = ([_numbers(row) for row in csv.DictReader(io.StringIO(text))] for text in (then, now))
        return differences(a, b, name)
    return differences_of_text(name, then, now)


def _numbers(row: Mapping[str, str]) -> dict[str, Any]:
    def cell(text: str) -> Any:
        if (text or "").startswith("{'"):
            return ast.literal_eval("[" + text.replace("} {", "}, {") + "]")
        return float(text) if _NUMBER.fullmatch(text or "") else text

    return {name: cell(text) for name, text in row.items()}


def differences_of_text(name: str, then: str, now: str) -> list[str]:
    """Words are the same; a printed number may round to its neighbour."""
    words = [_NUMBER.sub("#", text) for text in (then, now)]
    if words[0] != words[1]:
        a, b = (text.splitlines() for text in words)
        row = next((row for row, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))
        lines = (text.splitlines()[row : row + 1] for text in (then, now))
        return ["{}: {} became {}".format(name, *lines)]
    pairs = zip(_NUMBER.findall(then), _NUMBER.findall(now), strict=True)
    return [f"{name}: {a} became {b}" for a, b in pairs if a != b and not _neighbours(a, b)]


def _neighbours(then: str, now: str) -> bool:
    """Whether two printed numbers differ by one in their last place, and by one in that of their uncertainty."""
    if then.count("(") != now.count("("):
        return False
    parts = [text.replace("\N{MINUS SIGN}", "-").rstrip(")").split("(") for text in (then, now)]
    return all(_one_apart(a, b) for a, b in zip(*parts, strict=True))


def _one_apart(then: str, now: str) -> bool:
    digits, _, power = then.partition("e")
    last = 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))
    return abs(float(then) - float(now)) <= max(1.01 * last, OF_ITSELF * abs(float(then)))
