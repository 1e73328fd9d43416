"""`gyrolock plan` as a user meets it, and the budget in words, JSON and bars."""

import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from analysis.budget import BenchKnowledge, OperatingPoint, lock_in_budget
from analysis.plan import default_rates
from station.cli import main
from station.lock_in.report import budget_svg
from station.lock_in.result import BUDGET_COLUMNS, budget_document, budget_rows, budget_sentences
from station.lock_in.settings import bench_knowledge, load_settings
from station.plan import predict
from station.results.result import plain
from tests.ideal_bench import ideal_bench


def planned(capsys: pytest.CaptureFixture[str], *options: str, code: int = 0) -> dict:
    assert main(["plan", "--json", *options]) == code
    captured = capsys.readouterr()
    return json.loads(captured.out)


@pytest.mark.slow
def test_plan_says_what_to_set(capsys: pytest.CaptureFixture[str]) -> None:
    document = planned(capsys, "--lock-in-rate", "0.02", "--wanted", "1")
    assert document["reached"]
    assert document["predicted_u_percent"] < 1
    # what a measurement of such a gyro goes to
    assert [rate["rate_over_lock_in"] for rate in document["rates"]] == [
        ratio for ratio in default_rates(0.02, 2000.0) for _ in (1, -1)
    ]
    rate = document["rates"][0]
    assert rate["input_rate_dps"] == pytest.approx(0.06)
    assert rate["beat_frequency_hz"] == pytest.approx(2000 * (0.06**2 - 0.02**2) ** 0.5)
    assert rate["seconds_per_division_s"] in (0.01, 0.025, 0.05)
    assert rate["volts_per_division_v"] == 0.1
    assert document["records"] >= 3
    assert any("20 times" in text for text in document["reasons"])
    assert len(document["curve"]["rate_over_lock_in"]) == len(document["curve"]["total_u_percent"])


@pytest.mark.slow
def test_plan_counts_single_beams(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "beams.toml").write_text('[beams]\nchannels = ["CH2", "CH3"]\n')
    config = ("--config", str(tmp_path / "beams.toml"))
    one_rate = planned(capsys, *config, "--rates", "8", code=1)
    assert one_rate["with_beams"] is None  # in one sense the fit has nothing to tell the beams by
    few = planned(capsys, *config, "--rates", "3,30")  # what the beat alone does not reach
    beams = few["with_beams"]
    assert few["reached"]
    assert beams["predicted_u_percent"] < 1 < few["predicted_u_percent"]
    assert beams["predicted_u_percent"] < beams["nine_in_ten_u_percent"]
    assert few["reasons"][0].startswith(f"With the single beams {few['records']} records: ")
    assert few["reasons"][1].startswith("By the beat alone 1 % cannot be reached: ")
    shipped = load_settings(None).model_dump(mode="json")
    shipped["measurement"] |= {"rates_over_lock_in": [3.0, 30.0], "both_senses": False}
    with_both, with_one, alone = (
        predict("measure", {**shipped, "beams": {**shipped["beams"], "channels": channels}})
        for channels in (["CH2", "CH3"], ["CH2"], [])
    )
    assert with_both.u < with_one.u / 2 < alone.u / 2  # a campaign counts them too, for the same lasers
    alone_of = few["of_any_laser"]
    assert 3 * beams["predicted_u_percent"] < alone_of["predicted_u_percent"] < alone_of["nine_in_ten_u_percent"]
    assert planned(capsys, "--rates", "3,30", "--both-senses")["of_any_laser"] is None  # they tell the laser


@pytest.mark.slow
def test_plan_options_reach_the_prediction(capsys: pytest.CaptureFixture[str]) -> None:
    plain = planned(capsys)
    noisy = planned(capsys, "--noise", "0.05")
    louder = planned(capsys, "--amplitude", "0.1", "--noise", "0.003")
    slow = planned(capsys, "--baud", "300")
    given = planned(capsys, "--transfer", "0")
    assert noisy["predicted_u_percent"] > 3 * plain["predicted_u_percent"]
    assert louder["rates"][0]["volts_per_division_v"] == 0.05
    assert slow["duration_s"] > 30 * given["duration_s"]
    bent = planned(capsys, "--distortion", "-40", "--rates", "best", code=1)
    assert not bent["reached"]
    assert "distortion" in [line["name"] for line in bent["budget"]["inputs"][:2]]
    free = planned(capsys, "--distortion", "-40", "--rates", "best", "--both-senses", code=1)
    first, second = (rate["input_rate_dps"] for rate in free["rates"])
    assert first == pytest.approx(-second) and "separation" in free["budget"]["not_stated"]
    assert free["predicted_u_percent"] < bent["predicted_u_percent"]
    several = planned(capsys, "--rates", "3,8,15", "--distortion", "-40")
    assert [rate["rate_over_lock_in"] for rate in several["rates"]] == [3, 8, 15]


@pytest.mark.slow
def test_plan_with_the_table_as_reference(capsys: pytest.CaptureFixture[str]) -> None:
    document = planned(capsys, "--reference", "rate", code=1)
    names = [line["name"] for line in document["budget"]["inputs"][:4]]
    assert "azimuth" in names
    assert document["rates"][0]["table_rate_dps"] > 1
    assert any("own reference" in text for text in document["reasons"])


SLOW = pytest.mark.slow


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["svg", *(pytest.param(kind, marks=SLOW) for kind in ("png", "pdf"))])
def test_plan_draws(suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / f"plan.{suffix}"
    document = planned(capsys, "--plot", str(file))
    assert document["plot"] == str(file)
    content = file.read_bytes()
    assert content.startswith({"svg": b"<?xml", "png": b"\x89PNG", "pdf": b"%PDF"}[suffix])
    assert list(tmp_path.iterdir()) == [file]
    if suffix == "svg":
        texts = "".join(ElementTree.fromstring(content).itertext())
        assert "as in the paper" in texts
        assert "all rates together" in texts


def test_plan_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan"]) == 0
    text = capsys.readouterr().out
    assert "ms/div" in text
    assert "mV/div" in text
    assert "Both senses" in text
    assert "lock-in rate, combined" in text


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--rates", "3,eight"), "list of numbers"),
        (("--rates", "0.5"), "1.05"),
        (("--wanted", "0"), "wanted"),
        (("--plot", "plan.doc"), ".svg"),
        (("--amplitude", "1000"), "probe"),
        (("--distortion", "3"), "distortion"),
    ],
)
def test_plan_refuses(options: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "--json", *options]) == 2
    captured = capsys.readouterr()
    assert words in json.loads(captured.out)["error"]["message"]
    assert captured.err.count("\n") == 1


@pytest.mark.slow
def test_a_picture_that_cannot_be_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "--json", "--plot", str(tmp_path / "none" / "plan.svg")]) == 2
    assert json.loads(capsys.readouterr().out)["error"]["kind"] == "file"


def test_bench_plan_needs_a_tilt_for_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "bench.toml"
    config.write_text('[scope]\nresource = "GPIB0::1::INSTR"\n[gyro]\nscale_factor_pulses_per_deg = 2000.0\n')
    assert main(["plan", "--json", "--config", str(config), "--reference", "rate"]) == 2
    assert "--tilt" in json.loads(capsys.readouterr().out)["error"]["message"]
    # one rate does not reach 1 % where nobody said anything of the channel
    document = planned(capsys, "--config", str(config), code=1)
    assert "bandwidth" in document["budget"]["not_stated"]


def test_budget_in_json_rows_and_bars() -> None:
    knowledge = BenchKnowledge(scale_factor_u_ppm=100.0, distortion_limit=0.003)
    budget = lock_in_budget(OperatingPoint(2000.0, 0.08, 0.01, 1e-4, 1e-3, 0.2, 5000.0), knowledge)
    document = json.loads(json.dumps(plain(budget_document(budget)), allow_nan=False))
    parts = [line["contribution_dps"] for line in document["inputs"]]
    assert parts == sorted(parts, reverse=True)
    assert document["combined_u_dps"] ** 2 == pytest.approx(sum(part**2 for part in parts))
    assert document["expanded_u_95_dps"] == pytest.approx(document["coverage_factor"] * document["combined_u_dps"])
    assert sum(line["share_of_variance"] for line in document["inputs"]) == pytest.approx(1)
    assert set(document["not_stated"]) == {"bandwidth", "high_pass", "gain_corner", "third_order"}
    assert document["largest_part"] == document["inputs"][0]["name"] == "bandwidth"
    assert "LED on a generator" in document["remedy"]
    rows = budget_rows(budget)
    assert len(rows) == len(budget.inputs) + 1
    assert all(len(row) == len(BUDGET_COLUMNS) for row in rows)
    assert "worst case assumed: bandwidth of the channel" in budget_sentences(budget)[-1]
    picture = ElementTree.fromstring(budget_svg(budget))
    texts = "".join(picture.itertext())
    assert "second-order distortion d" in texts
    assert budget_svg(budget) == budget_svg(budget)


def test_settings_reach_the_budget(tmp_path: Path) -> None:
    stated = bench_knowledge(load_settings(overrides=ideal_bench()))
    assert stated.distortion_limit == pytest.approx(10 ** (-70 / 20))
    assert stated.high_pass.hz == 0
    file = tmp_path / "my.toml"
    file.write_text(
        '[scope]\ncoupling = "AC"\nprobe = 10\n[front_end]\nlow_pass_hz = 4000.0\n'
        "[budget]\nfront_end_u_percent = 10.0\ndistortion_limit_dbc = 0.0\n"
    )
    changed = bench_knowledge(load_settings(file))
    assert changed.high_pass.hz == 1.0
    assert changed.bandwidth.corrected
    assert (changed.bandwidth.hz, changed.bandwidth.u_hz) == (4000.0, 400.0)
    assert changed.distortion_limit != changed.distortion_limit  # not known
