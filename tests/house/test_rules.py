"""The rules of the house that no linter knows, on the source as it stands."""

import ast
import graphlib
import tomllib
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BUILD = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]
PACKAGES: list[str] = BUILD["targets"]["wheel"]["packages"]
EVERYWHERE = [*PACKAGES, "benchmarks", "tests"]


# folders with more than a dozen files, and why
LARGER_FOLDERS: dict[str, str] = {}


@cache
def modules(folder: str) -> dict[str, ast.Module]:
    """Every module under a folder, parsed; a package goes by its own name."""
    found = {}
    for path in sorted((ROOT / folder).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name] = ast.parse(path.read_text(encoding="utf-8"))
    return found


OURS = {name: tree for package in PACKAGES for name, tree in modules(package).items()}
IS_FOLDER = {name for name in OURS if (ROOT / name.replace(".", "/")).is_dir()}


def imports(name: str, tree: ast.Module) -> Iterator[tuple[str, str, str]]:
    """Module of ours, name taken from it and name given to it, for each import wherever it stands in a file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for one in node.names:
                if one.name in OURS:
                    yield one.name, "", one.asname or one.name
        elif isinstance(node, ast.ImportFrom):
            above = name.split(".") if name in IS_FOLDER else name.split(".")[:-1]
            package = above[: len(above) + 1 - node.level] if node.level else []
            source = ".".join([*package, *filter(None, [node.module])])
            for one in node.names:
                whole = f"{source}.{one.name}"
                if whole in OURS:
                    yield whole, "", one.asname or one.name
                elif source in OURS:
                    yield source, one.name, one.asname or one.name


def test_no_module_imports_itself_by_a_detour() -> None:
    """Imports under TYPE_CHECKING and inside functions count: a late one only hides a circle."""
    graph = {name: {module for module, _, _ in imports(name, tree)} for name, tree in OURS.items()}
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


@pytest.mark.parametrize("folder", EVERYWHERE)
def test_no_private_name_of_another_module_is_used(folder: str) -> None:
    assert [text for name, tree in modules(folder).items() for text in private_names(name, tree)] == []


@pytest.mark.parametrize("folder", EVERYWHERE)
def test_a_folder_holds_a_dozen_files_at_most(folder: str) -> None:
    files = (path for path in (ROOT / folder).rglob("*.py") if path.name != "__init__.py")
    held = Counter(path.parent.relative_to(ROOT).as_posix() for path in files)
    assert {name: count for name, count in held.items() if count > 12 and name not in LARGER_FOLDERS} == {}
    assert [name for name in LARGER_FOLDERS if name.split("/")[0] == folder and held[name] <= 12] == []


@pytest.mark.parametrize("folder", EVERYWHERE)
def test_a_file_is_at_most_500_lines_long(folder: str) -> None:
    paths = (ROOT / folder).rglob("*.py")
    lines = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8").count("\n") for path in paths}
    assert {name: count for name, count in lines.items() if count > 500} == {}
