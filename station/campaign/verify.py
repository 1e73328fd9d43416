"""Proving that a record of a test and its raw runs belong together, and that the result follows from them."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from station.campaign.record import (
    CONTENT,
    NAME,
    RECORD_FILE,
    VERSION,
    content_sha256,
    file_sha256,
    limit_document,
    records_sha256,
    replaced_steps,
)
from station.errors import StationError, UsageError, one_line
from station.measurements import steps_by_name
from station.results.verdict import Limit, judged, worst
from station.runs.store import SavedRun, open_run
from station.shell.finish import Evaluated, evaluate_run

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
            found += _step(step, file.parent, record["steps"][:place])
        found.append(_outcome(record))
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        found.append(
            RecordCheck("record", False, f"it is not laid out as a record is ({type(error).__name__}: {error})")
        )
    return found


def _step(step: Mapping[str, Any], folder: Path, before: Sequence[Mapping[str, Any]]) -> Iterator[RecordCheck]:
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
