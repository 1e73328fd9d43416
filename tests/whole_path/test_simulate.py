"""`gyrolock simulate` for a scope client that somebody else wrote."""

import os
import signal

import numpy as np
import pytest
import pyvisa

from instrument.simulated.fibre_gyro import GyroServer
from instrument.simulated.links.scope_servers import ScopeServer
from instrument.simulated.links.stream_server import StreamServer
from station.cli import main

POSIX = pytest.mark.skipif(os.name != "posix", reason="there are serial terminals on POSIX only")


def read_like_a_stranger(resource: str) -> tuple[str, np.ndarray, float]:
    """Identity, volts and sample interval by the programmer manual, with PyVISA and nothing of ours."""
    manager = pyvisa.ResourceManager("@py")
    try:
        scope = manager.open_resource(resource, read_termination="\n", write_termination="\n", timeout=15_000)
        identity = scope.query("*IDN?")
        scope.write("HEADER OFF")
        scope.write("DATA:SOURCE CH1")
        scope.write("DATA:ENCDG RIBINARY;WIDTH 1;START 1;STOP 2500")
        preamble = scope.query("WFMPRE?").split(";")
        codes = np.array(scope.query_binary_values("CURVE?", datatype="b"))
        scope.close()
    finally:
        manager.close()
    interval, scale, zero, offset = (float(preamble[i]) for i in (8, 12, 13, 14))
    return identity, (codes - offset) * scale + zero, interval


@pytest.mark.parametrize(
    "where",
    [
        ("--tcp", "0"),
        pytest.param(("--hislip", "0"), marks=pytest.mark.slow),
        pytest.param(("--pty",), marks=POSIX),
        pytest.param(("--pty", "--baud", "19200"), marks=[POSIX, pytest.mark.slow]),
    ],
)
def test_a_plain_pyvisa_client_reads_the_beat(serve_scope, where: tuple[str, ...]) -> None:
    scope = serve_scope(*where)
    identity, volts, interval = read_like_a_stranger(scope.resource)
    assert identity.startswith("TEKTRONIX,TDS 2014,")
    assert volts.shape == (2500,)
    assert np.ptp(volts) == pytest.approx(0.76, rel=0.05)
    assert volts.mean() == pytest.approx(0.12, abs=0.05)
    rising = np.flatnonzero((volts[:-1] < 0.12) & (volts[1:] >= 0.12))
    periods = rising[rising - np.concatenate([[-100], rising[:-1]]) > 20]
    frequency = (len(periods) - 1) / ((periods[-1] - periods[0]) * interval)
    assert frequency == pytest.approx(2000 * np.sqrt(0.08**2 - 0.01**2), rel=0.06)


@pytest.mark.slow
def test_several_scopes_on_other_signals_with_faults(serve_scope, tmp_path) -> None:
    times = 1e-5 * np.arange(1000)
    np.savetxt(tmp_path / "ramp.csv", np.column_stack([times, times / 1e-2]), delimiter=",", header="s,V")
    shown = ("--signal", "ramp.csv", "--signal", "CH2=square:1000:0.5")
    served = serve_scope("--hislip", "0", *shown, "--model", "TDS2014", "--model", "TDS1002")
    second = served.process.stdout.readline().strip()
    manager = pyvisa.ResourceManager("@py")
    for name, model in ((served.resource, "TDS 2014"), (second, "TDS 1002")):
        with manager.open_resource(name, timeout=15_000) as scope:
            assert model in scope.query("*IDN?")
            scope.write("HEADER OFF;:DATA:ENCDG RIBINARY;:MEASU:IMM:SOURCE CH1;TYPE PK2PK")
            assert float(scope.query("MEASU:IMM:VALUE?")) == pytest.approx(1.0, abs=0.1)
            scope.write("MEASU:IMM:SOURCE CH2;TYPE FREQUENCY")
            assert float(scope.query("MEASU:IMM:VALUE?")) == pytest.approx(1000.0, rel=0.02)
    manager.close()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_ends_cleanly(serve_scope, number: int) -> None:
    scope = serve_scope("--tcp", "0")
    assert scope.resource.startswith("TCPIP0::127.0.0.1::")
    scope.process.send_signal(number)
    assert scope.process.wait(timeout=20) == 0


def test_it_must_be_told_where(gyrolock) -> None:
    assert gyrolock("simulate").code == 2
    assert gyrolock("simulate", "--tcp", "0", "--pty").code == 2
    assert gyrolock("simulate", "--tcp", "0", "--baud", "9600").code == 2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--signal", "none.csv"), "no such file"),
        (("--signal", "CH9=sine"), "no channel"),
        (("--signal", "sine:fast"), "with numbers"),
        (("--signal", "sine", "--signal", "CH1=square"), "two signals"),
        (("--signal", "CH3=sine", "--model", "TDS1002"), "has no CH3"),
        (("--model", "TDS9999"), "TDS9999"),
        (("--faults", "gremlins"), "choose one of"),
        (("--faults", "cut answer:often"), "no number from 0 to 1"),
    ],
)
def test_what_cannot_be_simulated_is_told(options, words, capsys) -> None:
    assert main(("simulate", "--tcp", "0", *options)) == 2
    assert words in capsys.readouterr().err


@pytest.mark.slow
def test_a_taken_port_is_told(gyrolock, serve_scope) -> None:
    port = serve_scope("--tcp", "0").resource.split("::")[2]
    done = gyrolock("simulate", "--tcp", port, "--json")
    assert done.code == 2
    assert "in use" in done.document["error"]["message"]


@pytest.mark.parametrize("command", [("simulate", "--tcp", "0"), ("fog", "serve", "--tcp", "0")])
def test_a_server_that_fails_ends_the_command(command, monkeypatch, capsys) -> None:
    """It must not look like an instrument that is silent."""

    def fail(server: StreamServer) -> float:
        raise RuntimeError("the model has failed")

    for server in (ScopeServer, GyroServer):
        monkeypatch.setattr(server, "_pause", fail)
    assert main(command) == 70
    assert "the model has failed" in capsys.readouterr().err
