"""Constants as VHDL, C and CSV: compiled, parsed, and compared with the run that they come from."""

import csv
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from analysis.fibre_gyro import round_to_words
from station.errors import UsageError
from station.fibre_gyro.constants import (
    Column,
    Constants,
    WordFormat,
    c_text,
    constants_of,
    csv_text,
    vhdl_text,
    write_constants,
)

NUMBER = re.compile(r"^\s*constant (N_\w+) : n_t := (?:to_signed\((-?\d+), (\d+)\)|\"([01]+)\");$", re.M)
SIZE = re.compile(r"constant (\w+)_(WIDTH|FRACTION)\s*: (?:positive|integer)\s*:= (-?\d+);")


@pytest.fixture
def table_run(taken):
    return taken("table", table={"axes": ["Z"], "turns": 3}, simulation={"seed": 2, "output_rate_hz": 4.0})


@pytest.fixture
def ramp_run(taken):
    temperature = {"ramp_c_per_min": 4.0, "rest_s": 60.0, "window_s": 60.0, "settle_s": 1.0}
    return taken("temperature", temperature=temperature, simulation={"seed": 4, "output_rate_hz": 2.0})


def compiled(header: str, expressions: list[str], folder: Path) -> list[float]:
    """What a C program that includes the header prints of them."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    (folder / "gyro.h").write_text(header)
    lines = "\n".join(f'printf("%.17g\\n", (double)({one}));' for one in expressions)
    program = (
        f'#include <stdio.h>\n#include "gyro.h"\n#include "gyro.h"\nint main(void) {{\n{lines}\nreturn 0;\n}}\n'
    )
    (folder / "main.c").write_text(program)
    command = [compiler, "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "main.c", "-o", "main"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    told = subprocess.run([str(folder / "main")], check=True, capture_output=True, text=True).stdout
    return [float(line) for line in told.split()]


def vhdl_numbers(text: str) -> tuple[dict[str, int], dict[str, int]]:
    """Words and sizes of a package, as a reader of VHDL takes them."""
    words = {}
    for name, value, width, bits in NUMBER.findall(text):
        if bits:
            words[name] = int(bits, 2) - (1 << len(bits)) * (bits[0] == "1")
        else:
            words[name] = int(value)
            assert -(1 << (int(width) - 1)) <= words[name] < 1 << (int(width) - 1)
    return words, {f"{name}_{what}": int(value) for name, what, value in SIZE.findall(text)}


def test_c_and_vhdl_stand_for_the_numbers_of_the_run(table_run, tmp_path: Path) -> None:
    evaluated, run = table_run
    found = constants_of(run.path, WordFormat())
    numbers = [one["number_counts"] for one in evaluated.document()["axes"][0]["differences"]]
    names = ["0_01", "0_1", "1"]
    before = "GYRO_NUMBERS_Z_N"
    *words, width, fraction = compiled(
        c_text(found), [*(f"{before}_{name}" for name in names), f"{before}_WIDTH", f"{before}_FRACTION"], tmp_path
    )
    parsed, sizes = vhdl_numbers(vhdl_text(found))
    assert [parsed[f"N_{name}"] for name in names] == words
    assert (sizes["N_WIDTH"], sizes["N_FRACTION"]) == (width, fraction)
    # rounding errors from the words themselves, and small beside the uncertainty
    off = 1e6 * (np.array(words) / 2**fraction / numbers - 1)
    column = found.columns[0]
    assert column.words.error_ppm == pytest.approx(off, rel=1e-6, abs=1e-6)
    assert np.all(np.abs(column.words.error) <= 0.11 * column.values_u)
    rows = list(csv.DictReader(line for line in csv_text(found).splitlines() if not line.startswith("#")))
    assert [float(row["rounded"]) for row in rows] == pytest.approx(column.words.values.tolist(), rel=1e-15)
    assert [float(row["rate_dps"]) for row in rows] == [0.01, 0.1, 1.0]


def test_given_widths_and_what_they_cost(table_run) -> None:
    _, run = table_run
    short = constants_of(run.path, WordFormat(width=16)).columns[0]
    assert short.words.width == 16
    # 246.15 takes 8 bits before the point: 7 are left behind it, half a step of them is 1.6e-3 of 2.46
    assert short.words.fraction == 7
    assert short.words.largest_error_ppm <= 1e6 / 256 / 2.46
    with pytest.raises(UsageError, match=r"with 20 bits behind the point takes 29 bits, not 16"):
        constants_of(run.path, WordFormat(width=16, fraction=20))
    fit = constants_of(run.path, WordFormat(numbers="fit", error_ppm=0.01)).columns[0]
    assert fit.values[1] == pytest.approx(10 * fit.values[0], rel=1e-12)
    assert fit.words.largest_error_ppm <= 0.01


def test_words_beyond_32_bits(tmp_path: Path) -> None:
    values = np.array([-(2.0**40) / 3, 2.0**62 - 512.0])
    words = round_to_words(values, width=64, fraction=0)
    column = Column("N", "numbers", "codes", np.array([0.1, 1.0]), values, np.zeros(2), words)
    found = Constants("numbers", "Z", "gyro **// of \n two lines", tmp_path / "run" / "run.sqlite", (column,))
    names = [f"GYRO_NUMBERS_Z_N_{name}" for name in ("0_1", "1")]
    told = compiled(
        c_text(found), [f"{name} == {word}LL" for name, word in zip(names, words.words, strict=True)], tmp_path
    )
    assert told == [1.0, 1.0]
    parsed, _ = vhdl_numbers(vhdl_text(found))
    assert list(parsed.values()) == list(words.words)
    lowest = round_to_words([-128.0], width=8, fraction=0)
    column = Column("N", "numbers", "codes", np.array([0.1]), np.array([-128.0]), np.zeros(1), lowest)
    small = Constants("numbers", "Z", "gyro", tmp_path / "run" / "run.sqlite", (column,))
    assert compiled(c_text(small), ["GYRO_NUMBERS_Z_N_0_1"], tmp_path) == [-128.0]


@pytest.mark.slow
def test_a_compensation_table_in_c(ramp_run, tmp_path: Path) -> None:
    evaluated, run = ramp_run
    found, table = constants_of(run.path, WordFormat()), evaluated.document()["compensation"]
    k = next(one for one in found.columns if one.name == "K")
    known = [value for value in table["scale_factor_counts_per_dps"] if value is not None]
    name = "GYRO_TEMPERATURE_Z_K"
    asked = [f"{name}_TABLE[{place}] / (double)(1L << {name}_FRACTION)" for place in range(len(known))]
    told = compiled(c_text(found), [*asked, f"{name}_COUNT", f"{name}_FIRST_C", f"{name}_STEP_C"], tmp_path)
    assert told[:-3] == pytest.approx(known, rel=1e-6)
    assert np.all(np.abs(np.array(told[:-3]) - known) <= 0.1 * k.values_u.min() * (1 + 1e-9))
    assert told[-3:] == [len(known), k.at[0], 5.0]
    exact = compiled(
        c_text(found, floats=True), [f"{name}_TABLE[0]", "GYRO_TEMPERATURE_Z_BIAS_TABLE[1]"], tmp_path
    )
    assert exact == [known[0], next(one for one in found.columns if one.name == "BIAS").values[1]]
    assert "K_TABLE : k_table_t := (" in vhdl_text(found)


def test_files_are_not_written_over_and_other_runs_are_refused(table_run, taken, tmp_path: Path) -> None:
    _, run = table_run
    found = constants_of(run.path, WordFormat())
    files = {"c": tmp_path / "n.h", "vhdl": tmp_path / "n.vhd"}
    write_constants(found, files, floats=False, replace=False)
    before = (tmp_path / "n.h").read_text()
    with pytest.raises(UsageError, match=r"is there already; --replace writes over it"):
        write_constants(found, {"csv": tmp_path / "n.csv", **files}, floats=False, replace=False)
    assert not (tmp_path / "n.csv").exists()
    write_constants(found, files, floats=False, replace=True)
    assert (tmp_path / "n.h").read_text() == before
    with pytest.raises(UsageError, match="gives no scale factor of axis X"):
        constants_of(run.path, WordFormat(axis="X"))
    few = {"per_decade": 1, "refine": 0, "resolution_at_dps": 0.0}
    _, other = taken("threshold", threshold=few)
    with pytest.raises(
        UsageError, match=r"gives no constants; those of `gyrolock fog` table, selfcal, temperature do"
    ):
        constants_of(other.path, WordFormat())
