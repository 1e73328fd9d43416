"""Whether a result stands: the colour of its box, the words in its JSON, and the measurement that it asks for."""

import html
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis import Flag
from analysis.budget import Budget, BudgetInput
from station.lock_in.messages import remedy_sentence, short_remedy
from station.lock_in.result import assumed_sentence, doubt_sentence, result
from station.report.show import render_report
from station.results.result import Result
from station.runs.store import open_run
from station.shell.finish import Evaluated, evaluate_run

GOLDEN = Path(__file__).parents[2] / "golden"
DISTORTION_MEASURED = "[budget]\ndistortion_limit_dbc = -70\nbandwidth_hz = 1e6\ngain_corner_hz = 1e5\n"


def evaluated(folder: Path, name: str = "single", toml: str = "", **choices: object) -> Evaluated:
    """Evaluate a saved run of a simulated bench, with other knowledge of it or other limits."""
    run = open_run(Path(shutil.copy(GOLDEN / f"{name}.sqlite", folder)))
    config = None
    if toml:
        config = folder / "known.toml"
        config.write_text(toml)
    return evaluate_run(run, config=config, choices=choices)


def box(one: Evaluated) -> str:
    """Colour of the box at the head of the report."""
    (state,) = re.findall(r'<div class="verdict (\w+)">', render_report(one))
    return str(state)


def line(name: str, u: float, *, stated: bool = True, note: str = "", freedom: float = math.inf) -> BudgetInput:
    return BudgetInput(
        name, f"the {name}", "1", 0.0, u, "normal", 1.0, degrees_of_freedom=freedom, note=note, stated=stated
    )


@pytest.mark.parametrize(
    ("doubts", "failures", "problem", "state"),
    [
        ((), (), "", "stands"),
        (("one",), (), "", "doubtful"),
        (("one",), ("two",), "", "fails"),
        ((), (), "no beat", "fails"),
    ],
)
def test_the_worst_rules(doubts: tuple[str, ...], failures: tuple[str, ...], problem: str, state: str) -> None:
    standing = Result("x", "1", {}, doubts=doubts, failures=failures, problem=problem).standing
    assert standing.state == state
    assert set(standing.reasons) == {*doubts, *failures, *([problem] if problem else [])}


def test_without_doubts_of_its_own_whatever_is_to_watch_is_one() -> None:
    assert Result("x", "1", {}, to_watch=("it drifts",)).standing.state == "doubtful"
    assert Result("x", "1", {}, to_watch=("it was fitted",), doubts=()).standing.state == "stands"


def test_a_result_whose_inputs_are_known_is_green(tmp_path: Path) -> None:
    one = evaluated(tmp_path, toml=DISTORTION_MEASURED)
    assert box(one) == "good"
    document = one.document()
    assert (document["standing"], document["standing_reasons"]) == ("stands", [])


@pytest.mark.slow
def test_a_bound_that_nobody_stated_as_the_largest_part_is_amber(tmp_path: Path) -> None:
    known = evaluated(tmp_path, toml=DISTORTION_MEASURED)
    one = evaluated(tmp_path, toml=DISTORTION_MEASURED.replace("-70", "0"))
    assert box(one) == "doubtful"
    document = one.document()
    assert document["standing"] == "doubtful"
    (reason,) = document["standing_reasons"]
    assert reason.startswith("The largest uncertainty is an assumption: second-order distortion")
    assert reason in render_report(one)
    assert document["budget"]["largest_part"] == "distortion"
    assert "budget.distortion_limit_dbc" in document["budget"]["remedy"]
    # the value is the same, only less sure; the interval says so
    assert document["lock_in_rate_dps"] == known.document()["lock_in_rate_dps"]
    assert document["lock_in_rate_u_dps"] > 10 * known.document()["lock_in_rate_u_dps"]
    assert document["lock_in_rate_noise_u_dps"] == known.document()["lock_in_rate_noise_u_dps"]


def test_an_unstated_bound_that_does_not_rule_leaves_it_green(tmp_path: Path) -> None:
    one = evaluated(
        tmp_path, toml="[budget]\ndistortion_limit_dbc = -45\nbandwidth_hz = 1e6\ngain_corner_hz = 0\n"
    )
    assert [part.name for part in one.found.budget.not_stated] == ["gain_corner"]
    assert one.document()["budget"]["largest_part"] == "distortion"
    assert box(one) == "good"


@pytest.mark.parametrize(("share", "state"), [(0.005, "stands"), (0.03, "doubtful")])
def test_a_beat_that_moved_is_told_in_short(tmp_path: Path, share: float, state: str) -> None:
    found = evaluated(tmp_path, toml=DISTORTION_MEASURED).found
    beats = found.each.beat_frequency * np.repeat([1.0, 1.0 - share], [4, 2])
    flags = np.asarray(int(found.combined.flags) | Flag.BEAT_WANDERS)
    each, combined = replace(found.each, beat_frequency=beats), replace(found.combined, flags=flags)
    said = result(replace(found, each=each, combined=combined, axis_rates=None))
    (percent,) = re.findall(r"beat moved (\S+) % after record 4;", dict(said.brief)["checks"].lower())
    assert float(percent) == pytest.approx(100 * share, rel=0.1)
    assert said.standing.state == state
    # the same beats, but the table is known to have turned so much more slowly
    rates = beats / np.mean(beats) * float(found.combined.input_rate)
    known = result(replace(found, each=each, combined=combined, axis_rates=rates))
    (percent,) = re.findall(r"beat moved (\S+) %", dict(known.brief)["checks"])
    assert float(percent) < 0.1 and known.standing.state == "stands"


@pytest.mark.slow
def test_a_truth_outside_the_interval_is_red(tmp_path: Path) -> None:
    # by a scale factor that is 0.5 % off
    one = evaluated(tmp_path, toml=DISTORTION_MEASURED, scale_factor=1990.0)
    document = one.document()
    assert not document["lock_in_rate_low_95_dps"] < 0.01 < document["lock_in_rate_high_95_dps"]
    assert box(one) == "bad"
    assert document["standing"] == "fails"
    (reason,) = [one for one in document["standing_reasons"] if "outside the 95 % interval" in one]
    assert html.unescape(render_report(one)).count(reason) == 1


def test_a_limit_that_is_missed_is_red_though_the_result_stands(tmp_path: Path) -> None:
    limits = DISTORTION_MEASURED + "[limits]\nlock_in_rate_u_dps = 1e-6\n"
    one = evaluated(tmp_path, toml=limits)
    assert (one.verdict, one.result.standing.state, box(one)) == ("FAIL", "stands", "bad")


def test_limits_are_judged_by_the_interval_that_counts_every_input(tmp_path: Path) -> None:
    """Noise alone would let it pass; what nobody knows of the bench does not."""
    limit = "[limits]\nlock_in_rate_high_95_dps = 0.0102\n"
    passed = evaluated(tmp_path, toml=DISTORTION_MEASURED + limit)
    assert passed.verdict == "PASS"
    failed = evaluated(tmp_path, toml=DISTORTION_MEASURED.replace("-70", "0") + limit)
    assert failed.verdict == "FAIL"
    (tested,) = failed.tested
    assert tested.measured.value == failed.document()["lock_in_rate_high_95_dps"] > 0.0102
    document = failed.document()
    assert document["lock_in_rate_dps"] + 2 * document["lock_in_rate_noise_u_dps"] < 0.0102


def test_the_remedy_takes_the_largest_part_away() -> None:
    """Two inputs of 3 and 4 %: without the larger one 3 % are left; U95 is 1.96 times as much."""
    budget = Budget(1.0, "beat", (line("distortion", 0.04, stated=False), line("scale_factor", 0.03)))
    said = remedy_sentence(budget)
    assert said.startswith("The largest part is the distortion (64 % of the variance; nobody stated it): ")
    assert said.endswith("U95 would fall from 9.8 % to 5.9 %.")
    assert "several rates in both senses" in said


def test_noise_is_halved_by_four_times_as_many_records() -> None:
    budget = Budget(1.0, "beat", (line("noise", 0.04), line("scale_factor", 0.03)))
    said = remedy_sentence(budget)
    assert "take four times as many records" in said
    assert "nobody stated it" not in said
    assert said.endswith("U95 would fall from 9.8 % to 7.1 %.")  # hypot(2, 3) = 3.6


def test_more_records_do_not_show_what_these_rates_do_not() -> None:
    budget = Budget(1.0, "beat", (line("separation", 0.04, stated=False), line("noise", 0.03)))
    said = remedy_sentence(budget)
    assert "several rates in both senses" in said
    assert "as many records" not in said + short_remedy(budget)
    assert said.endswith("U95 would fall from 9.8 % to 5.9 %.")
    shown = Budget(1.0, "beat", (line("separation", 0.04), line("noise", 0.03)))
    assert "as many records" in remedy_sentence(shown)


def test_what_was_assumed_is_named_with_its_bound() -> None:
    unknown = line("bandwidth", 0.04, stated=False, note="not stated: bound of 10 kHz")
    ruled = Budget(1.0, "beat", (unknown, line("noise", 0.03)))
    assert assumed_sentence(ruled).endswith("worst case assumed: the bandwidth (10 kHz).")
    assert doubt_sentence(ruled) == (
        "The largest uncertainty is an assumption: the bandwidth, not stated: bound of 10 kHz."
    )
    not_ruled = Budget(1.0, "beat", (unknown, line("noise", 0.05)))
    assert assumed_sentence(not_ruled)
    assert doubt_sentence(not_ruled) == ""
    nothing = Budget(1.0, "beat", (line("noise", 0.0),))
    assert (remedy_sentence(nothing), doubt_sentence(nothing), assumed_sentence(nothing)) == ("", "", "")


def test_a_file_replaces_what_it_states_and_nothing_else(tmp_path: Path) -> None:
    limit = "[limits]\nlock_in_rate_u_dps = 1e-9\n"
    both = evaluated(tmp_path, toml=f"[budget]\nbandwidth_hz = 123456.0\n{limit}")
    assert both.verdict == "FAIL"
    later = (
        "third_order_limit_dbc",
        "phase_change_limit_rad",
        "lock_in_drift_limit_percent",
        "thermal_tail_limit_percent",
    )
    saved = {**both.run.facts.settings["budget"], **dict.fromkeys(later, 0.0)}  # names of later versions
    assert both.settings.budget.model_dump() == {**saved, "bandwidth_hz": 123456.0}
    only_limits = evaluated(tmp_path, toml=limit)
    assert only_limits.verdict == "FAIL"
    assert only_limits.settings.budget.model_dump() == saved
