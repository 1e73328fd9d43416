"""What goes wrong on a bench: one clear line, the right exit code, nothing lost."""

import itertools
import json
import os
import re
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from station.runs.store import open_run

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals and serial terminals are those of POSIX")


def last_line(text: str) -> str:
    return text.strip().splitlines()[-1]


GIVEN = ("--scale-factor", "2000")


def only_run(folder: Path) -> Path:
    (path,) = (folder / "runs").glob("*/run.sqlite")
    return path


def wait_for_records(folder: Path, count: int) -> None:
    deadline = time.monotonic() + 40
    while time.monotonic() < deadline:
        for path in (folder / "runs").glob("*/run.sqlite"):
            if len(open_run(path).taken_for("measure")) >= count:
                return
        time.sleep(0.05)
    raise AssertionError("the records did not come")


@pytest.mark.slow
@pytest.mark.parametrize("how", ["SIGINT", pytest.param("SIGKILL", marks=pytest.mark.slow)])
def test_ctrl_c_and_kill_leave_a_valid_run(tmp_path: Path, cut_gyrolock, serve_scope, how: str) -> None:
    scope = serve_scope("--tcp", "0", "--config", "ideal.toml")
    ended = cut_gyrolock(how, 3, "measure", "--resource", scope.resource, *GIVEN, "--records", 10_000, "--json")
    run = open_run(only_run(tmp_path))
    assert len(run.taken_for("measure")) >= 3
    assert all(record.intact for record in run.records)
    if how == "SIGKILL":
        assert "outcome" not in run.facts
        return
    err = ended.err
    assert ended.code == 130, err
    result = ended.document
    assert result["error"]["kind"] == "interrupted"
    assert result["records"] == len(run.taken_for("measure"))
    assert abs(result["lock_in_rate_dps"] - 0.01) < 5 * result["lock_in_rate_u_dps"]
    assert "interrupted" in last_line(err)
    assert "Traceback" not in err
    assert run.facts["outcome"]["exit_code"] == 130
    assert (run.path.parent / "report.html").exists()


@pytest.mark.slow
def test_a_scope_switched_off_loses_nothing(tmp_path: Path, start_gyrolock, serve_scope) -> None:
    scope = serve_scope("--tcp", "0", "--config", "ideal.toml")
    (tmp_path / "my.toml").write_text(f'[scope]\nresource = "{scope.resource}"\nreconnect_s = 1.0\n')
    process = start_gyrolock("measure", "--config", "my.toml", *GIVEN, "--records", 10_000, "--json")
    wait_for_records(tmp_path, 3)
    scope.switch_off()
    out, err = process.communicate(timeout=60)
    assert process.returncode == 3, err
    result = json.loads(out)
    assert result["error"]["exit_code"] == 3
    assert result["records"] >= 3
    assert abs(result["lock_in_rate_dps"] - 0.01) < 5 * result["lock_in_rate_u_dps"]
    assert open_run(tmp_path / result["run"]).facts["outcome"]["kind"] == "link"
    assert "Traceback" not in err
    assert len(last_line(err)) < 300


@pytest.mark.parametrize("name", ["NONSENSE", "ASRL/dev/no-such-port::INSTR", "TCPIP0::127.0.0.1::1::SOCKET"])
def test_a_wrong_resource_name(gyrolock, tmp_path: Path, name: str) -> None:
    done = gyrolock("measure", "--resource", name, *GIVEN, "--json")
    assert done.code == 3
    assert done.document["error"]["exit_code"] == 3
    assert name in last_line(done.err)
    assert len(done.err.strip().splitlines()) == 1
    assert not (tmp_path / "runs").exists()


@pytest.fixture
def other_instrument() -> Iterator[str]:
    """A voltmeter on a socket: it answers `*IDN?` and nothing else."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.1)
        ended = threading.Event()

        def answer() -> None:
            while not ended.is_set():
                try:
                    client, _ = server.accept()
                except TimeoutError:
                    continue
                with client:
                    client.settimeout(5)
                    while data := client.recv(4096):
                        if b"*IDN?" in data:
                            client.sendall(b"ACME,VOLTMETER 7,123,1.0\n")

        thread = threading.Thread(target=answer)
        thread.start()
        yield f"TCPIP0::127.0.0.1::{server.getsockname()[1]}::SOCKET"
        ended.set()
        thread.join()


@pytest.mark.slow
def test_a_wrong_instrument(gyrolock, other_instrument: str) -> None:
    done = gyrolock("measure", "--resource", other_instrument, *GIVEN, "--json")
    assert done.code == 3
    assert done.document["error"]["kind"] == "wrong_instrument"
    assert "ACME" in last_line(done.err)


@pytest.mark.parametrize(
    ("content", "arguments", "said"),
    [
        ('[simulation]\nscope_model = "TDS2002"\n[scope]\nchannel = "CH3"\n', (), "CH3"),
        ("", ("--channel", "CH9"), "CH9"),
        ("[scope\n", (), "not valid TOML"),
        ("[scope]\ncolour = 3\n", (), "scope.colour"),
        ('[simulation]\nscope_model = "HP 54600"\n', (), "scope_model"),
        ("", ("--records", "0"), "--records"),
        ("", ("--frobnicate",), "frobnicate"),
        ("", ("--resource", "X", "--scale-factor", "2000", "--seed", "1"), "--seed"),
        ("[measurement]\nrecords = 2\n", ("--out", "my.toml"), "my.toml"),
        ('[scope]\nresource = "X"\n[table]\nkind = "manual"\n', GIVEN, "terminal"),
        ('[scope]\nresource = "X"\n', (), "--scale-factor"),
        ("", ("--rates", "8,many"), "--rates"),
        ("", ("--scale-factor", "nan"), "--scale-factor"),
    ],
)
def test_mistakes_of_the_user(
    gyrolock, tmp_path: Path, content: str, arguments: tuple[str, ...], said: str
) -> None:
    (tmp_path / "my.toml").write_text(content)
    done = gyrolock("measure", "--config", "my.toml", *arguments, "--json")
    assert done.code == 2, (done.out, done.err)
    assert said in done.document["error"]["message"]
    assert said in last_line(done.err)
    assert not (tmp_path / "runs").exists()


def test_a_missing_settings_file(gyrolock) -> None:
    done = gyrolock("measure", "--config", "absent.toml", "--json")
    assert done.code == 2
    assert "absent.toml" in done.document["error"]["message"]


@pytest.mark.parametrize("command", ["analyze", "report"])
def test_files_that_cannot_be_read(gyrolock, tmp_path: Path, command: str) -> None:
    (tmp_path / "noise.bin").write_bytes(bytes(range(256)) * 40)
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    for name in ("absent.csv", "noise.bin", "empty", "folder"):
        done = gyrolock(command, name, "--json")
        assert done.code == 2, (name, done.out, done.err)
        assert name in done.document["error"]["message"]
        assert len(done.err.strip().splitlines()) == 1


def test_one_unreadable_path_does_not_keep_the_others(gyrolock) -> None:
    run = gyrolock("measure", "--config", "ideal.toml", "--records", 1, "--json", "--no-report").document["run"]
    done = gyrolock("analyze", "absent.csv", run, "--json")
    assert done.code == 2
    missing, good = done.document["results"]
    assert missing["error"]["exit_code"] == 2
    assert good["lock_in_rate_dps"] == pytest.approx(0.01, rel=0.05)


def test_an_empty_run_and_a_damaged_record(gyrolock, tmp_path: Path) -> None:
    import sqlite3

    result = gyrolock("measure", "--config", "ideal.toml", "--records", 3, "--json", "--no-report").document
    db = sqlite3.connect(tmp_path / result["run"])
    db.execute("UPDATE record SET payload = zeroblob(2500) WHERE number = (SELECT max(number) FROM record)")
    db.commit()
    done = gyrolock("analyze", result["run"], "--json")
    assert done.code == 0
    assert done.document["records_rejected"] == 1
    assert "damaged" in done.document["flags"]
    db.execute("DELETE FROM record WHERE purpose = 'measure'")
    db.commit()
    db.close()
    done = gyrolock("analyze", result["run"], "--json")
    assert done.code == 2
    assert "no record" in done.document["error"]["message"]


@pytest.mark.slow
def test_noise_that_leaves_no_lock_in_at_all(gyrolock, tmp_path: Path) -> None:
    """Exactly 0 in about every third run; it has an uncertainty, a budget and a report all the same."""
    clean = "second_harmonic_dbc = -150.0\nthird_harmonic_dbc = -150.0\npump_ripple = 0.0\n"
    settings = f"[simulation]\nlock_in_rate_dps = 0.0\n[simulation.contaminants]\n{clean}"
    (tmp_path / "none.toml").write_text(settings, encoding="utf-8")
    exact: list[str] = []
    for seed in itertools.takewhile(lambda _: not exact, range(1, 13)):
        done = gyrolock("measure", "--config", "none.toml", "--rates", 8, "--records", 2, "--seed", seed, "--json")
        assert done.code == 0, done.err
        found = done.document
        assert found["lock_in_rate_low_95_dps"] == 0
        assert 0 < found["lock_in_rate_u_dps"] < found["lock_in_rate_high_95_dps"]
        assert found["budget"]["combined_u_dps"] > 0
        assert "ratio_not_significant" in found["flags"]
        assert not any("inf" in one for one in found["table_check"]["sentences"])
        if found["lock_in_rate_dps"] == 0:
            page = Path(tmp_path, found["run"]).parent / "report.html"
            exact.append(page.read_text(encoding="utf-8"))
    assert exact
    assert all(re.search(r"combined u = [0-9.e-]+ deg/s", page) for page in exact)
