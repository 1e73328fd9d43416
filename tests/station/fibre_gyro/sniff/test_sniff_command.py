"""`gyrolock fog sniff`: on files and on a served gyro, in this process."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.fibre_gyro.real_gyros import REAL_GYROS, raw_outputs
from instrument import LinkError
from station.cli import main
from station.fibre_gyro.bench import serve_gyro
from station.fibre_gyro.settings import load_fog_settings
from station.fibre_gyro.sniff import known_formats, read_frame_format, shipped_files, sniff_port

GYROS = {gyro.name: gyro for gyro in REAL_GYROS}
OWN = """
[formats.ours]
kind = "binary"
output_rate_hz = 100.0
header = "A7 3C"
fields = [{ name = "counter", bytes = 1 }, { name = "counts", bytes = 4 }]
"""


def saved(path: Path, name: str) -> Path:
    raw = raw_outputs(GYROS[name], 300, np.random.default_rng(1))
    path.write_bytes(b"".join(GYROS[name].pack(n, one) for n, one in enumerate(raw)))
    return path


def test_a_file_is_recognised(tmp_path, capsys):
    file = saved(tmp_path / "bytes.bin", "packed_7_bits")
    assert main(["fog", "sniff", str(file)]) == 0
    said = capsys.readouterr().out
    assert 'Proposed: link.frame_format = "packed_7_bits"' in said and "no frame of: " in said
    assert main(["fog", "sniff", str(file), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["proposed"] == "packed_7_bits" and document["structure"] is None
    first = document["formats"][0]
    assert first["checksum_hits"] == first["frames"] == 300 and first["bytes_unexplained"] == 0
    assert first["rate_hz"] is None and Path(document["file"]).name == "packed_7_bits.toml"


def test_where_none_fits_the_structure_is_shown_and_a_description_of_ones_own_fits(tmp_path, capsys):
    file = tmp_path / "bytes.bin"
    file.write_bytes(
        b"".join(b"\xa7\x3c" + bytes([n % 256]) + (50_000 + n * n % 977).to_bytes(4, "little") for n in range(300))
    )
    assert main(["fog", "sniff", str(file)]) == 4
    said = capsys.readouterr().out
    assert "No known description fits." in said and "a frame has 7 bytes" in said
    assert "byte 0 is A7, byte 1 is 3C" in said and "counting: byte 2 by 1" in said
    (tmp_path / "own.toml").write_text(OWN)
    assert main(["fog", "sniff", str(file), "--formats", str(tmp_path / "own.toml")]) == 0
    said = capsys.readouterr().out
    assert f'link.frame_format = "ours", link.frame_format_file = "{tmp_path / "own.toml"}"' in said


def test_a_description_that_fits_the_bytes_only_is_doubted(tmp_path, capsys):
    (tmp_path / "own.toml").write_text(
        '[formats.whole]\nkind = "binary"\noutput_rate_hz = 100.0\nheader = "80"\n'
        'fields = [{ name = "counts", bytes = 5 }]\n[formats.whole.checksum]\nkind = "xor8"\n'
    )
    file = saved(tmp_path / "bytes.bin", "packed_7_bits")
    assert main(["fog", "sniff", str(file), "--formats", str(tmp_path / "own.toml"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["proposed"] == "packed_7_bits"
    (whole,) = [one for one in document["formats"] if one["name"] == "whole"]
    assert whole["fits"] and "data_bits = 7" in whole["doubts"][0]


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["/dev/no-such-port"], 3, "cannot open /dev/no-such-port"),
        (["no-such-file.bin"], 2, "no-such-file.bin: cannot be read"),
        (["{empty}"], 2, "is empty"),
        (["{empty}", "--formats", "nowhere.toml"], 2, "nowhere.toml: cannot be read"),
        (["{empty}", "--formats", "{wrong}"], 2, "wrong.toml: formats.mine.kind must be one of ascii, binary"),
    ],
)
def test_what_goes_wrong_is_one_line(tmp_path, capsys, arguments, code, said):
    (tmp_path / "empty.bin").write_bytes(b"")
    (tmp_path / "wrong.toml").write_text('[formats.mine]\nkind = "morse"\n')
    places = {"empty": tmp_path / "empty.bin", "wrong": tmp_path / "wrong.toml"}
    assert main(["fog", "sniff", *(one.format(**places) for one in arguments)]) == code
    error = capsys.readouterr().err
    assert said in error and len(error.splitlines()) == 1


@pytest.mark.slow
def test_a_served_gyro_is_recognised_with_its_clock(capsys):
    settings = load_fog_settings(overrides={"link": {"frame_format": "header_99_66"}})
    layout = read_frame_format(settings)
    with serve_gyro(settings, layout, tcp_port=0, rate_dps=3.0, clock_ppm=25_000.0) as server:
        assert main(["fog", "sniff", server.port, "--seconds", "2", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    first = document["formats"][0]
    assert document["proposed"] == "header_99_66" == first["name"]
    assert abs(first["rate_hz"] - 1025.0) < 4 * first["rate_u_hz"]
    assert document["seconds"] == pytest.approx(2.0, abs=0.5)


@pytest.mark.skipif(sys.platform == "win32", reason="this system has no pseudo-terminals")
def test_a_gyro_that_is_silent_until_it_is_asked():
    settings = load_fog_settings(overrides={"link": {"frame_format": "polled_binary"}})
    formats = known_formats()
    polled = {name: known for name, known in formats.items() if name.startswith("polled")}
    told: list[str] = []
    with serve_gyro(settings, read_frame_format(settings)) as server:
        with pytest.raises(LinkError, match=r"sent nothing in 0\.2 s.* needs --poll"):
            sniff_port(server.port, polled, seconds=0.2, baud=None, poll=False, tell=told.append)
        found = sniff_port(server.port, polled, seconds=0.8, baud=None, poll=True, tell=told.append)
    assert found.proposed is not None and found.proposed.name == "polled_binary"
    assert any("asked as polled_binary does" in line for line in told)


def test_all_shipped_descriptions_are_known_by_different_names():
    formats = known_formats()
    assert len(shipped_files()) >= 9
    assert {gyro.name for gyro in REAL_GYROS} < set(formats)
    assert all(known.shipped for known in formats.values())
