"""`gyrolock grab` on the simulated scope: its files hold what the screen shows."""

import io
import json

import numpy as np
import pytest
from PIL import Image

from instrument.simulated import SimulatedTDS2014, TcpServer
from station.cli import main


@pytest.fixture
def server():
    signals = {1: lambda t: np.sin(6283.2 * t), 2: lambda t: 0.3 * np.sin(6283.2 * t)}
    scope = SimulatedTDS2014(signals, noise_levels=0.0)
    for _ in scope.execute(b"CH1:PROBE 1;SCALE 0.5;:CH2:PROBE 1;SCALE 0.1;:SELECT:CH2 ON"):
        pass
    with TcpServer(scope) as server:
        yield server


def test_screen_and_traces(server, tmp_path, capsys):
    assert main(("grab", "--resource", server.resource_name, "--to", str(tmp_path / "new"), "--json")) == 0
    (grab,) = json.loads(capsys.readouterr().out)["grabs"]
    assert grab["traces"]["CH1"]["peak_to_peak_v"] == pytest.approx(2.0, abs=0.05)
    assert grab["traces"]["CH2"]["frequency_hz"] == pytest.approx(1000.0, rel=0.01)
    files = {path.suffix: path for path in (tmp_path / "new").iterdir()}
    assert sorted(map(str, files.values())) == sorted(grab["files"])
    assert Image.open(io.BytesIO(files[".png"].read_bytes())).size == (320, 240)
    table = np.genfromtxt(files[".csv"], delimiter=",", names=True)
    kept = np.load(files[".npz"])
    assert table.dtype.names == ("CH1_time_s", "CH1_volts", "CH2_time_s", "CH2_volts")
    assert np.allclose(table["CH2_volts"], kept["CH2_volts"]) and np.ptp(kept["CH2_volts"]) == pytest.approx(
        0.6, abs=0.01
    )
    assert kept["CH1_codes"].dtype == np.int8 and "Ch1" in str(kept["CH1_preamble"])


def test_a_stopped_scope_keeps_what_it_holds(server, tmp_path, capsys):
    for _ in server.scope.execute(b"ACQ:STOPA SEQ;STATE RUN"):
        pass
    while server.scope.busy():
        server.scope.clock.sleep(0.001)
    before = server.scope.acquisition.latest().number
    options = ("--resource", server.resource_name, "--to", str(tmp_path), "--no-screen", "--channel", "ch1")
    assert main(("grab", *options)) == 0
    assert server.scope.acquisition.latest().number == before
    assert "CH1: 2" in capsys.readouterr().out
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".csv", ".npz"]


def test_a_clipped_trace_says_so(server, capsys):
    for _ in server.scope.execute(b"CH1:SCALE 0.1"):
        pass
    server.scope.clock.sleep(0.1)
    assert main(("grab", "--resource", server.resource_name, "--numbers", "--channel", "CH1")) == 0
    assert "clipped: more than 1.0" in capsys.readouterr().out


def test_numbers_of_the_simulated_scope_write_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(("grab", "--numbers")) == 0
    assert "Vpp" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_grabbed_is_told(server, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert (
        main(("grab", "--resource", server.resource_name, "--no-screen", "--to", str(tmp_path / "file" / "x")))
        == 5
    )
    assert main(("grab", "--resource", "TCPIP0::127.0.0.1::1::SOCKET")) == 3
    assert "cannot" in capsys.readouterr().err
