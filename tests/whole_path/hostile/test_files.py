"""What is given by name may be anything: a pipe, a device, a file as large as a disk, ten thousand of them."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.damage.fuzz_files import csv_file, isf_file

SAVED = Path(__file__).parents[2] / "golden" / "single.sqlite"
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="devices and limits of memory are those of Linux")

# every kind of file that is read, in one process that may take 300 MB more than it has when it begins
READ = """
import resource, sys
from pathlib import Path
from station.cli import main
import station.reanalysis.combine, station.lock_in.settings, station.shell.finish
pages = int(Path("/proc/self/statm").read_text().split()[0])
limit = pages * resource.getpagesize() + (300 << 20)
resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))
for arguments in (line.split() for line in sys.stdin):
    print(main(arguments), flush=True)
"""


def codes_and_errors(folder: Path, *lines: str) -> list[tuple[str, str]]:
    """Run commands one after the other; returns exit code and the line on stderr of each."""
    done = subprocess.run(
        [sys.executable, "-c", READ],
        cwd=folder,
        input="\n".join(lines),
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert done.returncode == 0, done.stderr
    errors = done.stderr.splitlines()
    assert len(errors) == len(lines), done.stderr
    return list(zip(done.stdout.split(), errors, strict=True))


@pytest.mark.slow
def test_what_is_no_plain_file_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "zero.isf").symlink_to("/dev/zero")
    (tmp_path / "null.csv").symlink_to("/dev/null")
    names = ("pipe.csv", "folder.csv", "zero.isf", "null.csv")
    asked = [f"analyze {name} --scale-factor 2000" for name in names]
    asked += [f"analyze {SAVED} --config {name}" for name in (*names, "/dev/zero")]
    asked += [f"{command} {name}" for name in names for command in ("salvage", "report", "acquire --resume")]
    said = codes_and_errors(tmp_path, *asked)
    assert {code for code, _ in said} == {"2"}
    for (_, line), command in zip(said, asked, strict=True):
        assert next(name for name in (*names, "/dev/zero") if name in command) in line
        assert any(kind in line for kind in ("a pipe", "a directory", "a device", "is neither", "run"))


@pytest.mark.slow
def test_a_file_that_claims_to_be_a_record_and_is_as_large_as_a_film_is_refused(tmp_path: Path) -> None:
    """198 MB and 240 MB; a whole one of each kind stands at their beginning."""
    for name, head, megabytes in (("x.csv", csv_file(), 198), ("x.isf", isf_file(), 240), ("x.toml", b"", 198)):
        with (tmp_path / name).open("wb") as file:
            file.write(head)
            file.truncate(megabytes * 1_000_000)
    said = codes_and_errors(
        tmp_path,
        "analyze x.csv --scale-factor 2000",
        "analyze x.isf --scale-factor 2000",
        f"analyze {SAVED} --config x.toml",
    )
    for code, line in said:
        assert code == "2"
        assert "is larger than any such file" in line


def test_numbers_and_brackets_without_end_are_refused(tmp_path: Path) -> None:
    deep = "[" * 100_000
    (tmp_path / "deep.toml").write_text(f"a = {deep}")
    (tmp_path / "long.toml").write_text(f"[measurement]\nrecords = {'9' * 10_000}\n")
    (tmp_path / "long.csv").write_bytes(csv_file().replace(b"4e-05", b"9" * 5000))
    (tmp_path / "long.isf").write_bytes(isf_file().replace(b"4.0E-5", b"1e9999", 1))
    said = codes_and_errors(
        tmp_path,
        f"analyze {SAVED} --config deep.toml",
        f"analyze {SAVED} --config long.toml",
        "analyze long.csv --scale-factor 2000",
        "analyze long.isf --scale-factor 2000",
    )
    assert [code for code, _ in said] == ["2"] * 4
    assert not any("defect" in line for _, line in said)


@pytest.mark.slow
def test_ten_thousand_files_are_read_one_after_the_other(tmp_path: Path) -> None:
    """More than a process may have open; the one that is no record costs nothing of the others."""
    (tmp_path / "x.csv").write_text("no record")
    paths = ["x.csv"] * 10_000
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    command = [sys.executable, "-m", "station.cli", "analyze", "--scale-factor", "2000", *paths]
    done = subprocess.run(
        command,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (min(soft, 64), hard)),
    )
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert len(done.stderr.splitlines()) == 10_000
