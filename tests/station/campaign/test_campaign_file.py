"""A campaign file: what may stand in it, and how its mistakes are told."""

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jsonschema
import pytest

from station.campaign.file import campaign_schema, read_campaign
from station.cli import main
from station.errors import SettingsError
from station.results.verdict import Limit
from station.settings import line_of, read_toml, shipped_settings

Write = Callable[..., Path]


def test_a_unit_is_laid_over_the_bench_and_a_step_over_both(campaign: Write) -> None:
    more = "\n[step.settings.simulation]\nlock_in_rate_dps = 0.02\n"
    plan = read_campaign(campaign(more=more), "GOOD")
    truth = [step.settings["simulation"]["lock_in_rate_dps"] for step in plan.steps]
    assert truth == [0.009, 0.02]
    assert read_campaign(campaign(), "other").steps[0].settings["simulation"]["lock_in_rate_dps"] == 0.01
    assert plan.steps[0].limits == (Limit("lock_in_rate_dps", None, 0.010, "U95", 0.5),)
    assert plan.steps[1].limits[0].rule == "none"
    assert plan.simulated


def test_every_repeat_of_every_unit_has_noise_of_its_own_the_same_each_time(campaign: Write) -> None:
    file = campaign(('measurement = "measure"', 'measurement = "measure"\nrepeat = 3'))
    seeds = [
        [step.settings["simulation"]["seed"] for step in read_campaign(file, unit).steps]
        for unit in ("GOOD", "BAD")
    ]
    assert len({*seeds[0], *seeds[1]}) == 8
    assert [step.settings["simulation"]["seed"] for step in read_campaign(file, "GOOD").steps] == seeds[0]
    assert [step.key for step in read_campaign(file, "GOOD").steps][2:] == ["01 first, 3 of 3", "02 second"]


def test_all_mistakes_are_told_at_once_with_line_and_suggestion(campaign: Write) -> None:
    file = campaign(
        ("[bench.measurement]", "[bench.mesurement]\nrecords = 1\n[bench.measurement]"),
        ("tilt_records = 1", "tilt_recrods = 1"),
        ("lock_in_rate_dps = 0.009", 'lock_in_rate_dps = "small"'),
        ('number = "lock_in_rate_dps"', 'number = "lock_in_rat_dps"'),
        ('measurement = "measure"', 'measurement = "measure"\nrepeats = 2'),
    )
    with pytest.raises(SettingsError) as told:
        read_campaign(file, "GOOD")
    lines = file.read_text().splitlines()
    for written, said in (
        ("[bench.mesurement]", "no such setting; did you mean measurement?"),
        ("tilt_recrods = 1", "no such setting; did you mean tilt_records?"),
        ('lock_in_rate_dps = "small"', "valid number"),
        ('number = "lock_in_rat_dps"', "did you mean lock_in_rate_dps?"),
        ("repeats = 2", "did you mean repeat?"),
    ):
        line = lines.index(written) + 1
        assert f"(line {line})" in str(told.value), written
        assert said in str(told.value)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (('measurement = "measure"', 'measurement = "mesure"'), "did you mean measure?"),
        (("at_most = 0.010", "at_most = 0.010\nat_least = 0.02"), "at_least must lie below at_most"),
        (("at_most = 0.010", "at_mst = 0.010"), "did you mean at_most?"),
        (('name = "second"', 'name = "first"'), "is the name of another step already"),
        (("attempts = 3", "attempts = 0"), "greater than or equal to 1"),
        (
            ('measurement = "measure"', 'measurement = "measure"\nconditions = { voltage_v = 5.0 }'),
            "power_supply]",
        ),
        (("[bench.budget]", "[bench.limits]\ntilt_deg = 3.0\n[bench.budget]"), "[[step.limit]]"),
        (("[bench.budget]", '[bench.table]\nkind = "controller"\n[bench.budget]'), "[controllers.rate_table]"),
    ],
)
def test_mistakes(campaign: Write, changes: tuple[str, str], said: str) -> None:
    with pytest.raises(SettingsError) as told:
        read_campaign(campaign(changes), "GOOD")
    assert said in str(told.value)
    assert "(line " in str(told.value) or "controller" in str(told.value)


def test_lines_of_arrays_of_tables(campaign: Write) -> None:
    file = campaign()
    lines = file.read_text().splitlines()
    seconds = [number for number, line in enumerate(lines, 1) if line.startswith("at_most")]
    assert [line_of(file, ["step", place, "limit", "0", "at_most"]) for place in "01"] == seconds
    assert line_of(file, ["unit", "LIMIT", "simulation"]) == lines.index("[unit.LIMIT.simulation]") + 1


@pytest.mark.slow
def test_the_shipped_campaign_and_its_schema(capsys: pytest.CaptureFixture[str]) -> None:
    shipped = shipped_settings("campaign")
    assert main(["station", str(shipped), "--check"]) == 0
    assert "RLG-001, RLG-002, RLG-003, any other unit" in capsys.readouterr().out
    schema = campaign_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    values = read_toml(shipped)
    jsonschema.validate(values, schema)
    for place, wrong in (
        (("step", 0, "settings", "measurement", "recrods"), 3),
        (("campaign", "guard_band"), "U99"),
    ):
        damaged = json.loads(json.dumps(values))
        inner = damaged
        for name in place[:-1]:
            inner = inner[name]
        inner[place[-1]] = wrong
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(damaged, schema)


def test_a_dry_run_tells_steps_time_and_uncertainty(campaign: Write, capsys: pytest.CaptureFixture[str]) -> None:
    file = campaign(('measurement = "measure"', 'measurement = "measure"\nwarm_up_s = 1800.0'))
    assert main(["station", str(file), "--unit", "GOOD", "--dry-run", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["seconds"] > 1800
    # K is known to 0.2 %, k = 1: no less than that
    assert document["steps"][0]["lock_in_rate_u_dps"] > 0.01 * 2e-3
    assert not Path("tests").exists()


@pytest.mark.slow
def test_doctor_looks_at_the_bench_of_a_campaign(campaign: Write, capsys: pytest.CaptureFixture[str]) -> None:
    cards = (
        '[[instrument]]\nrole = "oscilloscope"\nmodel = "TDS 2012"\ncalibration_due = 2020-01-01\n'
        '[[instrument]]\nrole = "rate table"\nserial = "T-7"\ncalibrated_on = 2026-01-01\n[[step]]'
    )
    assert main(["doctor", "--json", "--station", str(campaign(("[[step]]", cards)))]) == 3
    checks = json.loads(capsys.readouterr().out)["checks"]
    found = {(check["name"], check["state"]): check["text"] for check in checks}
    assert "was due on 2020-01-01" in found["calibration", "bad"]
    assert "T-7: no calibration_due" in found["calibration", "note"]
    assert "is to be TDS 2012, and answers TEKTRONIX,TDS 2014" in found["identity", "bad"]
    assert found["rate table", "ok"].startswith("turns at 50 deg/s")
    assert "levels" in found["level", "ok"] and "noise" in {name for name, _ in found}


@pytest.mark.parametrize(
    ("limit", "far"),
    [(0.011, False), (0.19, False), (10.0, True), (1e-4, True), (36.0, True)],  # the last in deg/h
)
def test_a_limit_far_from_what_is_expected_is_told(campaign: Write, capsys: Any, limit: float, far: bool) -> None:
    file = campaign(("at_most = 0.010", f"at_most = {limit}"))
    assert main(["station", str(file), "--check", "--json"]) == 0
    told = capsys.readouterr()
    assert (len(json.loads(told.out)["warnings"]), "0.01 is expected" in told.err) == (far, far)


def test_a_test_is_not_begun_on_a_full_disk(
    campaign: Write, capsys: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("station.campaign.bench.shutil.disk_usage", lambda _: SimpleNamespace(free=30 * 2**20))
    assert main(["station", str(campaign()), "--unit", "GOOD"]) == 5
    assert "30 MB free" in capsys.readouterr().err
    assert not (tmp_path / "tests").exists()
