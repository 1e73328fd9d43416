"""Everything that the commands print and write of the golden runs: what a moved wall must not change.

``outputs.py FOLDER [GROUP [PATTERN]]`` writes it, ``outputs.py --store`` into ``stored`` (``make golden``);
``compare.py`` beside it compares with what another commit writes, byte for byte. Only the command line is used, in
any state of the house.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
RING_LASER = ("single", "several", "quadrature", "channel", "turning", "acquired", "default", "beams")
FOG = {"table": "table", "logs": "table", "selfcal": "selfcal", "selfcal_by_table": "selfcal", "eps": "eps"}
FOG |= {"figures": "figures", "witness": "witness", "allan": "allan", "threshold": "threshold"}
FOG |= {"temperature": "temperature"}
OTHERS = ("deadband", "dither", "locked", "cut_short")
SN1, BAD = "SN1/2026-11-24T024838Z_001", "BAD/2026-11-24T024851Z_001"
RECORD_FILES = ("record.json", "junit.xml", "limits.csv", "records.csv", "record.html")

LIMITS = "[limits]\nlock_in_rate_dps = 0.0099\nlock_in_rate_u_dps = 1e-4\n"
CHANNEL = "[front_end]\nlow_pass_hz = 30000.0\n"
K_ONLY = "[gyro]\nscale_factor_pulses_per_deg = 2000.0\n"

_TIME = re.compile(r"20\d\d-\d\d-\d\d[T ]\d\d:?\d\d(:?\d\d)?(\.\d+)?Z?")
# what the station's record holds of this very run: how long it took, where, and sums over both
_EACH_TIME = re.compile(
    r'(?<="elapsed_s": )[\d.]+|(?<= time=")[\d.]+|(?<=hostname=")[^"]*|(?<=\W)[0-9a-f]{64}(?=\W)'
)


_VERSION = re.compile(r"\b(numpy|scipy|pyvisa|pyvisa-py|pyserial) \d+(?:\.\w+)+|\d+\.\d+\.\w+ on [\w.+-]+")


@dataclass(frozen=True)
class Command:
    """A command line, and the files that it writes."""

    group: str  # those of a group are run in one folder, in their order
    name: str
    arguments: tuple[str, ...]
    files: tuple[str, ...] = ()


GROUPS = ("ring_laser", "fibre_gyro", "pages", "files")


def commands(group: str) -> Iterator[Command]:
    """Every command that reads saved runs, in an order in which the later may read what the earlier write."""

    def command(name: str, *arguments: str, files: tuple[str, ...] = ()) -> Command:
        return Command(group, name, arguments, files)

    if group in ("ring_laser", "fibre_gyro"):
        for name in (*RING_LASER, *OTHERS) if group == "ring_laser" else [f"fog_{one}" for one in FOG]:
            yield command(f"analyze_{name}_json", "analyze", f"runs/{name}.sqlite", "--json")
            yield command(f"analyze_{name}", "analyze", f"runs/{name}.sqlite")
    if group == "ring_laser":
        for name in RING_LASER:
            yield command(f"analyze_{name}_jsonl", "analyze", f"runs/{name}.sqlite", "--jsonl")
        single = ("analyze", "runs/single.sqlite", "--json")
        yield command("single_paper13_json", *single, "--relation=paper-13")
        yield command("single_rate_json", *single, "--input-rate=0.08")
        yield command("single_k1990_json", *single, "--scale-factor=1990")
        yield command(
            "stated_channel_json", "analyze", "runs/several.sqlite", "--config", "channel.toml", "--json"
        )
        for name in ("single", "default"):
            judged = ("analyze", f"runs/{name}.sqlite", "--config", "limits.toml")
            yield command(f"limits_{name}_json", *judged, "--json")
            yield command(f"limits_{name}", *judged)
    if group == "fibre_gyro":
        for name, test in FOG.items():
            yield command(f"fog_{name}", "fog", test, f"runs/fog_{name}.sqlite", "--json", "--no-report")
            yield command(f"fog_{name}_words", "fog", test, f"runs/fog_{name}.sqlite", "--no-report")
    if group == "pages":
        for name in (*RING_LASER, "deadband", "dither", *(f"fog_{one}" for one in FOG)):
            page = f"{name}.html"
            yield command(f"report_{name}", "report", f"runs/{name}.sqlite", "-o", page, files=(page,))
    if group == "files":
        yield from _of_many_sources(command)


def _of_many_sources(command: Callable[..., Command]) -> Iterator[Command]:
    """Tables, data sets, files of an oscilloscope, lists of runs and tests of a station."""
    single, several, channel = (f"runs/{name}.sqlite" for name in ("single", "several", "channel"))
    for ending in ("csv", "jsonl"):
        table = f"results.{ending}"
        yield command(f"results_{ending}", "analyze", single, several, "--to", table, "--quiet", files=(table,))
    yield command("export_csv", "export", single, "--to", "records.csv", files=("records.csv",))
    yield command("export_tek", "export", single, "--tek-csv", "card")
    files = ("analyze", "card/measure", "--config", "k.toml")
    yield command("combine_json", *files, "--combine", "--json")
    yield command("combine", *files, "--combine", "--report", "combined.html", files=("combined.html",))
    yield command("combine_runs_json", "analyze", single, channel, "--combine", "--json")
    yield command("card_json", *files, "--json")
    methods = ("compare", single, single, "--relation-b", "paper-10")
    yield command("compare_methods", *methods, "--plot", "methods.svg", files=("methods.svg",))
    yield command("compare_runs", "compare", single, channel)
    yield command("compare_runs_json", "compare", single, several, "--json")
    yield command("compare_tables_json", "compare", "results.csv", "results.jsonl", "--json")
    yield command("runs", "runs", "runs")
    yield command("runs_json", "runs", "runs", "--json")
    yield command("runs_csv", "runs", "runs", "--csv")
    yield command("runs_plot", "runs", "runs", "--unit", "RLG-7", "--plot", "trend.svg", files=("trend.svg",))
    yield command("verify", "verify", f"tests/{SN1}", f"tests/{BAD}")
    yield command("history_json", "history", "tests", "--json", files=("tests/index.html",))
    written = tuple(f"tests/{SN1}/{name}" for name in RECORD_FILES)
    yield command("station", "station", "campaign.toml", "--unit", "SN1", "--resume", "--quiet", files=written)
    yield command("history", "history", "tests", files=("tests/index.html",))


def prepare(folder: Path) -> None:
    """Lay out the golden runs, a test whose last step is to be told again, and the settings."""
    (folder / "runs").mkdir(parents=True)
    for path in sorted(GOLDEN.glob("*.sqlite")):
        shutil.copy(path, folder / "runs" / path.name)
    shutil.copytree(GOLDEN / "campaign" / "tests", folder / "tests")
    shutil.copy(GOLDEN / "campaign" / "campaign.toml", folder)
    journal = folder / "tests" / SN1 / "test.jsonl"
    journal.write_text(
        "".join(journal.read_text(encoding="utf-8").splitlines(keepends=True)[:-2]), encoding="utf-8"
    )
    for name, text in {"limits": LIMITS, "channel": CHANNEL, "k": K_ONLY}.items():
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")


def run(command: Command, begun: datetime) -> dict[str, str]:
    """Run a command in this process; what it printed and wrote, by name, without what differs each time."""
    from station.cli import main

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(list(command.arguments))
    each_time = _EACH_TIME if command.name == "station" else re.compile(r"(?!)")
    told = {f"{command.name}.out": out.getvalue(), f"{command.name}.err": f"exit {code}\n{err.getvalue()}"}
    for path in command.files:
        text = Path(path).read_text(encoding="utf-8") if Path(path).exists() else "is not there\n"
        told[f"{command.name}.{Path(path).name}"] = text
    return {name: each_time.sub("0", without_now(text, begun)) for name, text in told.items()}


def without_now(text: str, begun: datetime) -> str:
    """Leave out times of this run, the state of the source and where it was run."""

    def time(found: re.Match[str]) -> str:
        digits = re.sub(r"\D", "", found[0])[:12]
        return "NOW" if digits >= begun.strftime("%Y%m%d%H%M") else found[0]

    for state in _states_of_source():
        text = text.replace(f" {state}", "").replace(state, "COMMIT")
    return _VERSION.sub(
        lambda found: f"{found[1] or 'python'} VERSION", _TIME.sub(time, text.replace(str(Path.cwd()), "FOLDER"))
    )


@cache
def _states_of_source() -> tuple[str, ...]:
    import station

    if shutil.which("git") is None:
        return ()
    tree = Path(station.__file__).resolve().parents[1]
    git = ["git", "-C", str(tree), "rev-parse", "--short=12", "HEAD"]
    commit = subprocess.run(git, capture_output=True, text=True).stdout.strip()
    return (f"{commit}+changes", commit) if commit else ()


def write_outputs(folder: Path, groups: Sequence[str] = GROUPS, only: str = "") -> dict[str, str]:
    """Run the commands of some groups, each in a folder of its own; return what each printed and wrote."""
    before, begun = Path.cwd(), datetime.now(UTC)
    os.environ.update(COLUMNS="120", NO_COLOR="1")
    told: dict[str, str] = {}
    for group in groups:
        prepare(folder / group)
        os.chdir(folder / group)
        try:
            for command in commands(group):
                if re.search(only, command.name):
                    told |= run(command, begun)
        finally:
            os.chdir(before)
    return told


def without_pictures(text: str) -> str:
    """A page without what matplotlib and its version draw."""
    return re.sub(r"(?s)<svg.*?</svg>", "<svg/>", text)


def main(folder: Path, *, store: bool = False, groups: Sequence[str] = GROUPS, only: str = "") -> None:
    """Write outputs into a folder of their own; those that are stored without pictures."""
    shutil.rmtree(folder, ignore_errors=True)
    for name, text in write_outputs(folder / "work", groups, only).items():
        if not (store and name.endswith(".svg")):
            (folder / name).write_text(without_pictures(text) if store else text, encoding="utf-8")
    shutil.rmtree(folder / "work")


if __name__ == "__main__":
    if "--store" in sys.argv:
        main(Path(__file__).parent / "stored", store=True)
    else:
        main(Path(sys.argv[1]), groups=sys.argv[2:3] or GROUPS, only="".join(sys.argv[3:4]))
