"""Write docs/api.md, every public name with what its docstring says, from the packages: ``make docs``."""

from __future__ import annotations

import importlib
import inspect
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path

PAGE = Path(__file__).with_suffix(".md")
PACKAGES = ("gyrolock", "instrument", "analysis")

HEAD = """# Names for programs

Written by `make docs` from the docstrings; `help(name)` in Python says the same. `gyrolock` is the face for
scripts and notebooks, `instrument` the driver alone, `analysis` mathematics on arrays."""

_HEADING = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)


def page() -> str:
    """The whole page; the same packages always give the same text."""
    return "\n\n".join([HEAD, *(part for package in PACKAGES for part in _parts(package))]) + "\n"


def _parts(package: str) -> Iterator[str]:
    module = importlib.import_module(package)
    yield f"## {package}"
    elsewhere = set() if package != "gyrolock" else {*_names("instrument"), *_names("analysis")}
    for name in _names(package):
        if name in elsewhere:
            continue  # stands with the driver, or with the mathematics
        yield from _described(f"{package}.{name}", getattr(module, name), level=3)


def _names(package: str) -> list[str]:
    return sorted(importlib.import_module(package).__all__, key=str.lower)


def _described(name: str, value: object, *, level: int) -> Iterator[str]:
    """Heading, signature and docstring of a name, and of the public methods of a class."""
    if not (inspect.isclass(value) or inspect.isroutine(value)):
        return
    yield f"{'#' * level} {name.partition('.')[2]}"
    signature = _signature(value)
    if signature and not (inspect.isclass(value) and issubclass(value, Exception)):
        yield f"    {name}{signature}"
    yield _text(inspect.getdoc(value) or "")
    if inspect.isclass(value) and not issubclass(value, Exception):
        for inner, method in vars(value).items():
            if inner.startswith("_") or not (inspect.isfunction(method) or isinstance(method, property)):
                continue
            about = inspect.getdoc(method)
            if about:
                called = "" if isinstance(method, property) else _signature(method)
                yield f"`.{inner}{called}`\n\n:   {_text(about).replace(chr(10), chr(10) + '    ')}"


def _signature(value: object) -> str:
    """Parameters without types: what they are stands below."""
    try:
        found = inspect.signature(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return ""
    plain = [
        one.replace(annotation=inspect.Parameter.empty) for one in found.parameters.values() if one.name != "self"
    ]
    text = str(found.replace(parameters=plain, return_annotation=inspect.Signature.empty))
    return re.sub(r"<function (\w+) at 0x[0-9a-f]+>", r"\1", text)


def _text(doc: str) -> str:
    """A docstring as Markdown: its headings in bold, its tables and lists as they stand."""
    parts = _HEADING.split(doc)
    shown = [parts[0].strip().replace("*", r"\*").replace("<", r"\<")]
    for heading, body in zip(parts[1::2], parts[2::2], strict=True):
        text = textwrap.dedent(body.strip("\n")).rstrip()
        shown.append(f"**{heading}**\n\n```text\n{text}\n```")
    return "\n\n".join(one for one in shown if one)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
