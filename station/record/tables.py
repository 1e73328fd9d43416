"""The record of a test as tables in CSV: one row a limit, and one row a record of the runs."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from typing import Any

_LIMITS = (
    "number", "of", "value", "low_95", "high_95", "unit", "at_least", "at_most", "guard_band", "acceptance_low",
    "acceptance_high", "risk", "margin",
)  # fmt: skip


def limits_csv(record: Mapping[str, Any]) -> str:
    """Return one row for each limit, and one for each step that has none."""
    head = {
        "serial": record["unit"]["serial"],
        "unit_type": record["unit"]["type"],
        "started_at": record["started_at"],
        "campaign": record["campaign"]["name"],
        "campaign_verdict": record["outcome"]["verdict"],
    }
    rows = []
    for step in record["steps"]:
        about = {**head, "step": step["key"], "measurement": step["measurement"]}
        end = {"message": step["message"], "run": (step["run"] or {}).get("path")}
        for limit in step["limits"]:
            told = {name: limit[name] for name in _LIMITS}
            rows.append({**about, **told, "verdict": limit["verdict"], **end})
        if not step["limits"]:
            rows.append({**about, **dict.fromkeys(_LIMITS), "verdict": step["verdict"], **end})
    names = [*head, "step", "measurement", *_LIMITS, "verdict", "message", "run"]
    return as_csv(names, rows)


def records_csv(record: Mapping[str, Any]) -> str:
    """Return one row for each record of every run; columns that a measurement does not have are empty."""
    rows = [
        {"serial": record["unit"]["serial"], "step": step["key"], **_flat(row)}
        for step in record["steps"]
        for row in step["records"]
    ]
    names = dict.fromkeys(["serial", "step"])
    for row in rows:
        names.update(dict.fromkeys(row))
    return as_csv(list(names), rows)


def as_csv(names: list[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """Return rows as CSV by RFC 4180: a header, CRLF, quotes where they are needed; nothing for null."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, names, restval="")
    writer.writeheader()
    writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
    return text.getvalue()


def _cell(value: object) -> object:
    if value is None:
        return ""
    if isinstance(value, str):
        # a spreadsheet carries out a text that begins like this; no unit and no sentence of ours does
        return f"'{value}" if value[:1] in "=+-@\t\r" and value[:1] else value
    return repr(value) if isinstance(value, float) else value


def _flat(row: Mapping[str, Any]) -> dict[str, Any]:
    """Values in the columns of a table: of a list the words, of a mapping each value under its own name."""
    flat: dict[str, Any] = {}
    for name, value in row.items():
        if isinstance(value, Mapping):
            flat |= {f"{name}_{inner}": one for inner, one in _flat(value).items()}
        elif isinstance(value, list):
            flat[name] = " ".join(map(str, value))
        else:
            flat[name] = value
    return flat
