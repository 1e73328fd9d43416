"""HTML pages from the templates of :mod:`station`, written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any


def render_page(template: str, **values: Any) -> str:
    """Fill a template; a value that it needs and is not given is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("station.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(**values)


def write_page(path: Path, text: str) -> Path:
    """Write a page that appears under its name only when it is whole; OSError if it cannot be written."""
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        draft.write_text(text, encoding="utf-8")
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
    return path
