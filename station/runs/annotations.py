"""What is said of a run afterwards: notes, tags, a good or bad mark; who said it, and when.

It stands beside the run in a text file of its own, one JSON object a line, which is only ever added to. The run's
file is not opened for it: a measurement stays what it was, byte for byte.
"""

import getpass
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from station.errors import CannotWrite, RunError, UsageError
from station.runs.database import utc_now

SCHEMA = {"name": "gyrolock remark", "version": 1}
_MARKS = ("good", "bad", None)


@dataclass(frozen=True)
class Remark:
    """One thing that was said of a run."""

    at: str  # UTC, ISO 8601
    by: str  # who said it
    note: str = ""  # empty where only tags or the mark were changed
    tags: tuple[str, ...] = ()  # that were added, and taken away
    untagged: tuple[str, ...] = ()
    # {"good", "bad", None, ""}: ``None`` takes the mark away, the empty text leaves it as it is
    mark: str | None = ""

    @property
    def words(self) -> str:
        """What was said, in one line for a person."""
        marked = {"": "", None: "mark taken away"}.get(self.mark, f"marked {self.mark}")
        tags = [*(f"+{tag}" for tag in self.tags), *(f"-{tag}" for tag in self.untagged)]
        return "; ".join(filter(None, [marked, " ".join(tags), self.note]))

    def as_json(self) -> dict[str, Any]:
        """Return the line of the file as a plain object; what says nothing is left out."""
        said: dict[str, Any] = {"schema": SCHEMA, "at": self.at, "by": self.by}
        said |= {"note": self.note} if self.note else {}
        said |= {"tags": list(self.tags)} if self.tags else {}
        said |= {"untagged": list(self.untagged)} if self.untagged else {}
        return said | ({} if self.mark == "" else {"mark": self.mark})


@dataclass(frozen=True)
class Remarks:
    """All that was said of a run."""

    said: tuple[Remark, ...] = ()  # the oldest first
    unreadable: int = 0  # lines of the file that are none: cut by a power failure, or of somebody else

    @property
    def last_mark(self) -> Remark | None:
        """The remark that marked it last, or took its mark away."""
        return next((remark for remark in reversed(self.said) if remark.mark != ""), None)

    @property
    def mark(self) -> str | None:
        """``"good"``, ``"bad"`` or ``None``: the last word counts."""
        return None if self.last_mark is None else self.last_mark.mark

    @property
    def tags(self) -> tuple[str, ...]:
        """Those that were added and not taken away, in the order in which they came."""
        held: dict[str, None] = {}
        for remark in self.said:
            held |= dict.fromkeys(remark.tags)
            for tag in remark.untagged:
                held.pop(tag, None)
        return tuple(held)

    @property
    def notes(self) -> tuple[Remark, ...]:
        """Remarks that hold a note."""
        return tuple(remark for remark in self.said if remark.note)


def remarks_file(run: Path) -> Path:
    """Return where the remarks on a run stand; `run` is its SQLite file."""
    return run.with_suffix(".remarks.jsonl")


def read_remarks(run: Path) -> Remarks:
    """Return what was said of a run; `run` is its SQLite file."""
    file = remarks_file(run)
    try:
        lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
    except FileNotFoundError:
        return Remarks()
    except OSError as error:
        raise RunError(f"{file}: the remarks cannot be read ({error.strerror or error})") from None
    said, unreadable = [], 0
    for line in lines:
        if not line.strip():
            continue
        try:
            said.append(_remark(json.loads(line)))
        except (ValueError, TypeError, KeyError, RecursionError):
            unreadable += 1
        except NotImplementedError as error:
            raise RunError(f"{file}: was written by a newer gyrolock ({error}): update this one") from None
    return Remarks(tuple(said), unreadable)


def add_remark(
    run: Path,
    *,
    note: str = "",
    tags: Sequence[str] = (),
    untagged: Sequence[str] = (),
    mark: str | None = "",
    by: str = "",
) -> Remark:
    """Say something of a run; when this returns, it is on the disk."""
    if not (note.strip() or tags or untagged or mark != ""):
        raise UsageError("nothing is said of the run: give a note, a tag or a mark")
    for tag in (*tags, *untagged):
        if not tag or any(letter.isspace() or letter == "," for letter in tag):
            raise UsageError(f"the tag {tag!r} is no single word: write it without blanks and commas")
    remark = Remark(utc_now(), " ".join(by.split()) or _user(), note.strip(), tuple(tags), tuple(untagged), mark)
    file = remarks_file(run)
    line = f"{json.dumps(remark.as_json(), ensure_ascii=False)}\n".encode()
    try:
        # one write at the end of the file: two who say something at the same time both stand there
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o666)
        try:
            os.write(descriptor, _after_torn_line(descriptor) + line)
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise CannotWrite(f"{file}: the remark is not saved ({error.strerror or error})") from None
    return remark


def _after_torn_line(descriptor: int) -> bytes:
    """An end of line where the last one has none, because the power failed."""
    size = os.fstat(descriptor).st_size
    if size == 0:
        return b""
    os.lseek(descriptor, size - 1, os.SEEK_SET)
    return b"" if os.read(descriptor, 1) == b"\n" else b"\n"


def _remark(line: Mapping[str, Any]) -> Remark:
    schema = line["schema"]
    if schema["name"] != SCHEMA["name"]:
        raise ValueError("is no remark")
    if schema["version"] != SCHEMA["version"]:
        raise NotImplementedError(f"remarks of version {schema['version']}")
    mark = line.get("mark", "")
    if mark not in (*_MARKS, ""):
        raise ValueError("is no mark")
    at, by, note = (str(line.get(name, "")) for name in ("at", "by", "note"))
    tags, untagged = (tuple(map(str, line.get(name, ()))) for name in ("tags", "untagged"))
    return Remark(at, by, note, tags, untagged, mark)


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):  # a process without a name in the system's list
        return "unknown"
