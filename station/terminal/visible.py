"""Text of others (file names, gyro names, answers of instruments) as it may be shown."""

from __future__ import annotations

import re

# what moves a cursor, colours a terminal, turns the direction of writing, or cannot be written at all
_UNSEEN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff\ufeff]")


def visible(text: str) -> str:
    r"""Return a text in which every character that is not seen, but does something, is written out.

    Examples
    --------
    >>> visible("RLG \x1b[2J7")
    'RLG \\x1b[2J7'
    """
    return _UNSEEN.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)
