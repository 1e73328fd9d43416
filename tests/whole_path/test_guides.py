"""Every command line of README and guides is one that the program takes; those that need no hardware are run."""

import contextlib
import io
import re
import runpy
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from station.cli import gyrolock, main

HOME = Path(__file__).parents[2]
GENERATED = {"commands.md", "api.md", "results.md"}
PAGES = [HOME / "README.md", *sorted(one for one in (HOME / "docs").glob("*.md") if one.name not in GENERATED)]
_LINE = re.compile(r"^(?: {4}|\$ )?gyrolock (.+)$")
_PROSE = re.compile(r"\s{3,}.*$|\s+#.*$")
"""What stands behind a command on its line: a comment, or words after three blanks."""


def lines_of(page: Path) -> Iterator[tuple[int, list[str]]]:
    """The command lines of a page, as a shell hands them over."""
    fence = ""
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
        if line.startswith("```"):
            fence = "" if fence else line[3:] or "output"
        elif (found := _LINE.match(line)) and (fence in ("bash", "sh", "console") or line.startswith("    ")):
            yield number, shlex.split(_PROSE.sub("", found[1]))


EVERY = [(page.name, number, words) for page in PAGES for number, words in lines_of(page)]


def without_shell(words: list[str]) -> list[str]:
    """The same without what only the shell sees."""
    return words[: words.index(">")] if ">" in words else words


def resolved(words: list[str]) -> tuple[click.Command, click.Context, list[str]]:
    command: click.Command = gyrolock
    context = click.Context(gyrolock, info_name="gyrolock")
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        below = command.get_command(context, words[0])
        assert below is not None, f"there is no command {words[0]}"
        command, context, words = below, click.Context(below, info_name=words[0], parent=context), words[1:]
    return command, context, words


@pytest.mark.parametrize(("page", "number", "words"), EVERY, ids=[f"{page}:{number}" for page, number, _ in EVERY])
def test_a_command_line_of_a_guide_is_one(page: str, number: int, words: list[str]) -> None:
    command, context, rest = resolved(without_shell(words))
    options = [one for one in command.params if isinstance(one, click.Option)]
    known = {name: one for one in options for name in (*one.opts, *one.secondary_opts)}
    taken = False  # by the option before
    for word in rest:
        if word.startswith("-") and not taken:
            name = word.split("=")[0]
            assert name in known, f"{context.command_path} has no option {word}"
            taken = "=" not in word and not known[name].is_flag
        else:
            taken = False


ELSEWHERE = re.compile(
    r"GPIB|/dev/tty|s3://|tcp://|/shared/|/data/|--resource NAME|--resume|--loop|my\.toml|"
    r"^(start|simulate|panel|fog serve|fog sniff|stop)\b"
)
"""What needs an instrument or settings that name one, a cluster, a terminal, a run that was cut short, an end."""

MEASURES = re.compile(
    r"^(measure|acquire|deadband|station|study|doctor|plan|fog (?!.*(list|rest|night|RUN|runs/)))"
)
"""What takes seconds: a simulated bench is measured."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    runpy.run_path(str(HOME / "docs" / "sample.py"))["make"](folder)
    return folder


@pytest.fixture
def sample(request: pytest.FixtureRequest, made: Path, tmp_path: Path) -> Path:
    """The folder of a guide's bench, as whoever begins to read it has it."""
    bench = "fibre_gyro" if request.node.callspec.params["page"].startswith("fibre_gyro") else "ring_laser"
    return Path(shutil.copytree(made / bench, tmp_path / bench))


def run_here(words: list[str], folder: Path) -> str:
    """Run a command line in the sample folder, patterns and redirections as a shell has them; what went wrong."""
    run = "sweeps/unit_A" if words[0] == "deadband" else "runs/2026-03-04T101500Z_001"
    arguments = [
        str(found.relative_to(folder)) if found else word.replace("RUN", run)
        for word in without_shell(words)
        for found in (sorted(folder.glob(word.replace("*", "[!.]*"))) if "/*" in word else [None])
    ]
    out, err = io.StringIO(), io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(arguments)
    if ">" in words:
        # the one thing that the guide says to fill in
        told = out.getvalue().replace("_pulses_per_deg = 0.0", "_pulses_per_deg = 2000.0")
        (folder / words[words.index(">") + 1]).write_text(told)
    return "" if code in (0, 1, 6) else f"{code}: {err.getvalue()[-400:]}"


def all_run(page: str, folder: Path, *, measuring: bool) -> None:
    wrong = []
    for name, number, words in EVERY:
        line = " ".join(words)
        if name != page or ELSEWHERE.search(line) or (MEASURES.match(line) and not measuring):
            continue
        if said := run_here(words, folder):
            wrong.append(f"{page}:{number}: gyrolock {line}\n  {said}")
    assert not wrong, "\n".join(wrong)


PAGES_RUN = sorted({page for page, _, words in EVERY if not ELSEWHERE.search(" ".join(words))})


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES_RUN)
def test_what_a_guide_reads_is_there_in_the_sample(page: str, sample: Path) -> None:
    all_run(page, sample, measuring=False)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES_RUN)
def test_every_command_of_a_guide_runs(page: str, sample: Path) -> None:
    all_run(page, sample, measuring=True)


@pytest.mark.slow
def test_what_the_pages_show_of_measure_is_what_it_prints(tmp_path: Path) -> None:
    """To some uncertainty: another processor rounds otherwise, and a trigger may come a period later."""
    out = io.StringIO()
    with contextlib.chdir(tmp_path), contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
        assert main(["measure", "--no-report"]) == 0
    rows = re.compile(r"^(?: {4})?((?:lock-in rate|removed|quality) {2}.*)$", re.M)
    printed = rows.findall(out.getvalue())
    assert len(printed) == 3
    number = re.compile(r"(\d+\.?\d*)(?: ± (\d+\.?\d*)|\((\d+)\))?")
    for page in ("README.md", "docs/operator.md"):
        shown = rows.findall((HOME / page).read_text(encoding="utf-8"))
        assert [number.sub("0", line) for line in shown] == [number.sub("0", line) for line in printed], page
        for one, other in zip(number.findall(" ".join(shown)), number.findall(" ".join(printed)), strict=True):
            last = 10.0 ** -len(one[0].partition(".")[2])
            u, other_u = (float(each[1] or last * float(each[2] or 0)) for each in (one, other))
            assert abs(float(one[0]) - float(other[0])) <= max(1.5 * u, 1e-9), (page, one, other)
            assert u == pytest.approx(other_u, rel=0.2, abs=1e-9), (page, one, other)
