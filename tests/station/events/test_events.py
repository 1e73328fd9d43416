"""Events: told in order, in one form, to readers that may break; lines of JSON to whoever takes them."""

import json
import math
import os
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.errors import UsageError
from station.live.events import KINDS, SCHEMA, Event, EventLines, Events, Progress, open_lines
from station.live.preview import Preview, Watcher
from station.live.status import Situation
from station.runs.store import NewRecord


def told(events: Events) -> list[Event]:
    """What is emitted from here on."""
    heard: list[Event] = []
    events.read_by(heard.append)
    return heard


def test_a_reader_that_breaks_is_not_asked_again_and_the_others_hear_all() -> None:
    events, asked = Events(), []

    def broken(event: Event) -> None:
        asked.append(event)
        raise RuntimeError("the screen has gone")

    events.read_by(broken)
    heard = told(events)
    for text in ("one", "two"):
        events.emit("note", text=text)
    assert [event.facts["text"] for event in heard] == ["one", "two"]
    assert [event.counter for event in heard] == [1, 2]
    assert len(asked) == 1


def test_ctrl_c_within_a_reader_still_ends_the_program() -> None:
    events = Events()

    def pressed(event: Event) -> None:
        raise KeyboardInterrupt

    events.read_by(pressed)
    with pytest.raises(KeyboardInterrupt):
        events.emit("note", text="")


def test_an_event_is_one_line_of_plain_json() -> None:
    events = Events()
    heard = told(events)
    events.emit("value", values=[{"value": math.nan}], trace={"samples": np.arange(2.0)}, key="a\nb")
    [line] = heard[0].line().splitlines()
    document = json.loads(line)
    assert (document["schema"], document["event"]) == (SCHEMA, "value")
    assert document["values"] == [{"value": None}]
    assert document["trace"]["samples"] == [0.0, 1.0]


def test_many_threads_tell_in_one_order() -> None:
    events = Events()
    heard = told(events)
    threads = [threading.Thread(target=emitted, args=(events, 200)) for _ in range(4)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert [event.counter for event in heard] == list(range(1, 801))


def emitted(events: Events, count: int, text: str = "x" * 200) -> None:
    for _ in range(count):
        events.emit("note", text=text)


def test_lines_go_to_a_file_and_are_added_to_it(tmp_path: Path) -> None:
    for _ in range(2):
        events, lines = Events(), open_lines(str(tmp_path / "events.ndjson"))
        events.read_by(lines)
        emitted(events, 3)
        lines.close()
    written = [json.loads(line) for line in (tmp_path / "events.ndjson").read_text().splitlines()]
    assert [one["counter"] for one in written] == [1, 2, 3, 1, 2, 3]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes are POSIX")
def test_a_reader_that_sleeps_costs_lines_and_no_time(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    events, lines = Events(), open_lines(str(pipe))
    events.read_by(lines)
    emitted(events, 5000)  # a megabyte and more: far beyond a pipe and what is kept
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    heard = b""
    while len(piece := os.read(reader, 1 << 16)) == 1 << 16:
        heard += piece
        emitted(events, 1)
    heard += piece
    emitted(events, 1, "the last")
    while True:
        try:
            heard += os.read(reader, 1 << 16)
        except BlockingIOError:
            break
        emitted(events, 0)
    lines.close()
    heard += os.read(reader, 1 << 20)
    os.close(reader)
    documents = [json.loads(line) for line in heard.decode().splitlines()]
    counters = [one["counter"] for one in documents if one["event"] == "note"]
    assert counters == sorted(counters)
    lost = sum(one["count"] for one in documents if one["event"] == "lost")
    assert lost > 3000
    assert len(counters) + lost == counters[-1]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="/dev/full is Linux")
def test_a_full_disk_ends_the_lines_and_nothing_else() -> None:
    events, lines = Events(), EventLines(os.open("/dev/full", os.O_WRONLY))
    heard = told(events)
    events.read_by(lines)
    emitted(events, 10)
    lines.close()
    assert len(heard) == 10
    assert (lines.lost, lines.error) == (10, "No space left on device")


def test_a_reader_that_has_gone_ends_the_lines(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    lines = open_lines(str(writer))
    os.close(writer)
    os.close(reader)
    events = Events()
    events.read_by(lines)
    emitted(events, 3)
    lines.close()
    assert lines.error == "Broken pipe"


@pytest.mark.parametrize("target", ["nowhere/events", "/", "1", "987"])
def test_where_nothing_can_be_written_is_told_at_once(target: str) -> None:
    with pytest.raises(UsageError, match="--events"):
        open_lines(target)


def test_a_descriptor_for_reading_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with (tmp_path / "file").open() as file, pytest.raises(UsageError, match="not open for writing"):
        open_lines(str(file.fileno()))


def record(key: str) -> NewRecord:
    return NewRecord(key, "measure", "", b"", {})


def test_records_are_fitted_beside_the_measurement_and_a_bad_one_spoils_its_own_line() -> None:
    events = Events()
    heard = told(events)

    def see(records: Any) -> Preview | None:
        if records[0].key == "bad":
            raise ValueError("no beat\nat all")
        return None if records[0].key == "not shown" else Preview(records[0].key, "group", ())

    watcher = Watcher(events, see)
    for key in ("1", "bad", "not shown", "2"):
        watcher([record(key)])
    watcher.close()
    assert [(event.facts["key"], event.facts.get("problem")) for event in heard] == [
        ("1", None),
        ("bad", "no beat at all"),
        ("2", None),
    ]


def test_a_situation_survives_json() -> None:
    events, situation = Events(), Situation()
    events.read_by(situation.take)
    progress = Progress(events)
    events.emit("program", command="station", unit="7")
    events.emit("campaign_begun", campaign="c", unit="7", steps=["a", "b"], of=2)
    events.emit("step_begun", step="a", number=1, of=2)
    events.emit("run", run="runs/1/run.sqlite", records=3)
    progress.start("records", 4)
    events.emit("record", run="r", number=4, key="k", purpose="measure", conditions={})
    progress.advance()
    events.emit("step_ended", step="a", number=1, verdict="FAIL")
    events.emit("from a later version", anything=1)
    assert situation.records == 4
    assert (situation.counted["done"], situation.counted["total"]) == (1, 4)
    assert [one["state"] for one in situation.steps] == ["FAIL", "to come"]
    again = Situation.of_json(json.loads(json.dumps(situation.as_json())))
    assert again == situation
    assert Situation.of_json({"records": "many", "run": []}) == Situation()


def test_every_kind_that_is_emitted_is_described() -> None:
    """With the names of its facts: what is written down is what a program may rely on."""
    import ast

    root = Path(__file__).parents[3] / "station"
    emitted = {}
    for path in root.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "emit" and node.args:
                if not isinstance(kind := getattr(node.args[0], "value", None), str):
                    continue  # a handler of the log
                emitted.setdefault(kind, set()).update(one.arg for one in node.keywords if one.arg)
    assert set(emitted) == set(KINDS) - {"lost"}
    described = {kind: set(names.split()) for kind, (names, _) in KINDS.items()}
    unknown = {kind: names - described[kind] for kind, names in emitted.items() if "*" not in described[kind]}
    assert {kind: names for kind, names in unknown.items() if names} == {}
