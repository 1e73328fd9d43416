"""The guides stay what a person can read: README a page, all of them together an afternoon."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
GENERATED = {"api.md", "commands.md", "results.md"}


def words(path: Path) -> int:
    """Words and numbers; not the bars of tables."""
    return sum(bool(re.search(r"\w", word)) for word in path.read_text(encoding="utf-8").split())


def test_readme_is_a_page() -> None:
    assert words(ROOT / "README.md") <= 600


def test_guides_are_read_in_an_afternoon() -> None:
    counted = {page.name: words(page) for page in (ROOT / "docs").glob("*.md") if page.name not in GENERATED}
    assert sum(counted.values()) <= 30_000, counted
