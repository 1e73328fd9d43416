"""The command line itself: help, version, list, doctor, and how numbers are written."""

import json
import re
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest

from instrument.simulated import SimulatedTDS2014, TcpServer
from station import cli
from station.cli import main
from station.commands.doctor import examine
from station.lock_in.settings import default_settings
from station.results.result import with_prefix, with_uncertainty
from station.shell.options import CHANNELS

HEAVY = ("numpy", "scipy", "pyvisa", "matplotlib", "pydantic", "rich", "jinja2")

CONFIG_CHANGES_NOTHING = (  # they take it, for scripts that give it to every command, and do not show it
    "start", "runs", "annotate", "export", "verify", "history", "salvage", "status", "stop", "study", "list",
    "panel",
)  # fmt: skip


def test_a_settings_file_with_a_mistake_is_one_where_nothing_of_it_is_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bench.toml").write_text("= 2")
    assert main(["runs", str(tmp_path), "--config", str(tmp_path / "bench.toml")]) == 2
    assert "bench.toml" in capsys.readouterr().err


@pytest.mark.parametrize("command", list(cli.COMMANDS))
def test_every_command_has_help_json_and_config(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command, "--help"]) == 0
    text = capsys.readouterr().out
    assert "--json" in text
    found = cli.gyrolock.get_command(click.Context(cli.gyrolock), command)
    assert found is not None
    taken = any("--config" in one.opts for one in found.params)
    # a campaign is its own settings file; the tests of `fog` take it
    assert taken or "FILE" in text.splitlines()[0] or "--config" in text
    assert ("\n  --config" in text) == (taken and command not in CONFIG_CHANGES_NOTHING)
    first = cli.COMMANDS[command][1].split(":")[0].rstrip(".")
    assert first.split(",")[0] in " ".join(text.split())


def test_help_names_every_command_and_imports_nothing_heavy() -> None:
    program = (
        "import sys; from station.cli import main; main(['--help']); "
        f"print([name for name in {HEAVY} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert all(name in done.stdout for name in cli.COMMANDS)
    assert done.stdout.splitlines()[-1] == "[]"


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("gyrolock, version ")


def test_errors_are_json_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["measure", "--json", "--nonsense"]) == 2
    captured = capsys.readouterr()
    assert json.loads(captured.out)["error"]["exit_code"] == 2
    assert captured.err.startswith("gyrolock: ")
    assert main(["nonsense"]) == 2


@pytest.mark.parametrize(
    ("arguments", "swallows", "swallowed"),
    [
        (["export", "run", "--tek-csv", "--to", "x"], "--tek-csv", "--to"),
        (["fog", "selfcal", "--unit", "--no-report"], "--unit", "--no-report"),
        (["measure", "--rates", "--records", "4"], "--rates", "--records"),
    ],
)
def test_an_option_is_no_value_of_another(
    arguments: list[str], swallows: str, swallowed: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert f"{swallows} needs a value, and {swallowed} is an option" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_an_option_whose_value_may_be_left_out_stands_before_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "campaign.toml").write_text('[[step]]\nname = "a"\nmeasurement = "measure"\n')
    assert main(["station", "campaign.toml", "--unit", "1", "--resume", "--quiet"]) == 2
    assert "needs a value" not in capsys.readouterr().err


def test_a_defect_of_the_program_is_one_line_too(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("oh")

    monkeypatch.setattr("instrument.find_resources", broken)
    assert main(["list", "--json"]) == 70
    captured = capsys.readouterr()
    assert json.loads(captured.out)["error"]["kind"] == "defect"
    assert "Traceback" not in captured.err
    monkeypatch.setenv("GYROLOCK_TRACEBACK", "1")
    assert main(["list"]) == 70
    assert "ZeroDivisionError" in capsys.readouterr().err


def test_doctor_finds_a_whole_installation(capsys: pytest.CaptureFixture[str]) -> None:
    checks = {check.name: check for check in examine(default_settings(), resource="ASRL/dev/no-such-port::INSTR")}
    for name in ("Python", "packages", "settings", "VISA", "SQLite", "test record"):
        assert checks[name].state == "ok", checks[name]
    assert "2500 points" in checks["test record"].text
    assert checks["resource"].state == "bad"
    assert "no-such-port" in checks["resource"].text


def test_doctor_command_tells_an_instrument_that_is_not_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--resource", "ASRL/dev/no-such-port::INSTR", "--json"]) == 3
    document = json.loads(capsys.readouterr().out)
    assert document["ok"] is False
    assert {"name", "state", "text"} == document["checks"][0].keys()


@pytest.mark.parametrize(
    ("value", "u", "text"),
    [
        (0.01, 0.00001, "0.010000(10)"),
        (0.01, 0.0000996, "0.01000(10)"),
        (1234.5, 120.0, "1234(120)"),
        (-3.25, 0.5, "-3.25(50)"),
        (5.0, 0.0, "5"),
        (float("nan"), 1.0, "none"),
        (2.0, float("inf"), "2"),
    ],
)
def test_values_with_uncertainty(value: float, u: float, text: str) -> None:
    assert with_uncertainty(value, u) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0 V"), (-0.38, "-380 mV"), (2.5e-9, "2.5 nV"), (1e-12, "1e-12 V"), (3.2e6, "3.2 MV")],
)
def test_values_with_prefix(value: float, text: str) -> None:
    assert with_prefix(value, "V") == text


@pytest.mark.parametrize("group", [[], ["fog"]])
def test_a_group_alone_shows_its_help(group: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(group) == 2
    said = capsys.readouterr()
    assert len(said.out.splitlines()) > 10
    assert said.err == ""


FLAT = 9.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("error", "state"), [(0.0, "ok"), (0.04, "bad"), (-0.1, "bad"), (0.015, "bad"), (None, "bad"), (FLAT, "bad")]
)
def test_doctor_sees_a_probe_that_is_not_compensated(
    error: float | None, state: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def comp(times: np.ndarray) -> np.ndarray:
        """PROBE COMP, 5 V at 1 kHz, through a divider whose capacitors are off: the edge dies away in 100 us."""
        if error is None:
            return np.sin(2e3 * np.pi * times)
        if error == FLAT:
            return np.zeros_like(times)
        into, sign = np.mod(times, 5e-4), 1 - 2 * (np.floor(times / 5e-4) % 2)
        # of the periodic answer to a step of 5 V
        return 2.5 + sign * (2.5 + 5 * error * np.exp(-into / 1e-4) / (1 + np.exp(-5.0)))

    with TcpServer(SimulatedTDS2014({1: comp}, noise_levels=0.3, seed=4)) as server:
        code = main(["doctor", "--resource", server.resource_name, "--probe", "CH1", "--json"])
    checks = {one["name"]: one for one in json.loads(capsys.readouterr().out)["checks"]}
    assert (checks["probe"]["state"], code) == (state, 3 if state == "bad" else 0)
    if error in (None, FLAT):
        assert "PROBE COMP" in checks["probe"]["text"]
    elif error:
        told = float(re.search(r"edge is ([\d.]+)%", checks["probe"]["text"])[1])
        assert told == pytest.approx(100 * abs(error), rel=0.15, abs=0.3)
        assert ("too high" in checks["probe"]["text"]) == (error > 0)


@pytest.mark.parametrize(
    ("name", "taken"), [("CH2", "CH2"), ("ch3", "CH3"), ("1", "CH1"), ("CH5", None), ("0", None)]
)
def test_a_channel_is_named_as_people_write_it(name: str, taken: str | None) -> None:
    if taken is None:
        with pytest.raises(click.BadParameter, match="'CH1', 'CH2', 'CH3', 'CH4'"):
            CHANNELS.convert(name, None, None)
    else:
        assert CHANNELS.convert(name, None, None) == taken
