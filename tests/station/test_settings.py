"""Settings: shipped defaults, what a user's file may hold, and every mistake named."""

from pathlib import Path

import pytest

from station.cli import main
from station.errors import SettingsError
from station.lock_in.settings import default_settings, load_settings
from station.settings import shipped_settings


def write(folder: Path, text: str) -> Path:
    file = folder / "my.toml"
    file.write_text(text, encoding="utf-8")
    return file


def test_shipped_files_hold_the_papers_bench() -> None:
    settings = default_settings("simulated")
    assert settings.simulated
    assert settings.simulation is not None
    assert settings.gyro.scale_factor_pulses_per_deg == 2000
    assert settings.simulation.lock_in_rate_dps == 0.01
    assert settings.simulation.tilt_deg == 88.693
    assert settings.site.latitude_deg == 28.2
    assert settings.rates_are_chosen
    assert default_settings("bench").simulation is None


@pytest.mark.parametrize("name", ["simulated", "bench"])
def test_every_setting_of_a_shipped_file_has_a_comment(name: str) -> None:
    lines = shipped_settings(name).read_text(encoding="utf-8").splitlines()
    sections = [line for line in lines if line.startswith("[")]
    assert len(sections) >= 6
    assert sum(line.startswith("#") for line in lines) >= 25


def test_a_file_need_only_hold_what_differs(tmp_path: Path) -> None:
    settings = load_settings(write(tmp_path, "[measurement]\nrecords = 7\n"))
    assert settings.measurement.records == 7
    assert settings.measurement.fill_levels == default_settings().measurement.fill_levels


def test_a_named_resource_selects_the_real_bench(tmp_path: Path) -> None:
    settings = load_settings(write(tmp_path, "[measurement]\nrecords = 7\n"), resource="GPIB0::1::INSTR")
    assert not settings.simulated
    assert settings.simulation is None
    assert (settings.table.kind, settings.measurement.records) == ("none", 7)
    in_file = load_settings(write(tmp_path, '[scope]\nresource = "GPIB0::1::INSTR"\n'))
    assert in_file.scope.resource == "GPIB0::1::INSTR"
    assert in_file.table.kind == "none"


def test_a_copy_of_the_simulated_file_serves_a_real_scope() -> None:
    settings = load_settings(shipped_settings("simulated"), resource="GPIB0::1::INSTR")
    assert settings.table.kind == "none"
    assert settings.simulation is None


def test_the_command_line_wins_over_the_file(tmp_path: Path) -> None:
    file = write(tmp_path, "[measurement]\nrecords = 7\n")
    assert load_settings(file, overrides={"measurement": {"records": 3}}).measurement.records == 3


def test_every_mistake_is_named_with_its_place(tmp_path: Path) -> None:
    file = write(
        tmp_path, '[table]\nfast_rate_dps = -1\nspeed = 2\n[measurement]\nrecords = "many"\n[motor]\non = true\n'
    )
    with pytest.raises(SettingsError) as caught:
        load_settings(file)
    text = str(caught.value)
    assert str(file) in text
    for place in (
        "table.fast_rate_dps",
        "table.speed (line 3): no such setting",
        "measurement.records",
        "motor (line 6): no such setting",
    ):
        assert place in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"[measurement\n", "not valid TOML"),
        (b"\xff\xfe", "not UTF-8"),
        (b"table = 3\n", "table"),
        (b"scope = 3\n", "scope"),
        (b"[table]\nkind = 'manual'\n", "table.kind"),
        (b"[gyro]\nscale_factor_pulses_per_deg = inf\n", "scale_factor_pulses_per_deg"),
        (b"[beams]\nchannels = ['CH2', 'CH3', 'CH4']\n", "at most 2 items, not ['CH2', 'CH3', 'CH4']"),
        (b"[scope]\nchannel = 'CH9'\n", "scope.channel (line 2): input should be 'CH1', 'CH2', 'CH3' or 'CH4'"),
    ],
)
def test_broken_files_give_one_clear_line(tmp_path: Path, content: bytes, said: str) -> None:
    file = tmp_path / "broken.toml"
    file.write_bytes(content)
    with pytest.raises(SettingsError) as caught:
        load_settings(file)
    assert said in str(caught.value)
    assert str(file) in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_missing_file_and_a_directory_are_told(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="cannot be read"):
        load_settings(tmp_path / "absent.toml")
    with pytest.raises(SettingsError, match="is a directory"):
        load_settings(tmp_path)


def test_settings_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="frozen"):
        default_settings().measurement.records = 3


@pytest.mark.parametrize("rates", ["1.02", "3,-8", "8,nan", "1e9"])
def test_a_wrong_option_is_told_as_that_option(rates: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["measure", "--rates", rates]) == 2
    said = capsys.readouterr().err
    assert said.startswith("gyrolock: --rates: ")
    assert ".toml" not in said
