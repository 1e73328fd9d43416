"""Codes that stand in text, taken apart all at once: against one by one."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from station.datasets.backends import codes_of

CELL = st.one_of(st.integers(-128, 127).map(str), st.text("-0123456789+. ", max_size=4), st.integers().map(str))


def slowly(text: str) -> bytes | None:
    """The codes one by one; nothing where a cell is not just how a code is written."""
    written = {str(code): code for code in range(-128, 128)}
    cells = text.split(",")
    return bytes(written[cell] % 256 for cell in cells) if all(cell in written for cell in cells) else None


@pytest.mark.slow
@given(st.lists(CELL, min_size=1, max_size=8).map(",".join))
def test_as_one_by_one(text: str) -> None:
    expected = slowly(text)
    if expected is None:
        with pytest.raises(ValueError, match="a code"):
            codes_of(text.encode())
    else:
        assert codes_of(text.encode()) == expected


def test_every_code_comes_back() -> None:
    codes = np.arange(-128, 128)
    assert codes_of(",".join(map(str, codes)).encode()) == codes.astype(np.int8).tobytes()
