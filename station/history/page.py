"""The index of all tested units as a page: what became of each, and the control charts."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from station.history.charts import Course, course_svg
from station.history.past_tests import PastTest
from station.provenance import version
from station.report.page import render_page, write_page
from station.results.parts import PlacedFigure, Section

INDEX_FILE = "index.html"
_STATES = {"PASS": "good", "MARGINAL": "doubtful", "FAIL": "bad", "ERROR": "bad", "ABORTED": "bad"}


def write_index(
    directory: Path, tests: Sequence[PastTest], courses: Sequence[Course], path: Path | None = None
) -> Path:
    """Write the page, by default ``index.html`` in the folder of the tests; OSError if it cannot be written."""
    return write_page(path or directory / INDEX_FILE, render_index(path or directory / INDEX_FILE, tests, courses))


def render_index(path: Path, tests: Sequence[PastTest], courses: Sequence[Course]) -> str:
    """Return the page as HTML; its links start from `path`."""
    newest: dict[str, PastTest] = {one.unit: one for one in tests}
    counted = {verdict: sum(one.verdict == verdict for one in newest.values()) for verdict in _STATES}
    summary = ", ".join(f"{count} {verdict}" for verdict, count in counted.items() if count)
    units = "unit" if len(newest) == 1 else "units"
    rows = [
        {
            "at": one.at[:16].replace("T", " "),
            "unit": one.unit,
            "type": f"{one.unit_type}{', reference' if one.is_reference else ''}",
            "verdict": one.verdict or "measured",
            "state": _STATES.get(one.verdict or "", "good"),
            "message": one.message,
            "link": Path(os.path.relpath(one.page, path.parent)).as_posix(),
            "simulated": one.simulated,
        }
        for one in reversed(tests)
    ]
    sections = [
        Section(
            f"{course.of}: {course.name}",
            figures=(PlacedFigure(course_svg(course, f"chart{place}"), _CAPTION),),
            sentences=tuple(course.sentences),
        )
        for place, course in enumerate(courses)
    ]
    return render_page(
        "history.html.j2",
        version=version("gyrolock"),
        summary=f"{len(newest)} {units}: {summary}" if newest else "No unit was tested yet.",
        rows=rows,
        sections=sections,
        footer=f"Made by gyrolock {version('gyrolock')} from the records of {len(tests)} tests.",
    )


_CAPTION = (
    "Above the values with their standard uncertainty, below the distance of each from the one before. Lines at "
    "1, 2 and 3 sigma; a square marks what the rules of Western Electric call out of control."
)
