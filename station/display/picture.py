"""How things stand as a picture for a terminal of any width: for the live display and for `gyrolock status`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from station.display.plot import plot
from station.display.sentences import duration, link_words, run_name
from station.events.situation import Situation
from station.terminal.visible import visible

_WIDE = 130
_GROUPS = 12
_STEPS = 8
_LINES_BELOW = 10  # beside plot and groups: the head, and what stands below
_STATES = {"PASS": "green", "FAIL": "bold red", "MARGINAL": "yellow", "ERROR": "bold magenta", "now": "bold cyan"}
_NAMES = {
    "lock_in_rate_dps": "lock-in rate",
    "beat_frequency_hz": "beat",
    "ratio": "r",
    "rate_dps": "rate",
    "output_counts": "output",
    "two_pi_voltage_v": "V_2π",
    "step_height_v": "step",
    "step_time_s": "every",
}


def picture(situation: Situation, width: int, height: int) -> RenderableType:
    """Return how things stand, within so many characters and lines."""
    parts: list[RenderableType] = [_head(situation, width)]
    taken = _LINES_BELOW
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
        drawn = Panel(
            _plot(trace, across, down), title=_of_value(situation.value), title_align="left", border_style="dim"
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


def _plot(trace: Mapping[str, Any], width: int, height: int) -> Group:
    samples, fit = trace.get("samples") or [], trace.get("fit") or []
    unit, seconds = str(trace.get("unit") or ""), float(trace.get("seconds") or 0)
    return Group(*plot(samples, fit, width, height, unit=unit, seconds=seconds))


def _of_value(value: Mapping[str, Any]) -> Text:
    said = [visible(str(value.get("key")))]
    said += [f"{_NAMES.get(one['name'], one['name'])} {one['text']}".strip() for one in value.get("values", ())]
    flags = ", ".join(value.get("flags") or ())
    return Text(" · ".join([*said, *([flags] if flags else [])]), style="yellow" if flags else "")


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
        done, total = int(counted.get("done") or 0), int(counted["total"])
        cells = max(min(width - 46, 60), 8)
        filled = cells * min(done, total) // total
        bar = Text("━" * filled, style="green").append("─" * (cells - filled), style="dim")
        left = counted.get("left_s")
        said = f" {done}/{total}" + (f", {duration(left)} left" if left is not None and done < total else "")
        table.add_row(visible(str(counted["what"])), bar.append(said))
    if situation.waiting:
        table.add_row("waiting", _waiting(situation.waiting))
    if situation.conditions:
        known = (f"{name.replace('_', ' ')} {value}" for name, value in situation.conditions.items())
        table.add_row("conditions", visible(", ".join(known)))
    if situation.run:
        link, clean = link_words(situation.link), not situation.link or situation.link.get("text") == "no faults"
        table.add_row("link", Text(link if clean else f"{link}, all recovered", style="" if clean else "yellow"))
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
