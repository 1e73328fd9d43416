"""The record of a test as one page: for people, for a binder of A4, for a telephone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from station.campaign.outcome import CampaignOutcome
from station.provenance import version
from station.record.hashes import CONTENT
from station.report.figure import renamed
from station.report.page import render_page
from station.results.parts import FactTable, Rows, Section
from station.shell.evaluated import Evaluated

_STATES = {"PASS": "good", "MARGINAL": "doubtful", "FAIL": "bad", "ERROR": "bad", "ABORTED": "bad"}
_ROWS = 60


def render_record(record: Mapping[str, Any], outcome: CampaignOutcome, evaluated: Mapping[str, Evaluated]) -> str:
    """Return the page of a record of a test as HTML."""
    verdict = record["outcome"]["verdict"]
    unit = record["unit"]
    tables = [table for table in _facts(record) if table.rows]
    middle = (len(tables) + 1) // 2
    return render_page(
        "record.html.j2",
        title=f"{unit['serial']}, {record['started_at'][:10]}: {verdict or 'tested'}",
        heading=f"Record of test: {record['campaign']['name']}",
        version=version("gyrolock"),
        simulated=record["simulated"],
        state=_state(verdict),
        verdict=verdict or "TESTED",
        unit=f"{unit['serial']}, {unit['type']}" if unit["type"] else unit["serial"],
        lines=_lines(record),
        labels=_labels(record),
        limits=[_limit_row(step, limit) for step in record["steps"] for limit in step["limits"]],
        notes=_notes(record),
        steps=[*(_step_row(step, evaluated.get(step["key"])) for step in record["steps"]), *_not_begun(record)],
        shown=list(_shown(record, evaluated)),
        fact_columns=[tables[:middle], tables[middle:]],
        footer=_footer(record, outcome),
    )


def _state(verdict: str | None) -> str:
    return _STATES.get(verdict or "", "")


def _lines(record: Mapping[str, Any]) -> list[str]:
    said = [f"Tested {_time(record['started_at'])} to {_time(record['ended_at'])} UTC."]
    return [*said, record["outcome"]["message"]] if record["outcome"]["message"] else said


def _time(at: str | None) -> str:
    return (at or "unknown")[:16].replace("T", " ")


def _labels(record: Mapping[str, Any]) -> Rows:
    station = record["station"]["name"] or record["station"]["host"]
    rows = [("operator", record["operator"]), ("station", station), ("note", record["note"])]
    if record["resumed_at"]:
        rows.append(("resumed", f"{len(record['resumed_at'])} times" if len(record["resumed_at"]) > 1 else "once"))
    if record["unit"]["is_reference"]:
        rows.append(("unit", "reference unit of the bench"))
    return [(name, str(value)) for name, value in rows if value]


def _limit_row(step: Mapping[str, Any], limit: Mapping[str, Any]) -> dict[str, str]:
    unit = limit["unit"] or ""
    ends = [("≥", limit["at_least"]), ("≤", limit["at_most"])]
    interval = "not known"
    if limit["low_95"] is not None and limit["high_95"] is not None:
        interval = f"{limit['low_95']:.6g} to {limit['high_95']:.6g}"
    words = limit["name"].rpartition("_")[0] if unit else limit["name"]
    margin = "" if limit["margin"] is None else f"{limit['margin']:+.3g} {unit}".rstrip()
    return {
        "name": f"{step['key']}: {words.replace('_', ' ')}",
        "value": "none" if limit["value"] is None else f"{limit['value']:.6g} {unit}".rstrip(),
        "interval": interval,
        "limit": " and ".join(f"{sign} {end:g} {unit}".rstrip() for sign, end in ends if end is not None),
        "margin": margin,
        "verdict": limit["verdict"],
        "state": _state(limit["verdict"]),
    }


_RULES = {
    "U95": "Guard band U95: PASS where the whole 95 % interval lies within the limit, FAIL where it lies beyond, "
    "MARGINAL where the limit lies inside it.",
    "simple": "Simple acceptance (JCGM 106): the value alone decides, at the risk that is stated.",
    "none": "Without a guard band: the value alone decides, its uncertainty is not asked for.",
}


def _notes(record: Mapping[str, Any]) -> list[str]:
    """How it was decided, and what the limits could not say by themselves."""
    limits = [limit for step in record["steps"] for limit in step["limits"]]
    rules = dict.fromkeys(limit["guard_band"] for limit in limits)
    told = [_RULES[rule] for rule in rules if rule in _RULES]
    told += [
        f"{limit['sentence']}."
        for limit in limits
        if limit["verdict"] != "PASS" or limit["highest_risk"] is not None
    ]
    for step in record["steps"]:
        if step["failure"] is not None:
            told.append(f"{step['key']}: {step['failure']['message']}")
        told += [f"{step['key']}: {remark}" for remark in step["remarks"]]
    return told


def _step_row(step: Mapping[str, Any], evaluated: Evaluated | None) -> dict[str, str]:
    value = step["message"] or ""
    if evaluated is not None:
        value = f"{evaluated.result.name} {evaluated.result.value}"
    return {
        "name": step["key"],
        "value": value,
        "begun": _time(step["started_at"]),
        "verdict": step["verdict"] or "measured",
        "state": _state(step["verdict"]) or "good",
    }


def _not_begun(record: Mapping[str, Any]) -> list[dict[str, str]]:
    return [
        {"name": one["key"], "value": "", "begun": "not begun", "verdict": "", "state": "doubtful"}
        for one in record["not_begun"]
    ]


def _shown(record: Mapping[str, Any], evaluated: Mapping[str, Evaluated]) -> Iterator[dict[str, Any]]:
    for place, step in enumerate(record["steps"], start=1):
        one = evaluated.get(step["key"])
        if one is None:
            continue
        sections = [_placed(section, f"step{place}") for section in one.sections()]
        if one.result.to_watch:
            sections.append(Section("What to watch", sentences=one.result.to_watch))
        yield {
            "name": f"{step['key']}: {one.kind.title}",
            "state": _state(step["verdict"])
            or {"stands": "good", "fails": "bad"}.get(one.result.standing.state, ""),
            "value": f"{step['verdict']} · {one.result.value}" if step["verdict"] else one.result.value,
            "lines": [*one.result.lines, *(f"{limit['sentence']}." for limit in step["limits"])],
            "sections": sections,
        }


def _placed(section: Section, name: str) -> Section:
    """A section whose figures may stand beside those of another run; of a long table the first rows."""
    figures = tuple(replace(one, svg=renamed(one.svg, name)) for one in section.figures)
    table, text = section.table, section.text
    if table is not None and len(table.rows) > _ROWS:
        text = f"{text} The first {_ROWS} of {len(table.rows)} rows; records.csv holds all.".strip()
        table = replace(table, rows=table.rows[:_ROWS])
    return replace(section, figures=figures, table=table, text=text)


def _facts(record: Mapping[str, Any]) -> Iterator[FactTable]:
    for card in record["instruments"]:
        known = {
            "model": card["model"],
            "serial number": card["serial"],
            "firmware": card["firmware"],
            "calibrated on": card["calibrated_on"],
            "calibration due": card["calibration_due"],
        }
        rows = [(name, str(value)) for name, value in known.items() if value]
        if card["calibration_valid"] is False:
            rows.append(("calibration", "had expired when the test began"))
        yield FactTable(card["role"], rows or [("model", "not stated")])
    for step in record["steps"]:
        instrument = (step["result"] or {}).get("instrument")
        found = [(name, str(value)) for name, value in (instrument or {}).items() if value]
        found += [(name.replace("_", " "), f"{value:g}") for name, value in step["conditions"]["found"].items()]
        if found:
            yield FactTable(f"Found in {step['key']}", found)
    campaign, made = record["campaign"], record["software"]
    yield FactTable(
        "Campaign",
        [
            ("name", campaign["name"]),
            ("file", campaign["file"]),
            ("its SHA-256", campaign["file_sha256"]),
            ("settings, SHA-256", campaign["settings_sha256"]),
        ],
    )
    yield FactTable(
        "Software",
        [
            ("gyrolock", f"{made['gyrolock']}{', source ' + made['git'] if made['git'] else ''}"),
            ("Python", f"{made['python']} on {made['platform']}"),
            ("packages", ", ".join(f"{name} {number}" for name, number in made["packages"].items())),
        ],
    )
    for step in record["steps"]:
        if (run := step["run"]) is not None:
            rows = [("run", run["path"]), ("SHA-256", run["sha256"] or "not known")]
            yield FactTable(f"Raw data of {step['key']}", [*rows, ("of its records", run["records_sha256"] or "")])
    yield FactTable("This record", [("SHA-256 of its content", record[CONTENT])])


def _footer(record: Mapping[str, Any], outcome: CampaignOutcome) -> str:
    return (
        f"Made by gyrolock {version('gyrolock')}. `gyrolock verify {outcome.directory.name}` proves that this "
        "record and the raw runs belong together, and computes the result again."
    )
