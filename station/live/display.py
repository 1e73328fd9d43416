"""The live display: picture, curve of dots, drawn anew on one terminal while it is measured."""

import itertools
import math
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from datetime import UTC, datetime
from typing import Any, Self

from rich.console import Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from station.live.console import PlainConsole, campaign_line, duration, link_words, run_name
from station.live.events import Event
from station.live.status import Situation
from station.results.numbers import BEAT_FREQUENCY, LOCK_IN_RATE, TWO_PI_VOLTAGE
from station.terminal import stepping_aside, visible

_LOST = (OSError, ValueError)
_EVERY_S = 0.15
_TICK_S = 1.0  # a time that runs out is shown also while nothing happens


class LiveDisplay:
    """Draws how things stand on stderr; notes go above the drawing and stay. A context manager."""

    def __init__(self) -> None:
        self._console = PlainConsole(stderr=True)
        self._situation = Situation()
        self._live: Live | None = None
        self._drawn_at = 0.0
        self._lock = threading.RLock()
        self._ended = threading.Event()
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        self._stack.enter_context(stepping_aside(lambda question: self._hide(), self._show))
        threading.Thread(target=self._tick, name="display", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._hide()
        self._stack.close()

    def __call__(self, event: Event) -> None:
        """Take an event."""
        with self._lock:
            self._situation.take(event)
            if event.kind == "note":
                self._say(str(event.facts["text"]), "dim")
            elif line := campaign_line(event.kind, event.facts):
                self._say(line, None)
            if event.kind in ("run_ended", "ended"):  # what comes then is the result, on the same terminal
                self._hide()
            elif event.kind in ("run", "counting", "campaign_begun"):
                self._show()
            elif time.monotonic() - self._drawn_at > _EVERY_S:
                self._draw()

    def _say(self, text: str, style: str | None) -> None:
        with suppress(*_LOST):
            self._console.print(text, style=style, soft_wrap=True)  # a path is copied as a whole

    def _show(self) -> None:
        with self._lock, suppress(*_LOST):
            if (
                self._live is None
                and not self._ended.is_set()
                and (self._situation.run or self._situation.counted)
            ):
                # stdout keeps its own way: it belongs to the result
                live = Live(
                    console=self._console,
                    auto_refresh=False,
                    transient=True,
                    redirect_stdout=False,
                    redirect_stderr=False,
                )
                live.start()
                self._live = live
            self._draw()

    def _hide(self) -> None:
        with self._lock, suppress(*_LOST):
            live, self._live = self._live, None
            if live is not None:
                live.stop()

    def _draw(self) -> None:
        if self._live is None:
            return
        self._drawn_at = time.monotonic()
        with suppress(*_LOST):
            width, height = self._console.size
            self._live.update(picture(self._situation, width, height), refresh=True)

    def _tick(self) -> None:
        while not self._ended.wait(_TICK_S):
            with suppress(Exception), self._lock:
                self._draw()


# --------------------
# How things stand as a picture for a terminal of any width: for the live display and for `gyrolock status`


_WIDE = 130
_GROUPS = 12
_STEPS = 8
_LINES_BELOW = 10  # beside plot and groups: the head, and what stands below
_STATES = {"PASS": "green", "FAIL": "bold red", "MARGINAL": "yellow", "ERROR": "bold magenta", "now": "bold cyan"}
_NAMES = {
    LOCK_IN_RATE.key(): "lock-in rate",
    BEAT_FREQUENCY.key(): "beat",
    "ratio": "r",
    "rate_dps": "rate",
    "output_counts": "output",
    TWO_PI_VOLTAGE.key(): "V_2π",
    "step_height_v": "step",
    "step_time_s": "every",
}


def picture(situation: Situation, width: int, height: int) -> RenderableType:
    """Return how things stand, within so many characters and lines."""
    parts: list[RenderableType] = [_head(situation, width)]
    taken = _LINES_BELOW
    if situation.link.get("down"):  # before anything that stands still meanwhile
        since = duration(age_s(str(situation.link.get("at"))))
        last = f": {situation.notes[-1]}" if situation.notes else ""
        text = Text(visible(f"LINK DOWN for {since}{last}"), style="bold red", no_wrap=True, overflow="ellipsis")
        parts.append(text)
        taken += 1
    if situation.steps:
        steps = _steps(situation)
        parts.append(steps)
        taken += len(steps.plain) // width + 2  # words are not broken
    trace = situation.value.get("trace")
    wide = width >= _WIDE
    room = max(height - taken, 0)
    if trace:
        across = width // 2 - 4 if wide else width - 4
        down = min(max(room - (0 if wide else min(len(situation.groups), _GROUPS) + 3), 5), 16 if wide else 11)
        samples, fit = trace.get("samples") or [], trace.get("fit") or []
        unit, seconds = str(trace.get("unit") or ""), float(trace.get("seconds") or 0)
        curve = Group(*plot(samples, fit, across, down, unit=unit, seconds=seconds))
        said = [visible(str(situation.value.get("key")))]
        said += [
            f"{_NAMES.get(one['name'], one['name'])} {one['text']}".strip()
            for one in situation.value.get("values", ())
        ]
        flags = ", ".join(situation.value.get("flags") or ())
        drawn = Panel(
            curve,
            title=Text(" · ".join([*said, *([flags] if flags else [])]), style="yellow" if flags else ""),
            title_align="left",
            border_style="dim",
        )
        groups = _groups(
            situation.groups, min(_GROUPS, max(room - 4, 3)) if wide else min(_GROUPS, max(room - down - 4, 3))
        )
        if wide and groups is not None:
            side = Table.grid(padding=(0, 2, 0, 0))
            side.add_row(drawn, groups)
            parts.append(side)
        else:
            parts += [drawn, *([groups] if groups is not None else [])]
    parts += _numbers(situation, width)
    return Group(*parts)


def _head(situation: Situation, width: int) -> Text:
    program, run = situation.program, situation.run
    named = [str(program.get("command") or "gyrolock")]
    for name in ("unit", "operator"):
        if program.get(name):
            named.append(f"{name} {program[name]}")
    if run.get("instrument"):
        named.append(str(run["instrument"]))
    if run.get("simulated"):
        named.append("simulated bench")
    if run:
        named.append(f"run {run_name(run)}")
    text = Text(visible(" · ".join(named)), style="bold", no_wrap=True, overflow="ellipsis")
    text.truncate(width, overflow="ellipsis")
    return text


def _steps(situation: Situation) -> Text:
    """Every step with its state; of many the one that is carried out, and how many have ended how."""
    text, steps = Text(), situation.steps
    if len(steps) > _STEPS:
        now = next((place for place, step in enumerate(steps, start=1) if step["state"] == "now"), 0)
        if now:
            text.append(f"{now} of {len(steps)} {visible(str(steps[now - 1]['step']))}", style=_STATES["now"])
        for state in dict.fromkeys(str(step["state"]) for step in steps):
            if state not in ("now", "to come"):
                count = sum(step["state"] == state for step in steps)
                text.append(f"  {count} {state}", style=_STATES.get(state, "dim"))
        return text
    for place, step in enumerate(steps):
        state = str(step["state"])
        said = "" if state in ("now", "to come") else f" {state}"
        before = ("  " if place else "") + ("▸ " if state == "now" else "")
        text.append(f"{before}{visible(str(step['step']))}{said}", style=_STATES.get(state, "dim"))
    return text


def _groups(groups: Mapping[str, Sequence[Mapping[str, Any]]], shown: int) -> Table | None:
    """What the records of each group say together; the last ones, if there are many."""
    if not groups:
        return None
    table = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    first = next(iter(groups.values()))
    for name in ("", "records", *(_NAMES.get(one["name"], one["name"]) for one in first)):
        table.add_column(name, justify="right" if name else "left", no_wrap=True)
    left_out = len(groups) - shown
    for name, values in list(groups.items())[-shown:]:
        table.add_row(visible(name), str(values[0]["records"]), *(one["text"] for one in values))
    if left_out > 0:
        table.caption, table.caption_justify = f"and {left_out} before", "left"
    return table


def _numbers(situation: Situation, width: int) -> list[RenderableType]:
    lines: list[RenderableType] = []
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    for one in situation.value.get("so_far") or ():
        count = f"{one['records']} record{'' if one['records'] == 1 else 's'}"
        said = f"{one['text']} from {count}; u of the noise alone"
        table.add_row("so far", Text(said, style="bold"))
    if situation.result:
        table.add_row(
            str(situation.result.get("name")), Text(visible(str(situation.result.get("value"))), style="bold")
        )
    counted = situation.counted
    if counted.get("total"):
        all_done, all_total = counted.get("all_done"), counted.get("all_total")
        done, total = int(all_done or counted.get("done") or 0), int(all_total or counted["total"])
        cells = max(min(width - 46, 60), 8)
        filled = cells * min(done, total) // total
        bar = Text("━" * filled, style="green").append("─" * (cells - filled), style="dim")
        left = counted.get("all_left_s", counted.get("left_s"))
        going = left is not None and done < total and not situation.link.get("down")
        said = f" {done}/{total}" + (f", {duration(left or 0)} left" if going else "")
        table.add_row(visible(str(counted["what"])), bar.append(said))
    if situation.waiting:
        table.add_row("waiting", _waiting(situation.waiting))
    if situation.conditions:
        known = (f"{name.replace('_', ' ')} {value}" for name, value in situation.conditions.items())
        table.add_row("conditions", visible(", ".join(known)))
    if situation.run and not situation.link.get("down"):
        link, clean = link_words(situation.link), not situation.link or situation.link.get("text") == "no faults"
        table.add_row("link", Text(link if clean else f"{link}, all recovered", style="" if clean else "yellow"))
    if situation.run:
        table.add_row("saved", f"{situation.records} records, every one on the disk")
    if situation.notes:
        table.add_row("last", Text(visible(situation.notes[-1]), no_wrap=True, overflow="ellipsis"))
    return [*lines, table]


def _waiting(waiting: Mapping[str, Any]) -> str:
    seconds = waiting.get("seconds")
    if not seconds:
        return visible(str(waiting.get("what")))
    left = float(seconds) - age_s(str(waiting.get("at")))
    return visible(f"{waiting.get('what')}, {duration(left)} left")


def age_s(at: str) -> float:
    """Return the seconds since a time of an event; 0 for one that is none."""
    try:
        return (datetime.now(UTC) - datetime.fromisoformat(at)).total_seconds()
    except ValueError:
        return 0.0


# --------------------
# A curve of dots on a terminal: the samples of a record, and the fit through them


_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))  # of a Braille cell: four rows of two


def plot(
    samples: Sequence[float | None],
    fit: Sequence[float | None],
    width: int,
    height: int,
    *,
    unit: str,
    seconds: float,
) -> list[Text]:
    """Draw samples as dots and a fit as a line, with the ends of both axes."""
    known = [value for value in (*samples, *fit) if value is not None and math.isfinite(value)]
    if not known or width < 16 or height < 3:
        return [Text("no record to show", style="dim")]
    low, high = min(known), max(known)
    if low == high:
        low, high = low - 0.5, high + 0.5
    labels = [f"{high:.3g} {unit}", f"{low:.3g} {unit}"]
    margin = max(map(len, labels)) + 1
    columns, rows = width - margin, height - 1
    dots = dict(_cells(_spread(samples, low, high, columns, rows)))
    line = dict(_cells(_joined(_spread(fit, low, high, columns, rows))))
    lines = []
    for row in range(rows):
        label = labels[0] if row == 0 else labels[1] if row == rows - 1 else ""
        text = Text(f"{label:>{margin - 1}} ", style="dim")
        for column in range(columns):
            cell = (column, row)
            bits = dots.get(cell, 0) | line.get(cell, 0)
            style = "cyan" if cell in line else "yellow"
            text.append(chr(0x2800 + bits) if bits else " ", style=style)
        lines.append(text)
    scale, name = next(
        (s, n) for limit, s, n in ((2.0, 1.0, "s"), (2e-3, 1e3, "ms"), (0.0, 1e6, "µs")) if seconds >= limit
    )
    end = f"{seconds * scale:.4g} {name}"
    lines.append(Text(f"{'':{margin}}0{end:>{columns - 1}}", style="dim"))
    return lines


def _spread(
    values: Sequence[float | None], low: float, high: float, columns: int, rows: int
) -> list[tuple[int, int]]:
    """Dots of a picture of so many characters: two across and four down in each."""
    across, down = 2 * columns - 1, 4 * rows - 1
    last = max(len(values) - 1, 1)
    return [
        (round(place / last * across), round((high - value) / (high - low) * down))
        for place, value in enumerate(values)
        if value is not None and math.isfinite(value)
    ]


def _joined(dots: Sequence[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """The dots, and those between neighbours: a line."""
    for (x, y), (to_x, to_y) in itertools.pairwise(dots):
        steps = max(abs(to_x - x), abs(to_y - y), 1)
        for step in range(steps + 1):
            yield round(x + (to_x - x) * step / steps), round(y + (to_y - y) * step / steps)


def _cells(dots: Iterator[tuple[int, int]] | Sequence[tuple[int, int]]) -> Iterator[tuple[tuple[int, int], int]]:
    """Characters with the dots that are set in each, every character once."""
    cells: dict[tuple[int, int], int] = {}
    for x, y in dots:
        cell = (x // 2, y // 4)
        cells[cell] = cells.get(cell, 0) | _DOTS[y % 4][x % 2]
    yield from cells.items()
