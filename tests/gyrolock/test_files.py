"""Files of an oscilloscope, and a memory card of them, seen as a run."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import gyrolock
from analysis import beat_signal
from instrument import FileFormatError, Preamble
from station.cli import main
from station.errors import NoUsableSignal, UsageError
from station.reanalysis.combine import analyze_file

N, INTERVAL, STEP = 2500, 4e-5, 0.008
FIELDS = f'1;8;BIN;RI;MSB;{N};"Ch1, DC coupling, 2.0E-1 V/div, 1.0E-2 s/div, {N} points, Sample mode"'
VALUES = f'{FIELDS};Y;{INTERVAL};0;0.0;"s";{STEP};0.0;0.0;"Volts"'
NAMES = [field.name.upper() for field in fields(Preamble)]


def write_isf(path: Path, seed: int, channel: str = "Ch1", amplitude: float = 0.6) -> Path:
    """A file as PC software writes it, of a gyro with a lock-in rate of 0.01 deg/s."""
    noise = np.random.default_rng(seed).normal(0, 0.004, N)
    beat = beat_signal(
        np.arange(N) * INTERVAL, scale_factor=2000, input_rate=0.08, lock_in_rate=0.01, amplitude=amplitude
    )
    codes = np.round((beat + noise) / STEP).astype(np.int8).tobytes()
    header = ";".join(f"{name} {value}" for name, value in zip(NAMES, VALUES.split(";"), strict=True))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(f":WFMPRE:{header};:CURVE #4{N}".replace("Ch1", channel).encode() + codes)
    return path


@pytest.fixture
def card(tmp_path: Path) -> Path:
    """A memory card with three records, and files that are none."""
    for number in range(3):
        folder = tmp_path / "card" / f"ALL{number:04d}"
        write_isf(folder / f"F{number:04d}CH1.ISF", number)
        (folder / f"F{number:04d}TEK.SET").write_text("*RST")
    return tmp_path / "card"


def test_a_memory_card_is_a_run_of_its_records(card: Path) -> None:
    run = gyrolock.read(card, scale_factor=2000)
    assert (len(run), run.volts.shape) == (3, (3, N))
    assert [Path(record.name).name for record in run] == ["F0000CH1.ISF", "F0001CH1.ISF", "F0002CH1.ISF"]
    assert run.estimates.lock_in_rate == pytest.approx([0.01] * 3, rel=0.02)
    assert repr(run) == f"<Run of gyrolock analyze: 3 records, 3 files, {card}>"
    result = run.result()
    assert result.lock_in_rate_dps == pytest.approx(0.01, rel=0.02)
    assert result.lock_in_rate_noise_u_dps < run.estimates.lock_in_rate_u.min()
    # nothing is known of the bench that the files come from
    assert result.lock_in_rate_u_dps > 10 * result.lock_in_rate_noise_u_dps
    assert result.standing == "doubtful"
    assert result.document["files"] == [record.name for record in run]
    assert len(result.plot().axes) == 2
    assert run.result(relation="paper-10").lock_in_rate_dps != result.lock_in_rate_dps


def test_one_file_gives_what_analyze_gives(card: Path) -> None:
    path = card / "ALL0001" / "F0001CH1.ISF"
    run = gyrolock.read(path, scale_factor=1990)
    assert run.result().document == analyze_file(path, None, {"scale_factor": 1990}).document()
    assert main(["analyze", str(path), "--scale-factor", "1990"]) == 0


def test_paths_in_the_order_that_was_given(card: Path) -> None:
    paths = sorted(card.rglob("*.ISF"), reverse=True)
    assert [record.name for record in gyrolock.read(paths)] == [str(path) for path in paths]


def test_without_a_scale_factor_there_are_records_but_no_rates(card: Path) -> None:
    run = gyrolock.read(card)
    assert run.volts.shape == (3, N)
    with pytest.raises(UsageError, match=r"give scale_factor to gyrolock\.read"):
        _ = run.estimates
    assert run.result(scale_factor=2000).lock_in_rate_dps == pytest.approx(0.01, rel=0.02)


def test_what_cannot_be_read(card: Path) -> None:
    (card / "ALL0002" / "F0002CH1.ISF").write_text("nothing")
    with pytest.raises(FileFormatError, match="F0002CH1"):
        gyrolock.read(card)
    (card / "ALL0002" / "F0002CH1.ISF").unlink()
    with pytest.raises(UsageError, match="ALL0002: holds no run and no CSV or ISF file"):
        gyrolock.read(card / "ALL0002")
    with pytest.raises(FileNotFoundError):
        gyrolock.read(card / "missing.csv")
    with pytest.raises(UsageError, match="no file was given"):
        gyrolock.read([])


def test_records_of_other_lengths_make_no_array(card: Path) -> None:
    path = card / "ALL0000" / "F0000CH1.ISF"
    text = path.read_bytes().replace(b"NR_PT 2500", b"NR_PT 1250").replace(b"2500 points", b"1250 points")
    path.write_bytes(text.replace(b"#42500", b"#41250")[:-1250])
    run = gyrolock.read(card, scale_factor=2000)
    with pytest.raises(UsageError, match=r"records of \[1250, 2500\] samples"):
        _ = run.volts
    assert len(run[0].volts) == 1250
    assert run.estimates.lock_in_rate == pytest.approx([0.01] * 3, rel=0.05)


def test_a_spectrum_gives_no_rate(card: Path) -> None:
    path = card / "ALL0000" / "F0000CH1.ISF"
    path.write_bytes(path.read_bytes().replace(b'XUNIT "s"', b'XUNIT "Hz"'))
    run = gyrolock.read(card, scale_factor=2000)
    with pytest.raises(NoUsableSignal, match=r"F0000CH1\.ISF: is a spectrum"):
        _ = run.estimates


def test_two_inputs_of_one_acquisition_are_not_two_records(card: Path) -> None:
    for number in range(3):
        write_isf(card / f"ALL{number:04d}" / f"F{number:04d}CH2.ISF", number, "Ch2")
    run = gyrolock.read(card, scale_factor=2000)
    assert len(run) == 6
    with pytest.raises(UsageError, match="files of CH1, CH2: give one of them as channel"):
        run.result()
    chosen = gyrolock.read(card, scale_factor=2000, channel="ch2")
    assert [Path(record.name).name for record in chosen] == ["F0000CH2.ISF", "F0001CH2.ISF", "F0002CH2.ISF"]
    assert chosen.result().records == 3
    with pytest.raises(UsageError, match="none of 6 files is of CH3"):
        gyrolock.read(card, channel="CH3")


def test_noise_gives_a_result_that_says_so(card: Path) -> None:
    path = write_isf(card / "noise.isf", 0, amplitude=0.0)
    result = gyrolock.read(path, scale_factor=2000).result()
    assert result.lock_in_rate_dps is None
    assert "No significant beat" in result.problem
    assert result.error == {"kind": "no_usable_signal", "message": result.problem, "exit_code": 4}
    assert repr(result).startswith("<Result of gyrolock analyze: no result (")
    assert len(result.plot().axes) == 1
