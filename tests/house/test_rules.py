"""The rules of the house that no linter knows, on the source as it stands."""

import ast
import graphlib
import json
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from station.measurements import MEASUREMENTS, measurement

ROOT = Path(__file__).parents[2]
BUILD = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]
PACKAGES: list[str] = BUILD["targets"]["wheel"]["packages"]
EVERYWHERE = [*PACKAGES, "benchmarks", "tests"]


# shorter than a chapter: it declares what all others use
DECLARATIONS = {"station/results/numbers.py"}

# public names that two faces share: a measurement of the scope and of the station, the Result of a notebook
NAMES_OF_TWO_FACES = {"Measurement", "Result"}


@cache
def modules(folder: str) -> dict[str, ast.Module]:
    """Every module under a folder, parsed; a package goes by its own name."""
    found = {}
    for path in sorted((ROOT / folder).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name] = ast.parse(path.read_text(encoding="utf-8"))
    return found


@cache
def ours() -> dict[str, ast.Module]:
    """Every module of the product, parsed where a test asks: four processes collect these tests."""
    return {name: tree for package in PACKAGES for name, tree in modules(package).items()}


@cache
def names_of_ours() -> set[str]:
    """Every module of the product."""
    paths = [path.relative_to(ROOT) for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    return {
        ".".join(path.parent.parts if path.stem == "__init__" else path.with_suffix("").parts) for path in paths
    }


def imports(name: str, tree: ast.Module) -> Iterator[tuple[str, str, str]]:
    """Module of ours, name taken from it and name given to it, for each import wherever it stands in a file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for one in node.names:
                if one.name in names_of_ours():
                    yield one.name, "", one.asname or one.name
        elif isinstance(node, ast.ImportFrom):
            above = name.split(".") if (ROOT / name.replace(".", "/")).is_dir() else name.split(".")[:-1]
            package = above[: len(above) + 1 - node.level] if node.level else []
            source = ".".join([*package, *filter(None, [node.module])])
            for one in node.names:
                whole = f"{source}.{one.name}"
                if whole in names_of_ours():
                    yield whole, "", one.asname or one.name
                elif source in names_of_ours():
                    yield source, one.name, one.asname or one.name


@pytest.mark.slow
def test_no_module_imports_itself_by_a_detour() -> None:
    """Imports under TYPE_CHECKING and inside functions count: a late one only hides a circle."""
    graph = {name: {module for module, _, _ in imports(name, tree)} for name, tree in ours().items()}
    assert sum(map(len, graph.values())) > 200
    assert "\n".join(circles(graph)) == ""


def circles(graph: dict[str, set[str]]) -> Iterator[str]:
    """Each circle once; opened where it was found, so that the next comes to light."""
    while True:
        try:
            graphlib.TopologicalSorter(graph).prepare()
        except graphlib.CycleError as error:
            circle = error.args[1]
            graph[circle[1]].remove(circle[0])
            yield " is imported by ".join(circle)
        else:
            return


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def private_names(name: str, tree: ast.Module) -> Iterator[str]:
    """Private names of other modules that a module imports, or takes as an attribute of a module."""
    taken_from = list(imports(name, tree))
    for module, taken, _ in taken_from:
        if module != name and (is_private(taken) or is_private(module.split(".")[-1])):
            yield f"{name} imports {taken} from {module}"
    aliases = {given: module for module, taken, given in taken_from if not taken}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and is_private(node.attr):
            module = aliases.get(ast.unparse(node.value), name)
            if module != name:
                yield f"{name} uses {module}.{node.attr}"


def test_no_test_uses_a_private_name_of_the_product() -> None:
    """Of the product and its benchmarks ruff says it; tests it lets reach into what they have made themselves."""
    assert [text for name, tree in modules("tests").items() for text in private_names(name, tree)] == []


def lines(folder: str) -> dict[str, int]:
    """Lines of every file under a folder."""
    paths = sorted((ROOT / folder).rglob("*.py"))
    return {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8").count("\n") for path in paths}


@pytest.mark.parametrize("folder", EVERYWHERE)
def test_a_file_is_a_chapter(folder: str) -> None:
    found = lines(folder)
    assert {name: count for name, count in found.items() if count > 900} == {}
    if folder in PACKAGES:
        torn = {name: count for name, count in found.items() if count < 60 and not name.endswith("__init__.py")}
        assert set(torn) == DECLARATIONS & set(found)


def test_the_house_can_be_taken_in() -> None:
    """Files, lines and classes of the product; a ceiling is lowered by whoever gets below it, never raised."""
    every = {name: count for folder in PACKAGES for name, count in lines(folder).items()}
    stubs = [path.read_text(encoding="utf-8") for folder in PACKAGES for path in (ROOT / folder).rglob("*.pyi")]
    classes = [node for tree in ours().values() for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    assert len(every) <= 258
    assert sum(every.values()) + "".join(stubs).count("\n") <= 83_262
    assert len(classes) <= 729


def test_the_name_of_a_class_means_one_thing() -> None:
    places: dict[str, list[str]] = {}
    for module, tree in ours().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(module)
    assert {name for name, found in places.items() if len(found) > 1} == NAMES_OF_TWO_FACES


# command line, and the files of ours that a run of it may enter; the simulated scope counts as one
WALKS = {
    "measure --rates 8 --records 2 --no-report": 90,
    "analyze {golden}/default.sqlite": 75,
    "fog eps {golden}/fog_eps.sqlite --no-report": 70,
    "fog witness --no-report": 70,
}

# Which files a function of ours is called in while each command runs, in a process of its own. All modules are
# there before, since what one does when it is imported is not on the way.
WALK = """
import contextlib, cProfile, importlib, json, os, pkgutil, sys, threading
import gyrolock, analysis, instrument, station
for package in (gyrolock, analysis, instrument, station):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        with contextlib.suppress(ImportError):
            importlib.import_module(module.name)
from station.cli import main
root, profiles = sys.argv[1], []
def profiled(*_):
    profiles.append(cProfile.Profile(builtins=False))
    try:
        profiles[-1].enable()
    except ValueError:  # from Python 3.12 on the first one sees every thread
        sys.setprofile(None)
for walk in sys.argv[2:]:
    if os.fork():
        os.wait()
        continue
    threading.setprofile(profiled)
    profiled()
    main(walk.split())
    sys.setprofile(None)
    entered = {entry.code for one in profiles for entry in one.getstats() if not isinstance(entry.code, str)}
    names = {code.co_filename for code in entered if code.co_name != "<module>"}
    ours = {name.removeprefix(root) for name in names if name.startswith(root) and ".venv" not in name}
    scope = {"simulated" if name.startswith("instrument/simulated/") else name for name in ours}
    print("WALK", json.dumps([walk, sorted(scope)]), flush=True)
    os._exit(0)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs a system that forks processes")
def test_a_command_enters_few_files(tmp_path: Path) -> None:
    golden = shutil.copytree(ROOT / "tests/golden", tmp_path / "golden")
    most = {f"{walk.format(golden=golden)} --quiet": count for walk, count in WALKS.items()}
    command = [sys.executable, "-c", WALK, f"{ROOT}{os.sep}", *most]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    told = [
        json.loads(line.removeprefix("WALK ")) for line in done.stdout.splitlines() if line.startswith("WALK ")
    ]
    assert [walk for walk, _ in told] == list(most), done.stderr[-2000:]
    for walk, entered in told:
        assert 20 < len(entered) <= most[walk], entered


# keys that conditions of records, settings and options have too: there they mean what was set, not what was found
ALSO_SET = {
    *("rate_dps", "table_rate_dps", "input_rate_by_table_dps", "temperature_c", "step_codes", "window_s"),
    *("duration_s", "warm_up_s", "tilt_deg", "tilt_u_deg"),
}


DECLARING = {"Quantity", "replace", "_figure"}


def literals(tree: ast.AST) -> Iterator[str]:
    """Texts of a module but for those by which a quantity is declared."""
    ahead = [tree]
    while ahead:
        node = ahead.pop()
        if isinstance(node, ast.Constant):
            yield str(node.value)
        elif not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in DECLARING):
            ahead.extend(ast.iter_child_nodes(node))


def test_the_key_of_a_number_stands_in_one_file() -> None:
    """It is declared; who needs it elsewhere takes it from its declaration."""
    groups = [group for name in MEASUREMENTS for group in measurement(name).quantities]
    declared = [one for group in groups for one in group.quantities if one.unit]
    keys = {key for one in declared for key in (one.key(), one.key("u"), one.key("low_95"))} - ALSO_SET
    assert len(keys) > 400
    places: dict[str, set[str]] = {}
    for module, tree in ours().items():
        if module.startswith(("station", "gyrolock")):
            for text in keys.intersection(literals(tree)):
                places.setdefault(text, set()).add(module)
    assert {key: found for key, found in places.items() if len(found) > 1} == {}
