"""The record of a test as JUnit XML, for Jenkins, GitLab and whatever else reads test results."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from typing import Any

# XML 1.0 has no place for these, not even written as numbers
_NOT_IN_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


def junit_xml(record: Mapping[str, Any]) -> str:
    """Return the XML of a record of a test: a suite for each step, a case for each limit.

    A FAIL is a failure; MARGINAL is one too, of the type ``MARGINAL``: a reader that knows no third verdict must
    not take it for a pass. ERROR and ABORTED are errors, steps that were not begun are skipped.
    """
    root = ET.Element("testsuites", {"name": _text(f"{record['campaign']['name']}: {record['unit']['serial']}")})
    for step in record["steps"]:
        _suite(root, step, record)
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


def _suite(root: ET.Element, step: Mapping[str, Any], record: Mapping[str, Any]) -> None:
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
    properties = ET.SubElement(suite, "properties")
    for name, value in known.items():
        if value is not None:
            ET.SubElement(properties, "property", {"name": name, "value": _text(str(value))})
    seconds = f"{step['elapsed_s']:.3f}"
    for place, limit in enumerate(step["limits"]):
        # the time of the step belongs to all of its limits together
        case = _case(suite, step["key"], limit["name"], seconds if place == 0 else "0")
        _say(case, limit["verdict"], limit["sentence"])
    broken = step["failure"] is not None
    if broken or not step["limits"]:
        case = _case(suite, step["key"], "measurement", "0" if step["limits"] else seconds)
        _say(case, step["verdict"] if broken else None, step["message"] or "")
    _count(suite)
    if step["remarks"]:
        ET.SubElement(suite, "system-out").text = _text("\n".join(step["remarks"]))


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
    return _NOT_IN_XML.sub("\N{REPLACEMENT CHARACTER}", text)
