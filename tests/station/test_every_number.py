"""Every number that limits can be set on, under every rule: no ERROR where the JSON says how well it is known."""

import math
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest

from station.results.quantity import Quantity
from station.results.verdict import ERROR, Limit, Rule, decide, values_of
from station.runs.store import open_run
from station.shell.finish import evaluate_run
from tests.golden_outputs.differences import stem

GOLDEN = Path(__file__).parents[1] / "golden"
RUNS = sorted(path.stem for path in GOLDEN.glob("*.sqlite") if path.stem not in ("locked", "cut_short"))


def parts(document: Any, way: str = "result") -> Iterator[tuple[str, dict[str, Any]]]:
    """Every object of a document, with its place."""
    if isinstance(document, dict):
        yield way, document
    for name, inner in document.items() if isinstance(document, dict) else enumerate(document):
        if isinstance(inner, dict | list):
            yield from parts(inner, f"{way}.{name}")


def is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def known(part: dict[str, Any], name: str) -> bool:
    """Whether an uncertainty, or both ends of an interval, stand beside a number, wherever in their names."""
    beside = {tuple(sorted(set(key.split("_")) - set(name.split("_")))) for key in part
              if key != name and stem(key) == stem(name) and is_number(part[key])}  # fmt: skip
    return ("u",) in beside or {("95", "low"), ("95", "high")} <= {tuple(sorted(one)) for one in beside}


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_a_number_whose_uncertainty_is_in_the_json_can_be_judged(name: str, tmp_path: Path) -> None:
    run = open_run(Path(shutil.copy(GOLDEN / f"{name}.sqlite", tmp_path)))
    evaluated = evaluate_run(run)
    document = evaluated.document()
    judged = 0
    for way, part in parts(document):
        for key, value in part.items():
            if is_number(value) and known(part, key) and not {"u", "low", "high"} & set(key.split("_")):
                (found,) = values_of(evaluated.result, document, f"{way}.{key}")
                assert found.uncertain and found.low_95 <= found.value <= found.high_95, f"{way}.{key}"
                judged += 1
    for measured in evaluated.result.measured:
        if {"u", "low", "high"} & set(measured.name.split("_")) or math.isnan(measured.value):
            continue  # an uncertainty itself, which has none
        holders = [part for _, part in parts(document) if is_number(part.get(measured.name))]
        for rule in get_args(Rule):
            decided = decide(Limit(measured.name, at_most=2 * abs(measured.value), rule=rule), measured)
            if any(known(part, measured.name) for part in holders) or (holders and rule == "none"):
                assert decided.verdict != ERROR, decided.sentence
    assert judged > 0 or name in ("fog_figures",)


def test_a_number_is_read_as_it_is_declared() -> None:
    walk = Quantity("angle_random_walk", "deg_per_sqrt_h", u_last=True)
    document = {walk.key(): 0.005, "angle_random_walk_deg_per_sqrt_h_u": 1e-4}
    assert walk.key("low_95") == "angle_random_walk_deg_per_sqrt_h_low_95"
    assert (walk.value_in(document).unit, walk.value_in(document).words) == ("deg/√h", "angle random walk")
    assert walk.value_in(document).low_95 == pytest.approx(0.0048)
    ratio = Quantity("ratio")
    assert (ratio.key("u"), ratio.value_in({"ratio": 0.1}).unit) == ("ratio_u", "")
    assert math.isnan(ratio.value_in({"ratio": None}).value)
    assert not ratio.value_in({"ratio": 0.1, "ratio_low_95": 0.05}).uncertain
