"""The record of a test: JSON with its hashes, JUnit XML, CSV and a page, beside the runs it was made of."""

import csv
import hashlib
import io
import json
import math
import os
import platform
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any

from station.campaign.journal import PAGE_FILE, CampaignOutcome, InstrumentCard, StepOutcome
from station.campaign.messages import LIMIT_COLUMNS, limits_table
from station.errors import CannotWrite, StationError, UsageError, one_line
from station.files import inert, provenance, version
from station.measurements import steps_by_name
from station.report.figure import renamed
from station.report.show import render_page, write_page
from station.results.result import FactTable, Section, plain
from station.results.verdict import ABORTED, Limit, LimitOutcome, judged, worst
from station.runs.store import SavedRun, open_run
from station.shell.finish import Evaluated, evaluate_run

RECORD_FILE = "record.json"
JUNIT_FILE, LIMITS_FILE, RECORDS_FILE = "junit.xml", "limits.csv", "records.csv"


@dataclass(frozen=True)
class RecordFiles:
    """A record, and the files that it was written to."""

    document: Mapping[str, Any]
    json: Path
    junit: Path
    limits: Path
    records: Path
    page: Path


def write_record(outcome: CampaignOutcome, *, evaluated: Mapping[str, Evaluated] | None = None) -> RecordFiles:
    """Write the record of a test into its folder; each file appears whole or not at all."""
    known = dict(evaluated or {})
    if outcome.verdict != ABORTED:
        for step in outcome.steps:
            if step.step.key not in known and step.run is not None and step.document:
                with suppress(StationError):  # what the step says of it stands in the record
                    known[step.step.key] = evaluate_run(open_run(step.run))
    document = record_document(outcome, known)
    folder = outcome.directory
    texts = {
        RECORD_FILE: json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n",
        JUNIT_FILE: junit_xml(document),
        LIMITS_FILE: limits_csv(document),
        RECORDS_FILE: records_csv(document),
    }
    try:
        paths = [write_page(folder / name, text) for name, text in texts.items()]
        # pictures take their time: what programs read is there before
        paths.append(write_page(folder / PAGE_FILE, render_record(document, outcome, known)))
    except OSError as error:
        raise CannotWrite(f"{folder}: the record of the test cannot be written ({one_line(error)})") from None
    return RecordFiles(document, *paths)


# --------------------
# The record of a test as one JSON document: all that is known of it, and nothing that must be looked up


NAME, VERSION = "gyrolock test record", 1
SCHEMA_FILE = Path(__file__).with_name("test-record-1.schema.json")  # JSON Schema of this version


def record_document(outcome: CampaignOutcome, evaluated: Mapping[str, Evaluated]) -> dict[str, Any]:
    """Return the record of a test as plain JSON."""
    plan = outcome.plan
    settings = plain(plan.settings)
    seen: Mapping[str, Any] = next(
        (found for one in outcome.steps if (found := one.document.get("instrument"))), {}
    )
    begun = {one.step.key for one in outcome.steps}
    document = {
        "schema": {"name": NAME, "version": VERSION},
        "unit": {"serial": plan.unit, "type": plan.unit_type, "is_reference": plan.is_reference},
        "operator": outcome.operator or None,
        "note": outcome.note or None,
        "station": {"name": plan.station or None, "host": platform.node() or None},
        "simulated": plan.simulated,
        "started_at": outcome.started_at,
        "ended_at": outcome.ended_at or None,
        "resumed_at": list(outcome.resumed_at),
        "outcome": {
            "verdict": outcome.verdict,
            "exit_code": outcome.exit_code,
            "message": outcome.message or None,
            "failure": None if outcome.failure is None else outcome.failure.as_json(),
        },
        "campaign": {
            "name": plan.name,
            "file": plan.file.name,
            "file_sha256": plan.file_sha256,
            "settings": settings,
            "settings_sha256": hashlib.sha256(canonical(settings)).hexdigest(),
        },
        "instruments": [
            _instrument(card, outcome.started_at, seen if card.role == "oscilloscope" else {})
            for card in plan.instruments
        ],
        "software": provenance(),
        "steps": [_step(one, outcome.directory, evaluated.get(one.step.key)) for one in outcome.steps],
        "not_begun": [
            {"key": step.key, "name": step.name, "number": step.number, "measurement": step.measurement}
            for step in outcome.plan.steps
            if step.key not in begun
        ],
    }
    whole: dict[str, Any] = dict(plain(document))
    return {**whole, CONTENT: content_sha256(whole)}


def _instrument(card: InstrumentCard, at: str, seen: Mapping[str, Any]) -> dict[str, Any]:
    """An instrument as the campaign states it, and where that says nothing as it answered."""
    due = card.calibration_due
    return {
        "role": card.role,
        "model": card.model or seen.get("model"),
        "serial": card.serial or seen.get("serial"),
        "firmware": card.firmware or seen.get("firmware"),
        "calibrated_on": _day(card.calibrated_on),
        "calibration_due": _day(due),
        "calibration_valid": None if due is None or not at else at[:10] <= due.isoformat(),
    }


def _day(day: date | None) -> str | None:
    return None if day is None else day.isoformat()


def _step(outcome: StepOutcome, directory: Path, evaluated: Evaluated | None) -> dict[str, Any]:
    step, result = outcome.step, dict(plain(outcome.document))
    return {
        "key": step.key,
        "name": step.name,
        "number": step.number,
        "measurement": step.measurement,
        "repeat": step.repeat,
        "of_repeats": step.of_repeats,
        "verdict": outcome.verdict,
        "message": outcome.message or None,
        "failure": None if outcome.failure is None else outcome.failure.as_json(),
        "remarks": list(outcome.remarks),
        "started_at": outcome.started_at or None,
        "ended_at": outcome.ended_at or None,
        "elapsed_s": outcome.elapsed_s,
        "attempts": outcome.attempts,
        "doubtful": step.doubtful,
        **({} if step.only_if is None else {"only_if": step.only_if}),
        "conditions": {"planned": step.conditions, "found": outcome.conditions},
        "limits": [limit_document(one) for one in outcome.limits],
        "result": result or None,
        "budget": result.get("budget"),
        "records": []
        if evaluated is None
        else [{name: value for name, value in row.items() if name != "run"} for row in evaluated.rows()],
        "run": None if outcome.run is None else _run(outcome.run, directory, outcome.run_sha256, evaluated),
    }


def limit_document(one: LimitOutcome) -> dict[str, Any]:
    """Return a number against its limit as JSON."""
    limit, measured = one.limit, one.measured
    return dict(
        plain(
            {
                "name": one.name,
                "number": limit.number,
                **{name: of for name in ("less", "over") if (of := getattr(limit, name))},
                "of": measured.of or None,
                "value": measured.value,
                "low_95": measured.low_95,
                "high_95": measured.high_95,
                "unit": measured.unit or None,
                "at_least": limit.at_least,
                "at_most": limit.at_most,
                "guard_band": limit.rule,
                "acceptance_low": one.acceptance_low,
                "acceptance_high": one.acceptance_high,
                "risk": one.risk,
                "highest_risk": limit.highest_risk if limit.rule == "simple" else None,
                "margin": one.margin,
                "verdict": one.verdict,
                "sentence": one.sentence,
            }
        )
    )


def _run(path: Path, directory: Path, sha256: str, evaluated: Evaluated | None) -> dict[str, Any]:
    try:
        run = evaluated.run if evaluated is not None else open_run(path)
        records, count = records_sha256(run), len(run.records)
    except StationError:  # what is left of it is not a run
        records, count = None, None
    try:
        now = file_sha256(path)
    except OSError:
        now = None
    return {
        "path": relative(path, directory),
        "sha256": now or sha256 or None,
        "records_sha256": records,
        "records": count,
    }


def relative(path: Path, directory: Path) -> str:
    """Return a path as it is seen from the folder of the test, so that the folder can be moved as a whole."""
    try:
        return Path(os.path.relpath(path, directory)).as_posix()
    except ValueError:  # on another drive
        return path.absolute().as_posix()


# --------------------
# Sums by which a record of a test, and the runs that it was made of, are known again


CONTENT = "content_sha256"
_PIECE = 1 << 20


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file; OSError if it cannot be read."""
    total = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(_PIECE):
            total.update(piece)
    return total.hexdigest()


def records_sha256(run: SavedRun) -> str:
    """Return the SHA-256 of what was measured: command, settings, and of each record what makes it."""
    # It stays the same when a result is computed again and saved, or the file is copied page by page.
    total = hashlib.sha256(canonical({"command": run.facts.command, "settings": run.facts.settings}))
    for one in run.records:
        head = [one.number, one.key, one.taken_at, one.purpose, one.header, one.conditions]
        total.update(canonical(head))
        total.update(hashlib.sha256(one.payload).digest())
    return total.hexdigest()


def content_sha256(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a record of a test without this sum itself."""
    rest = {name: value for name, value in document.items() if name != CONTENT}
    return hashlib.sha256(canonical(rest)).hexdigest()


def canonical(value: object) -> bytes:
    """Return plain JSON in the one form of which sums are made: sorted names, no spaces, UTF-8."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()


# --------------------
# The record of a test as JUnit XML, for Jenkins, GitLab and whatever else reads test results


# XML 1.0 has no place for these, not even written as numbers
_NOT_IN_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


def junit_xml(record: Mapping[str, Any]) -> str:
    """Return the XML of a record of a test: a suite for each step, a case for each limit."""
    # A FAIL is a failure; MARGINAL is one too, of the type ``MARGINAL``: a reader that knows no third verdict must
    # not take it for a pass. ERROR and ABORTED are errors, steps that were not begun are skipped.
    root = ET.Element("testsuites", {"name": _text(f"{record['campaign']['name']}: {record['unit']['serial']}")})
    for step in record["steps"]:
        _suite(root, step, record, counts=step["name"] not in replaced_steps(record))
    for step in record["not_begun"]:
        suite = ET.SubElement(root, "testsuite", {"name": _text(step["key"])})
        case = ET.SubElement(
            suite, "testcase", {"classname": _text(step["key"]), "name": "measurement", "time": "0"}
        )
        ET.SubElement(case, "skipped", {"message": "not begun"})
        _count(suite)
    _count(root)
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def replaced_steps(record: Mapping[str, Any]) -> set[str]:
    """Return names of steps whose verdict does not count, since a later one stands for it."""
    asked = (step["only_if"] for step in record["steps"] if step.get("only_if"))
    return {one["step"] for one in asked if one["instead"]}


def _suite(root: ET.Element, step: Mapping[str, Any], record: Mapping[str, Any], *, counts: bool) -> None:
    about = {"name": _text(step["key"]), "hostname": _text(record["station"]["host"] or "")}
    if step["started_at"]:
        about["timestamp"] = step["started_at"].rstrip("Z").split(".")[0]
    suite = ET.SubElement(root, "testsuite", about)
    known = {
        "unit": record["unit"]["serial"],
        "unit_type": record["unit"]["type"],
        "operator": record["operator"],
        "station": record["station"]["name"],
        "verdict": step["verdict"],
        "run": (step["run"] or {}).get("path"),
        "run_sha256": (step["run"] or {}).get("sha256"),
        "simulated": str(record["simulated"]).lower(),
    }
    _properties(suite, known)
    seconds = f"{step['elapsed_s']:.3f}"
    for place, limit in enumerate(step["limits"]):
        # the time of the step belongs to all of its limits together
        case = _case(suite, step["key"], limit["name"], seconds if place == 0 else "0")
        _properties(case, {name: limit[name] for name in _OF_CASE})
        _say(case, limit["verdict"] if counts else None, limit["sentence"])
    broken = step["failure"] is not None
    if broken or not step["limits"]:
        case = _case(suite, step["key"], "measurement", "0" if step["limits"] else seconds)
        _say(case, step["verdict"] if broken and counts else None, step["message"] or "")
    _count(suite)
    if step["remarks"]:
        ET.SubElement(suite, "system-out").text = _text("\n".join(step["remarks"]))


_OF_CASE = ("value", "low_95", "high_95", "unit", "at_least", "at_most", "verdict")


def _properties(element: ET.Element, known: Mapping[str, Any]) -> None:
    told = ET.SubElement(element, "properties")
    for name, value in known.items():
        if value is not None:
            ET.SubElement(told, "property", {"name": name, "value": _text(str(value))})


def _case(suite: ET.Element, step: str, name: str, seconds: str) -> ET.Element:
    return ET.SubElement(suite, "testcase", {"classname": _text(step), "name": _text(name), "time": seconds})


def _say(case: ET.Element, verdict: str | None, sentence: str) -> None:
    kind = {"FAIL": "failure", "MARGINAL": "failure", "ERROR": "error", "ABORTED": "error"}.get(verdict or "")
    if kind is not None:
        told = ET.SubElement(case, kind, {"type": str(verdict), "message": _text(sentence)})
        told.text = _text(sentence)
    elif sentence:
        ET.SubElement(case, "system-out").text = _text(sentence)


def _count(element: ET.Element) -> None:
    cases = list(element.iter("testcase"))
    kinds = {"failures": "failure", "errors": "error", "skipped": "skipped"}
    element.set("tests", str(len(cases)))
    for name, kind in kinds.items():
        element.set(name, str(sum(case.find(kind) is not None for case in cases)))
    element.set("time", f"{sum(float(case.get('time', 0)) for case in cases):.3f}")


def _text(text: str) -> str:
    return inert(_NOT_IN_XML.sub("\N{REPLACEMENT CHARACTER}", text))


# --------------------
# The record of a test as tables in CSV: one row a limit, and one row a record of the runs


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
        run = {"run": (step["run"] or {}).get("path")}
        for limit in step["limits"]:
            told = {name: limit[name] for name in (*_LIMITS, "verdict")}
            if "less" in limit or "over" in limit:
                told["number"] = limit["name"]
            rows.append({**about, **told, "message": limit["sentence"], **run})
        if not step["limits"]:
            rows.append({**about, "verdict": step["verdict"], "message": step["message"], **run})
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
        return inert(value)
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


# --------------------
# The record of a test as one page: for people, for a binder of A4, for a telephone


_STATES = {"PASS": "good", "MARGINAL": "doubtful", "FAIL": "bad", "ERROR": "bad", "ABORTED": "bad"}
_ROWS = 60


def render_record(record: Mapping[str, Any], outcome: CampaignOutcome, evaluated: Mapping[str, Evaluated]) -> str:
    """Return the page of a record of a test as HTML."""
    verdict = record["outcome"]["verdict"]
    unit = record["unit"]
    tables = [table for table in _facts(record) if table.rows]
    middle = (len(tables) + 1) // 2
    tested = f"Tested {_time(record['started_at'])} to {_time(record['ended_at'])} UTC."
    station = record["station"]["name"] or record["station"]["host"]
    rows = [("operator", record["operator"]), ("station", station), ("note", record["note"])]
    if record["resumed_at"]:
        rows.append(("resumed", f"{len(record['resumed_at'])} times" if len(record["resumed_at"]) > 1 else "once"))
    if record["unit"]["is_reference"]:
        rows.append(("unit", "reference unit of the bench"))
    return render_page(
        "record.html.j2",
        title=f"{unit['serial']}, {record['started_at'][:10]}: {verdict or 'tested'}",
        heading=f"Record of test: {record['campaign']['name']}",
        version=version("gyrolock"),
        simulated=record["simulated"],
        state=_state(verdict),
        verdict=verdict or "TESTED",
        unit=f"{unit['serial']}, {unit['type']}" if unit["type"] else unit["serial"],
        lines=list(filter(None, [tested, record["outcome"]["message"]])),
        labels=[(name, str(value)) for name, value in rows if value],
        limits=[
            {"state": _state(row[0]), **dict(zip(LIMIT_COLUMNS, row, strict=True))}
            for row in limits_table(outcome.steps).rows
        ],
        notes=_notes(record),
        steps=[
            *(_step_row(step, evaluated.get(step["key"])) for step in record["steps"]),
            *(
                {"name": one["key"], "value": "", "begun": "not begun", "verdict": "", "state": "doubtful"}
                for one in record["not_begun"]
            ),
        ],
        shown=list(_shown(record, evaluated)),
        fact_columns=[tables[:middle], tables[middle:]],
        footer=f"Made by gyrolock {version('gyrolock')}. `gyrolock verify {outcome.directory.name}` proves that "
        "this record and the raw runs belong together, and computes the result again.",
    )


def _state(verdict: str | None) -> str:
    return _STATES.get(verdict or "", "")


def _time(at: str | None) -> str:
    return (at or "unknown")[:16].replace("T", " ")


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


# --------------------
# Proving that a record of a test and its raw runs belong together, and that the result follows from them


_SAME = 1e-6  # of a value: what another processor or another NumPy may change; far below any uncertainty


@dataclass(frozen=True)
class RecordCheck:
    """Something that was looked at."""

    about: str  # the record, or the key of a step
    holds: bool
    sentence: str


def read_record(path: Path) -> tuple[Path, dict[str, Any]]:
    """Return the file of a record, given by itself or by its folder, and what stands in it."""
    file = path / RECORD_FILE if path.is_dir() else path
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{one_line(error)}: there is no record of a test") from None
    except (ValueError, RecursionError):
        raise UsageError(f"{file}: is no record of a test: it cannot be read as JSON") from None
    schema = document.get("schema") if isinstance(document, dict) else None
    if not isinstance(schema, dict) or schema.get("name") != NAME:
        raise UsageError(f"{file}: is no record of a test")
    if schema.get("version") != VERSION:
        raise UsageError(
            f"{file}: is of version {schema.get('version')}; this gyrolock reads {VERSION}: update it"
        )
    return file, document


def verify(path: Path) -> list[RecordCheck]:
    """Look at a record and at its runs."""
    file, record = read_record(path)
    try:
        same = content_sha256(record) == record.get(CONTENT)
    except ValueError:
        same = False
    said = "its content is what was written" if same else "its content was changed after it was written"
    found = [RecordCheck("record", same, said)]
    try:
        for place, step in enumerate(record["steps"]):
            found += _verified_step(step, file.parent, record["steps"][:place])
        found.append(_outcome(record))
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        found.append(
            RecordCheck("record", False, f"it is not laid out as a record is ({type(error).__name__}: {error})")
        )
    return found


def _verified_step(
    step: Mapping[str, Any], folder: Path, before: Sequence[Mapping[str, Any]]
) -> Iterator[RecordCheck]:
    key, known = str(step["key"]), step["run"]
    if known is None:
        yield RecordCheck(
            key, not step["limits"], "it has no run" if not step["limits"] else "it has limits and no run"
        )
        return
    path = folder / known["path"]
    try:
        run = open_run(path)
    except StationError as error:
        yield RecordCheck(key, False, f"its run is not there: {one_line(error)}")
        return
    if known["records_sha256"] is None:
        yield RecordCheck(key, False, "the record holds no sum of the raw records")
    elif records_sha256(run) != known["records_sha256"]:
        yield RecordCheck(key, False, f"the raw records in {known['path']} are others than those of the record")
    else:
        whole = known["sha256"] == file_sha256(path)
        told = "" if whole else "; the file was written to since (a result computed again, or a report)"
        yield RecordCheck(key, True, f"the {len(run.records)} raw records are those of the record{told}")
    yield from (RecordCheck(key, False, sentence) for sentence in run.damaged)
    if step["limits"] or step["result"]:
        yield from _recomputed(step, run, before)


def _recomputed(
    step: Mapping[str, Any], run: SavedRun, before: Sequence[Mapping[str, Any]]
) -> Iterator[RecordCheck]:
    key = str(step["key"])
    try:
        again = evaluate_run(run)
    except StationError as error:
        yield RecordCheck(key, False, f"the result cannot be computed again: {one_line(error)}")
        return
    changed = list(_changed(step["result"] or {}, again))
    if changed:
        yield RecordCheck(key, False, f"computed again, {'; '.join(changed)}")
    else:
        yield RecordCheck(
            key, True, f"computed again, the result is the same: {again.result.name} {again.result.value}"
        )
    if step["limits"]:
        yield _judged_again(step, again, before)


def _changed(before: Mapping[str, Any], again: Evaluated) -> Iterator[str]:
    """Numbers of the result that come out otherwise: those at its top, with those that limits are set on."""
    now = again.document()
    for name, old in before.items():
        new = now.get(name)
        if isinstance(old, bool) or not isinstance(old, int | float) or name in ("version",):
            if old is None and isinstance(new, float):
                yield f"{name} was none and is {new:.9g}"
            continue
        if not isinstance(new, int | float) or not math.isclose(
            float(old), float(new), rel_tol=_SAME, abs_tol=1e-12
        ):
            yield f"{name} was {old:.9g} and is {new if new is None else f'{new:.9g}'}"


def _judged_again(step: Mapping[str, Any], again: Evaluated, before: Sequence[Mapping[str, Any]]) -> RecordCheck:
    """The limits of the record on what was computed again."""
    key, limits = str(step["key"]), {}
    for one in step["limits"]:
        known = {name: one[name] for name in ("number", "at_least", "at_most")}
        known |= {name: one.get(name, "") for name in ("less", "over")}
        risk = 0.5 if one["highest_risk"] is None else one["highest_risk"]
        limit = Limit(rule=one["guard_band"], highest_risk=risk, **known)
        limits[replace(limit, highest_risk=0.5)] = limit
    steps = steps_by_name((one["key"], one["measurement"], one["result"] or {}) for one in before)
    decided = judged(again.result, again.document(), limits.values(), doubtful=step["doubtful"], steps=steps)
    now = [limit_document(one) for one in decided]
    then = {one["name"]: one["verdict"] for one in step["limits"]}
    after = {one["name"]: one["verdict"] for one in now}
    if then != after:
        names = [name for name in {**then, **after} if then.get(name) != after.get(name)]
        others = [f"{name} was {then.get(name)} and is {after.get(name)}" for name in names]
        return RecordCheck(key, False, f"judged again, {'; '.join(others)}")
    return RecordCheck(key, True, f"judged again, the verdict is the same: {step['verdict']}")


def _outcome(record: Mapping[str, Any]) -> RecordCheck:
    """Whether the verdict of all is that of the steps."""
    said, replaced = record["outcome"]["verdict"], replaced_steps(record)
    verdicts = [step["verdict"] for step in record["steps"] if step["name"] not in replaced]
    of_steps = worst(one for one in verdicts if one is not None)
    if record["outcome"]["failure"] is not None:
        return RecordCheck("record", said in ("ERROR", "ABORTED"), f"the test did not come to its end: {said}")
    return RecordCheck("record", said == of_steps, f"its verdict is {said}, that of its steps {of_steps}")
