"""`python -m benchmarks.damage.fuzz_files`: damaged files at everything that reads one.

CSV and ISF files of an oscilloscope, logs of a fibre gyro, settings in TOML, and saved runs are changed at random:
bytes flipped, cut, doubled and put in, rows lost or repeated, numbers replaced by wild ones, brackets nested,
cells of a run's tables overwritten. Each file must give its result or a declared error, soon and in little memory.
``commands`` takes saved runs of every kind, spoils a page, a cell or a value inside one (also of layouts without
checksums), and gives them to commands.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import gzip
import importlib
import io
import json
import math
import random
import re
import resource
import shutil
import signal
import sqlite3
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from instrument import Preamble, Waveform, read_waveform
from instrument.fibre_gyro import read_gyro_log
from station import cli
from station.errors import describe_failure
from station.live.events import Progress
from station.measurements import MEASUREMENTS, measurement
from station.reanalysis.combine import analyze_file
from station.report.show import render_report
from station.runs.database import save_result
from station.runs.store import open_run
from station.settings import load, shipped_settings
from station.shell.finish import evaluate_run, start_run

COUNTS = {"csv": 5000, "isf": 5000, "logs": 100_000, "toml": 5000, "runs": 2000, "commands": 5000}
LONGEST_S = 20
"""Seconds after which a file counts as one that hangs; the slowest takes some tenths. A log has five."""
MEMORY = 300 << 20
"""Bytes that reading a file may take on top of the program."""
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_WILD = (
    *(b"1e400", b"-1e400", b"nan", b"inf", b"1e-320", b"0", b"-0.0", b"-1", b"1e308", b"9" * 400, b"9" * 5000),
    *(b"2147483648", b"9223372036854775808", b"0x" + b"f" * 5000, b"1_000", b"", b'"', b"true", b"[]"),
    b"\xff\xfe",
)
_INSERTED = (
    *(b"\x00", b"\r", b"\n", b",", b";", b"#", b'"', b"'", b"=", b"[", b"{", b"\x1b[2J", b"\xe2\x80\xae"),
    b"#9999999999",
    *(b"[" * 3000, b"{a=" * 3000, b"a." * 3000 + b"a=1\n", b"(" * 3000, b"1" * 10_000, b",,,,,,,,", b"\xff" * 64),
)  # fmt: skip


@dataclass
class Outcome:
    """What became of the files of one kind."""

    files: int = 0
    read: int = 0
    """So many gave a result."""
    longest_s: float = 0.0
    errors: Counter[str] = field(default_factory=Counter)
    """Declared ones, by their class."""
    failures: list[str] = field(default_factory=list)
    """Undeclared exceptions, hangs, and files that took too much memory."""


def mutated(content: bytes, source: random.Random) -> bytes:
    """Return a content with one to five changes."""
    for _ in range(source.randint(1, 5)):
        kind, place = source.randrange(7), source.randrange(len(content) + 1)
        length = source.choice((1, 1, 2, 7, 100, 5000))
        if kind == 0 and content:
            place = min(place, len(content) - 1)
            content = content[:place] + bytes([content[place] ^ 1 << source.randrange(8)]) + content[place + 1 :]
        elif kind == 1:
            content = content[:place] + content[place + length :]
        elif kind == 2:
            content = content[:place] + content[place : place + length] * 2 + content[place + length :]
        elif kind == 3:
            content = content[:place] + source.choice(_INSERTED) + content[place:]
        elif kind == 4:
            content = content[:place] + source.randbytes(length) + content[place + length :]
        elif kind == 5:
            # the numbers that say how the others are read stand at the beginning
            numbers = list(_NUMBER.finditer(content[:3000]))
            if numbers:
                first, last = source.choice(numbers).span()
                content = content[:first] + source.choice(_WILD) + content[last:]
        elif source.random() < 0.1:
            content = content[:place]
    return content


def spoil_cell(path: Path, source: random.Random) -> None:
    """Overwrite one cell of a run's tables by something of another kind."""
    with closing(sqlite3.connect(path)) as db, db:
        table = source.choice(("record", "record", "run", "result"))
        columns = [row[1] for row in db.execute(f"PRAGMA table_info({table})")]
        column = source.choice([name for name in columns if name != "number"])
        keys = db.execute(f"SELECT {columns[0]} FROM {table}").fetchall()
        value = source.choice(
            (b"", "", "{", "[]", "[" * 5000, 1 << 62, -1.5, b"\xff\x00", '{"a": 1e999}', "\x1b[2J", None)
        )
        with suppress(sqlite3.Error):
            db.execute(f"UPDATE {table} SET {column} = ? WHERE {columns[0]} = ?", (value, *source.choice(keys)))


def try_files(kind: str, count: int, seed: int = 0) -> Outcome:
    """Read `count` damaged files of one kind."""
    source, outcome = random.Random(f"{kind} {seed}"), Outcome()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        makers = _makers(kind, folder, source)
        _limit_memory()
        for _ in range(count):
            path, read = source.choice(makers)()
            _try(path, read, outcome, 5 if kind == "logs" else LONGEST_S)
    return outcome


def _try(path: Path, read: Callable[[Path], object], outcome: Outcome, longest_s: int) -> None:
    began = time.perf_counter()
    outcome.files += 1
    try:
        with _deadline(longest_s):
            read(path)
    except BaseException as error:
        failure = describe_failure(error)
        if failure is None or isinstance(error, KeyboardInterrupt | TimeoutError):
            kept = Path(tempfile.gettempdir()) / f"fuzz_{outcome.files}_{path.name}"
            shutil.copyfile(path, kept)
            outcome.failures.append(f"{type(error).__name__}: {error} ({kept})"[:300])
        else:
            outcome.errors[type(error).__name__] += 1
    else:
        outcome.read += 1
    outcome.longest_s = max(outcome.longest_s, time.perf_counter() - began)


@contextmanager
def _deadline(longest_s: int) -> Iterator[None]:
    """Raise TimeoutError when it takes too long."""

    def ring(*_: object) -> None:
        raise TimeoutError(f"took more than {longest_s} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(longest_s)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def _limit_memory() -> None:
    """Allow this process so much memory on top of what it has: more is a MemoryError, which is not declared."""
    for late in ("integrate", "interpolate", "ndimage", "optimize", "signal"):  # libraries are the program's own
        importlib.import_module(f"scipy.{late}")
    pages = int(Path("/proc/self/statm").read_text().split()[0]) if Path("/proc/self/statm").exists() else 0
    if pages:
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY, hard))


Maker = Callable[[], tuple[Path, Callable[[Path], object]]]


def _makers(kind: str, folder: Path, source: random.Random) -> list[Maker]:
    """What makes a damaged file, and what reads it."""
    if kind == "runs":
        return _damaged_runs(folder, source)
    if kind == "commands":
        return [lambda: _spoiled_run(folder, source)]
    if kind == "logs":
        return [lambda: (_written(folder / "x.log", _spoiled_log(source)), lambda path: _read_log(path, source))]
    if kind == "toml":
        names = dict.fromkeys(("simulated", "bench", "dead_band", "fibre_gyro", "fibre_gyro_serial"))
        kinds = [measurement(name).kind for name in MEASUREMENTS]
        contents = [shipped_settings(name).read_bytes() for name in names]
        return [
            lambda content=content, kind=kind: (  # type: ignore[misc]
                _written(folder / "x.toml", mutated(content, source)),
                lambda path: load(kind, path),
            )
            for content in contents
            for kind in kinds
        ]
    content = isf_file() if kind == "isf" else csv_file()

    def read(path: Path) -> None:
        if source.random() < 0.1:  # most files are refused, and reading alone is faster
            analyze_file(path, None, {})
        else:
            read_waveform(path)

    return [lambda: (_written(folder / f"x.{kind}", mutated(content, source)), read)]


def _damaged_runs(folder: Path, source: random.Random) -> list[Maker]:
    settings: dict[str, dict[str, object]] = {
        "measurement": {"records": 2, "tilt_records": 1, "rates_over_lock_in": [8.0], "both_senses": False},
        "table": {"both_senses": False},
        "output": {"directory": str(folder / "runs")},
    }
    kind = measurement("measure")
    taken = start_run(kind, load(kind.kind, None, settings), Progress())
    save_result(taken.path, evaluate_run(open_run(taken.path)).document())
    content, copy = taken.path.read_bytes(), folder / "x.sqlite"

    def read(path: Path) -> None:
        evaluated = evaluate_run(open_run(path))
        evaluated.document()
        if source.random() < 0.02:
            render_report(evaluated)

    def spoiled() -> Path:
        _written(copy, content)
        spoil_cell(copy, source)
        return copy

    return [lambda: (_written(copy, mutated(content, source)), read), lambda: (spoiled(), read)]


HEADERS = (
    *("time,counts", "time [s],rate [mdps]", "date,time,counts", "timestamp,counts_x,counts_y", "t,n", ""),
    *("time,counts,temperature [K]", "time,dtheta [rad]", "counter,time,counts", "time_ms,counts,status", "a,b"),
    "time,rate\n(s),(deg/h)",
)
WILD_CELLS = (
    *(
        "ERR",
        "nan",
        "inf",
        "",
        "\0",
        "1e999",
        "12:30",
        "12:30:61",
        "25:99:99",
        "2025-13-45",
        "::",
        "--",
        "/",
        "#",
        '"',
    ),
    *(
        "1_000",
        "0x1f",
        "9" * 400,
        "T",
        " ",
        "12:-5:3",
        "1:2:3:4",
        "31.02.2025",
        "5e8",
        "-1e15",
        "1e-300",
        "\u0663",
    ),
)
BEFORE_MIDNIGHT = datetime.datetime(2025, 12, 31, 23, 59, 59)


def _spoiled_log(source: random.Random) -> bytes:
    """A log of a fibre gyro in one of many spellings, with some rows that are none."""
    header, separator = source.choice(HEADERS), source.choice(",;\t ")
    names = header.split("\n")[0].split(",")

    def cell(name: str, number: int) -> str:
        moment = BEFORE_MIDNIGHT + datetime.timedelta(milliseconds=10 * number)
        if name == "date":
            return moment.strftime(
                source.choice(("%m/%d/%Y", "%Y-%m-%d")) if source.random() < 0.01 else "%m/%d/%Y"
            )
        if name == "timestamp":
            return moment.isoformat()
        if name.startswith("t") and not name.startswith("temp"):
            return f"{moment:%H:%M:%S.%f}" if "date" in names else f"{number * 0.01:.2f}"
        return str(number % 256 if name == "counter" else source.randint(-3000, 3000))

    count = source.choice((0, 1, 2, 5, 60, 300))
    rows = [separator.join(cell(name, number) for name in names) for number in range(count)]
    for _ in range(source.choice((0, 0, 1, 3, 10)) if rows else 0):
        place, kind = source.randrange(len(rows)), source.random()
        if kind < 0.35:
            cells = rows[place].split(separator)
            cells[source.randrange(len(cells))] = source.choice(WILD_CELLS)
            rows[place] = separator.join(cells)
        elif kind < 0.5:
            rows.insert(place, source.choice((*rows, header)))
        elif kind < 0.6:
            rows[place] = rows[place][: source.randrange(len(rows[place]) + 1)]
        elif kind < 0.75 and len(rows) > 1:
            del rows[place]
        else:
            rows[place] = "".join(source.choice("0123456789.,;:-/ eE") for _ in range(source.randrange(20)))
    text = "\n".join(
        [(header if source.random() < 0.9 else source.choice(HEADERS)).replace(",", separator), *rows]
    )
    content = text.encode(source.choice(("utf-8", "utf-8", "utf-16")))
    content = mutated(content, source) if source.random() < 0.1 else content
    packed = gzip.compress(content) if source.random() < 0.05 else content
    return packed if source.random() < 0.98 else packed[: source.randrange(len(packed) + 1)]


def _read_log(path: Path, source: random.Random) -> None:
    made = read_gyro_log(
        path,
        counts_per_dps=source.choice((None, 10.0)),
        skip_bad_rows=source.choice((0, 0, 1, 3, 1000)),
        axis=source.choice(("", "X")),
        units=source.choice(("", "", "deg", "mrad/s", "counts")),
        interval_s=source.choice((None, None, 0.01)),
    )
    if made.times.size != made.counts.size or not (made.times[1:] >= made.times[:-1]).all():
        raise AssertionError("the times of a log do not go on")


GOLDEN = Path(__file__).resolve().parents[2] / "tests" / "golden"
COMMANDS = (
    *("analyze {run}", "analyze {run} --json", "analyze {run} --full", "report {run} --to {folder}/a.html"),
    *("export {run} --to {folder}/a.csv --replace", "runs {folder}", "runs {folder} --json", "salvage {run}"),
    *("compare {run} {whole}", "annotate {run} --note seen"),
)
SPOILT = (None, 0, -1, 1.5, math.nan, 1e308, "", "x", [], {}, [1], {"a": 1}, True, 10**400, -5e-324)
PAGE = 4096


def _spoiled_run(folder: Path, source: random.Random) -> tuple[Path, Callable[[Path], object]]:
    shutil.rmtree(folder / "runs", ignore_errors=True)
    (folder / "runs").mkdir()
    whole = source.choice(sorted(GOLDEN.glob("*.sqlite")))
    run = folder / "runs" / whole.name
    if source.random() < 0.4:
        _written(run, _with_a_spoilt_page(whole.read_bytes(), source))
    else:
        shutil.copy(whole, run)
        _spoil_inside_a_cell(run, source)
    line = source.choice(COMMANDS).format(run=run, folder=folder / "runs", whole=whole)

    def read(path: Path) -> None:
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = cli.main(line.split())
        if code not in (0, 1, 2, 4, 6):
            raise AssertionError(f"{line}: exit {code}: {err.getvalue().strip()[-200:]}")

    return run, read


def _with_a_spoilt_page(content: bytes, source: random.Random) -> bytes:
    first, other = (PAGE * source.randrange(len(content) // PAGE) for _ in range(2))
    behind = content[first + PAGE :]
    return source.choice(
        (
            content[:first],
            content[: source.randrange(len(content))],
            content[:first] + bytes(PAGE) + behind,
            content[:first] + source.randbytes(PAGE) + behind,
            content[:first] + content[other : other + PAGE] + behind,
        )
    )


def _spoil_inside_a_cell(run: Path, source: random.Random) -> None:
    """Put a value of another kind into a cell, or anywhere inside its JSON, past all that SQLite would refuse."""
    with closing(sqlite3.connect(run)) as db, db:
        db.execute("PRAGMA writable_schema = 1")
        db.execute("UPDATE sqlite_master SET sql = replace(sql, 'NOT NULL', '')")
    with closing(sqlite3.connect(run)) as db, db:
        tables = [name for (name,) in db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        table = source.choice(tables)
        columns = [row[1] for row in db.execute(f"PRAGMA table_info({table})")]
        keys, column = db.execute(f"SELECT {columns[0]} FROM {table}").fetchall(), source.choice(columns)
        if not keys:
            return
        of_key = (f"{table} WHERE {columns[0]} = ?", source.choice(keys))
        (held,) = db.execute(f"SELECT {column} FROM {of_key[0]}", of_key[1]).fetchone()
        value = source.choice(
            (None, 0, -1, 1.5, math.inf, 1 << 62, "", "x", "[" * 5000, "{}", "1e999", b"\xff\x00")
        )
        if isinstance(held, str) and held[:1] in ("[", "{") and source.random() < 0.8:
            inside = json.loads(held)
            places = list(_places(inside))
            if places:
                of, place = source.choice(places)
                of[place] = source.choice(SPOILT)
                if isinstance(of, dict) and source.random() < 0.1:
                    del of[place]
                value = json.dumps(inside)
        with suppress(sqlite3.Error):
            db.execute(f"UPDATE {table} SET {column} = ? WHERE {columns[0]} = ?", (value, *of_key[1]))


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Every place inside a JSON value: what holds it, and its name or number there."""
    for place in (
        value if isinstance(value, dict) else range(min(len(value), 3)) if isinstance(value, list) else ()
    ):
        yield value, place
        yield from _places(value[place])


def _written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def isf_file() -> bytes:
    """A record of a beat as PC software writes it."""
    record = _record()
    fields = dict(zip(_ISF_NAMES, record.preamble.to_text().split(";"), strict=True))
    text = ";".join(f"{name} {value}" for name, value in fields.items())
    return f":WFMPRE:{text};:CURVE #42500".encode() + record.codes.tobytes() + b"\n"


_ISF_NAMES = (
    *("BYT_NR", "BIT_NR", "ENCDG", "BN_FMT", "BYT_OR", "NR_PT", "WFID", "PT_FMT"),
    *("XINCR", "PT_OFF", "XZERO", "XUNIT", "YMULT", "YZERO", "YOFF", "YUNIT"),
)


def csv_file() -> bytes:
    """The same record as the scope saves it."""
    record = _record()
    head = ("Record Length,2500", "Sample Interval,4e-05", "Trigger Point,0", "Source,CH1", "Vertical Units,V")
    more = ("Vertical Scale,0.1", "Vertical Offset,0", "Horizontal Units,s", "Horizontal Scale,0.01", "Yzero,0")
    names = [*head, *more]
    rows = zip(record.times, record.volts, strict=True)
    lines = [f"{names[n] if n < len(names) else ','},,{t:.12f},{v:.5f}," for n, (t, v) in enumerate(rows)]
    return "\r\n".join(lines).encode()


def _record() -> Waveform:
    import numpy as np

    turns = 2 * np.pi * 16.3 * np.arange(2500) / 2500
    codes = np.round(95 * np.sin(turns) + 6 * np.sin(2 * turns + 1)).astype(np.int8)
    text = '1;8;BIN;RI;MSB;2500;"Ch1, DC coupling";Y;4.0E-5;0;0.0E0;"s";4.0E-3;0.0E0;0.0E0;"Volts"'
    return Waveform(codes, Preamble.parse(text))


def main(arguments: list[str] | None = None) -> int:
    """Read the files, print what became of them, and return 0 if every one was read or refused as it should be."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.damage.fuzz_files", description="Damaged files.")
    for kind, count in COUNTS.items():
        parser.add_argument(f"--{kind}", type=int, default=count, metavar="N", help=f"default {count}")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    failed = False
    for kind in COUNTS:
        outcome = try_files(kind, getattr(options, kind), options.seed)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        refused = ", ".join(f"{count} {name}" for name, count in outcome.errors.most_common())
        sys.stdout.write(
            f"{kind}: {outcome.files} files, {outcome.read} read, {refused}; {len(outcome.failures)} failures, "
            f"longest {outcome.longest_s:.2f} s, peak {peak:.0f} MB\n"
        )
        for text in outcome.failures[:20]:
            sys.stdout.write(f"  {text}\n")
        failed = failed or bool(outcome.failures)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
