"""docs/architecture.md and the decision records name files that are there."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = "instrument|analysis|station|gyrolock|pyvisa_gyrolock|config|tests|docs"
PAGES = ["docs/architecture.md", *(path.relative_to(ROOT).as_posix() for path in ROOT.glob("docs/decisions/*.md"))]


@pytest.mark.parametrize("page", PAGES)
def test_every_file_that_is_named_is_there(page: str) -> None:
    named = re.findall(rf"\b(?:{PACKAGES})/[\w/.]*\w", (ROOT / page).read_text(encoding="utf-8"))
    assert len(named) > 40 or page != "docs/architecture.md"
    assert [name for name in named if not (ROOT / name).exists()] == []
