"""The scale factor of a real gyro: given, asked for at a terminal, or refused; never assumed."""

import io
import sys
from pathlib import Path

import pytest

from station.cli import main
from station.errors import UsageError
from station.lock_in.settings import check_scale_factor, load_settings
from station.terminal import ask_number


class Terminal(io.StringIO):
    """A terminal on which somebody types."""

    def isatty(self) -> bool:
        return True


def test_it_is_asked_for_until_it_is_a_number(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", Terminal("many\n-3\nnan\n\n1850,5\n"))
    assert ask_number("Pulses per degree: ", "nobody there") == 1850.5
    assert capsys.readouterr().err.count("Pulses per degree") == 5
    monkeypatch.setattr(sys, "stdin", io.StringIO("1850\n"))
    with pytest.raises(UsageError, match="nobody there"):
        ask_number("Pulses per degree: ", "nobody there")


@pytest.mark.parametrize("command", ["measure", "acquire"])
def test_a_named_scope_needs_one(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    somewhere = [command, "--resource", "ASRL/dev/no-such-port::INSTR"]
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    assert main(somewhere) == 2
    assert "--scale-factor" in capsys.readouterr().err
    # with it the program goes on to open the scope
    assert main([*somewhere, "--scale-factor", "1850"]) == 3
    assert "no-such-port" in capsys.readouterr().err
    Path("my.toml").write_text("[gyro]\nscale_factor_pulses_per_deg = 1850.0\n")
    assert main([*somewhere, "--config", "my.toml"]) == 3
    monkeypatch.setattr(sys, "stdin", Terminal("1850\n"))
    capsys.readouterr()
    assert main(somewhere) == 3
    told = capsys.readouterr().err
    assert "Scale factor" in told
    assert "no-such-port" in told


def test_a_simulated_gyro_has_its_own(tmp_path: Path) -> None:
    check_scale_factor(load_settings())
    with pytest.raises(UsageError, match="1 : 1"):
        check_scale_factor(load_settings(resource="GPIB0::1::INSTR"))
