"""A result shown: as one self-contained HTML file, and on the terminal."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from rich.table import Table
from rich.text import Text

from station.errors import DAMAGE, RunError
from station.files import version
from station.live.console import stdout_console
from station.results.numbers import SCALE_FACTOR
from station.results.result import FactTable, Result, Rows, Section
from station.results.verdict import MARGINAL, LimitOutcome, worst
from station.runs.annotations import Remark, Remarks, read_remarks
from station.runs.database import RunFacts
from station.runs.store import REPORT_FILE, SavedRun
from station.terminal import PRINTS_ALL, PRINTS_ONE_LINE, prints, say, visible

if TYPE_CHECKING:
    from station.results.result import TextTable


class Shown(Protocol):
    """A run and what it says, as report and terminal need it."""

    @property
    def heading(self) -> str:
        """What was measured, and of which gyro."""

    @property
    def run(self) -> SavedRun:
        """The run itself."""

    @property
    def result(self) -> Result:
        """Values and sentences."""

    @property
    def tested(self) -> Sequence[LimitOutcome]:
        """Values against their limits."""

    @property
    def verdict(self) -> str | None:
        """``"PASS"``, ``"FAIL"`` or, without limits, ``None``."""

    def sections(self) -> list[Section]:
        """Figures and tables."""

    def fact_tables(self) -> list[FactTable]:
        """Settings and conditions."""


def write_report(evaluated: Shown, path: Path | None = None) -> Path:
    """Write the report of a run."""
    return write_page(path or evaluated.run.path.parent / REPORT_FILE, render_report(evaluated))


def render_report(evaluated: Shown) -> str:
    """Return the report as HTML text."""
    facts, result = evaluated.run.facts, evaluated.result
    tables: list[FactTable] = []
    for part in (evaluated.fact_tables, lambda: _common_tables(evaluated)):
        try:
            tables += part()
        except DAMAGE as error:
            if evaluated.run.protected and not evaluated.run.damaged:
                raise
            tables.append(FactTable("Damaged", [("unreadable", f"{type(error).__name__}: {error}")]))
    tables = [table for table in tables if table.rows]
    middle = (len(tables) + 1) // 2
    sections = evaluated.sections()
    if result.to_watch:
        sections = [*sections, Section("What to watch", sentences=result.to_watch)]
    folder = evaluated.run.path.parent.name
    try:
        remarks = read_remarks(evaluated.run.path)
    except RunError as error:
        remarks = Remarks((Remark(at="", by="", note=str(error)),))
    if remarks.said:
        said = [f"{_time_of_day(one.at)}, {one.by}: {one.words}" if one.at else one.words for one in remarks.said]
        lost = [f"{remarks.unreadable} lines of its remarks cannot be read."] if remarks.unreadable else []
        sections = [Section("Said of it afterwards", sentences=(*said, *lost)), *sections]
    state = "good" if result.standing.state == "stands" and evaluated.verdict != MARGINAL else "doubtful"
    if result.standing.state == "fails" or evaluated.verdict in ("FAIL", "ERROR"):
        state = "bad"
    return render_page(
        "report.html.j2",
        title=", ".join(filter(None, (evaluated.heading, facts.started_at[:10]))),
        heading=evaluated.heading,
        version=version("gyrolock"),
        simulated=facts.simulated,
        state=state,  # colour of the box
        value=f"{evaluated.verdict} · {result.value}" if evaluated.verdict else result.value,
        lines=(*result.lines, *(f"{one.sentence}." for one in evaluated.tested)),
        reasons=[reason for reason in result.standing.reasons if reason != result.problem],  # that stands above
        labels=[("quality", result.quality.partition(":")[0]), *_labels(facts, remarks)],
        sections=sections,
        fact_columns=[tables[:middle], tables[middle:]],
        footer=f"Made by gyrolock {version('gyrolock')} from the saved records of {folder}. "
        f"`gyrolock analyze {folder}` computes the numbers again.",
    )


def _time_of_day(at: str) -> str:
    return f"{at[:16].replace('T', ' ')} UTC"


def _labels(facts: RunFacts, remarks: Remarks) -> Rows:
    """What a person looks for first: which unit, who, when, and whether somebody holds it for good or bad."""
    rows = [*facts.labels.items()]
    if (mark := remarks.last_mark) is not None and mark.mark:
        rows.append(("marked", f"{mark.mark}, by {mark.by}, {_time_of_day(mark.at)}"))
    if remarks.tags:
        rows.append(("tags", " ".join(remarks.tags)))
    if facts.started_at:
        rows.append(("taken", _time_of_day(facts.started_at)))
    if identity := facts.get("identity"):
        serial = identity.get("serial") or ""
        rows.append(("instrument", f"{identity.get('model', '')} {serial.strip('0') and serial}".strip()))
    if factor := (facts.get("settings") or {}).get("gyro", {}).get(SCALE_FACTOR.key()):
        rows.append(("K", f"{factor:.10g} pulses/deg"))
    if facts.resumed_at:
        rows.append(("resumed", f"{len(facts.resumed_at)} times" if len(facts.resumed_at) > 1 else "once"))
    return rows


def _common_tables(evaluated: Shown) -> list[FactTable]:
    facts = evaluated.run.facts
    truth = [(name.replace("_", " "), f"{value:.9g}") for name, value in (facts.truth or {}).items()]
    return [
        FactTable("Limits", [(one.name, one.sentence) for one in evaluated.tested]),
        FactTable("Truth of the simulation", truth),
        FactTable("Provenance", _provenance_rows(facts)),
    ]


def _provenance_rows(facts: RunFacts) -> Rows:
    if not facts.started_at:
        return []  # files of an oscilloscope
    rows = [("taken", f"{facts.started_at} to {facts.ended_at or 'unknown'}"), ("outcome", facts.outcome_text)]
    if facts.resumed_at:
        rows.insert(1, ("resumed", ", ".join(facts.resumed_at)))
    if made := facts.get("provenance"):
        rows += [
            ("gyrolock", f"{made['gyrolock']}{', source ' + made['git'] if made['git'] else ''}"),
            ("Python", f"{made['python']} on {made['platform']}"),
            ("packages", ", ".join(f"{name} {number}" for name, number in made["packages"].items())),
        ]
    if facts.simulated:
        rows.append(("seed", str(facts.settings["simulation"]["seed"])))
    return rows


# --------------------
# HTML pages from the templates of :mod:`station`, written whole or not at all


def render_page(template: str, **values: Any) -> str:
    """Fill a template; a value that it needs and is not given is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("station.report"),
        autoescape=True,
        undefined=StrictUndefined,
        # what acts without being seen becomes visible in text of others; what is HTML already is ours
        finalize=lambda value: visible(value) if type(value) is str else value,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(**values)


def write_page(path: Path, text: str) -> Path:
    """Write a page that appears under its name only when it is whole; OSError if it cannot be written."""
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with draft.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        with suppress(OSError):
            draft.unlink(missing_ok=True)
    return path


# --------------------
# A result on a terminal: tables, values, what they mean, what to watch, the verdict


_COLOURS = {"stands": "green", "doubtful": "yellow", "fails": "red"}


def text_table(table: TextTable, *, left: int = 0) -> Table:
    """Lay out a table of texts; numbers stand right, the first `left` columns and words left."""
    shown = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    for place, name in enumerate(table.header):
        words = place < left or name == "flags"
        shown.add_column(name, justify="left" if words else "right", no_wrap=not words)
    for row in table.rows:
        shown.add_row(*row)
    return shown


def print_result(evaluated: Shown) -> None:
    """Print what a run says: a short page, or with ``--full`` everything."""
    facts, result = evaluated.run.facts, evaluated.result
    if prints(PRINTS_ALL):
        rows = [*((name, text) for name, text in facts.labels.items())]
        if facts.resumed_at:
            rows.append(("resumed", ", ".join(facts.resumed_at)))
        if facts.simulated:
            known = (f"{name.replace('_', ' ')} {value:.9g}" for name, value in (facts.truth or {}).items())
            told = result.truth or ", ".join(known) or "no truth is saved"
            rows.append(("bench", f"simulated; {told}"))
        print_values(result, evaluated.tested, rows)
        return
    labels = [text if name == "unit" else f"{name} {text}" for name, text in facts.labels.items()]
    identity = facts.get("identity") or {}
    about = [*labels, _time_of_day(facts.started_at) if facts.started_at else "", identity.get("model", "")]
    if facts.simulated:
        about.append("simulated")
    print_values(result, evaluated.tested, [("taken", ", ".join(filter(None, about)))])


_MOST_ROWS, _MOST_LIMITS = 4, 3  # rows of a table, and limits, that a short page has room for


def print_values(result: Result, tested: Sequence[LimitOutcome], about: Rows = ()) -> None:
    """Print a result and its limits; `about` says what it is of."""
    if prints(PRINTS_ONE_LINE):
        # the first number of the short page
        name, text = next(iter(result.brief), (result.name, result.value))
        verdict = worst(one.verdict for one in tested)
        say(
            "; ".join(filter(None, ("" if result.problem else f"{name}: {text}", result.quality, verdict))),
            answer=True,
        )
        return
    console, full = stdout_console(), prints(PRINTS_ALL)
    short = () if result.brief else (table for table in result.tables if len(table.rows) <= _MOST_ROWS)
    for table in result.tables if full else short:
        console.print(text_table(table))
    rows = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    rows.add_column(style="dim", no_wrap=True)
    rows.add_column()
    style = f"bold {_COLOURS[result.standing.state]}"
    value = (result.name, result.value)
    if full:
        said = [("", ""), value, *result.summary, *about]
    else:
        quality = f"{result.quality}; {result.truth}" if result.truth else result.quality
        said = [*about, *(result.brief or (value, *result.summary)), ("quality", quality)]
    for name, text in said:
        rows.add_row(name, Text(visible(text), style=style if name in (result.name, "quality") else ""))
    console.print(rows)
    if full:
        for sentence in result.sentences:
            console.print(f"• {sentence}")
        shown = {*result.to_watch, result.problem}
        for sentence in (*result.to_watch, *(one for one in result.standing.reasons if one not in shown)):
            console.print(f"• {sentence}", style="red" if sentence in result.failures else "yellow")
    told = tested if full else sorted(tested, key=lambda one: one.passed)[:_MOST_LIMITS]
    for one in told:
        # the interval stands above already
        words = one.sentence if full else re.sub(r" \[[^]]*\]", "", one.sentence.partition("; ")[0])
        console.print(words, style="green" if one.passed else "yellow" if one.verdict == MARGINAL else "bold red")
    if more := len(tested) - len(told):
        console.print(f"and {more} more limit{'s' if more > 1 else ''}: --full")
