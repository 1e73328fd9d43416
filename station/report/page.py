"""HTML pages from the templates of :mod:`station`, written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from station.terminal.visible import visible


def render_page(template: str, **values: Any) -> str:
    """Fill a template; a value that it needs and is not given is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("station.report"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_shown,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(**values)


def _shown(value: Any) -> Any:
    """Make visible what acts without being seen, in text of others; what is HTML already is ours."""
    return visible(value) if type(value) is str else value


def write_page(path: Path, text: str) -> Path:
    """Write a page that appears under its name only when it is whole; OSError if it cannot be written."""
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with draft.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
    return path
