"""A session written down, and the same session again with what was written."""

import json
import zipfile
from itertools import pairwise

import numpy as np
import pytest

from instrument import TDS2014, FileFormatError
from instrument.simulated import SimulatedTDS2014, TcpServer
from instrument.simulated.controllers import LineServer, Replay
from instrument.text_files import Transcript, read_transcript, recorded
from station.cli import main


def session(name):
    with TDS2014(name) as scope:
        scope.set_channel("CH1", probe=1, scale=0.5)
        return scope.identity.text, scope.acquire("CH1"), scope.measure("PK2PK", "CH1").value


@pytest.fixture
def taken(tmp_path):
    path = tmp_path / "session.jsonl"
    with TcpServer(SimulatedTDS2014({1: lambda t: np.sin(6283.0 * t)})) as server, recorded(path):
        found = session(server.resource_name)
    return path, found


def test_the_same_session_again_byte_for_byte(taken):
    path, (identity, record, volts) = taken
    replay = Replay(read_transcript(path))
    with LineServer(replay, tcp_port=0) as server:
        again = session(server.resource_name)
        assert replay.unknown == []
    assert again == (identity, record, volts)
    assert np.array_equal(again[1].codes, record.codes)


def test_lines_are_readable_and_in_their_order(taken):
    path, (identity, *_) = taken
    entries = [json.loads(line) for line in path.read_text().splitlines()]
    assert [entry["did"] for entry in entries][:1] == ["open"] and entries[-1]["did"] == "close"
    assert any(entry.get("text", "").startswith(identity) for entry in entries)
    assert all(first["at"] <= second["at"] for first, second in pairwise(entries))


def test_a_transcript_is_bounded(tmp_path):
    with (tmp_path / "small").open("w") as file:
        transcript = Transcript(file, largest=300)
        for _ in range(100):
            transcript.note("X", "write", b"CH1:SCALE?\n")
    lines = (tmp_path / "small").read_text().splitlines()
    assert json.loads(lines[-1])["did"] == "full" and len(lines) < 6


@pytest.mark.parametrize("line", ["no json", "{}", '{"link": "X", "did": "write", "base64": "?"}', "[1]"])
def test_what_is_no_transcript_is_told(tmp_path, line, capsys):
    path = tmp_path / "bad"
    path.write_text(line + "\n")
    with pytest.raises(FileFormatError, match="line 1"):
        read_transcript(path)


def test_a_bundle_for_a_bug_report(tmp_path, capsys):
    path = tmp_path / "report.zip"
    with TcpServer(SimulatedTDS2014({1: lambda t: np.sin(6283.0 * t)})) as server:
        main(("doctor", "--resource", server.resource_name, "--bundle", str(path)))
    with zipfile.ZipFile(path) as bundle:
        names = ["versions.json", "settings.json", "findings.json", "transcript.jsonl"]
        assert bundle.namelist() == names
        found = {name: bundle.read(name).decode() for name in names}
    assert json.loads(found["versions.json"])["pyvisa"]
    assert any(check["name"] == "resource" for check in json.loads(found["findings.json"]))
    assert "*IDN?" in found["transcript.jsonl"]


def test_a_command_writes_its_transcript(tmp_path, capsys):
    path = tmp_path / "grab.jsonl"
    with TcpServer(SimulatedTDS2014({1: lambda t: np.sin(6283.0 * t)})) as server:
        options = ("--resource", server.resource_name, "--numbers", "--transcript", str(path))
        assert main(("grab", *options)) == 0
    assert any(b"CURV" in one.message.upper() or b"WAVF" in one.message.upper() for one in read_transcript(path))
    assert main(("grab", "--numbers", "--transcript", str(tmp_path / "none" / "x"))) == 2
    assert "cannot be written" in capsys.readouterr().err
