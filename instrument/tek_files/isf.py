"""ISF files, and the answers of ``WFMPre?`` and ``CURVe?`` as a program has kept them."""

from __future__ import annotations

import re

from instrument import scpi
from instrument.errors import FileFormatError
from instrument.tek_files.scope_csv import check_length
from instrument.waveform import Preamble, Waveform, decode_curve


def parse_isf(content: bytes) -> Waveform:
    """Read the content of an ISF file. Errors as `read_waveform`."""
    marker = _curve_position(content)
    preamble = Preamble.parse(content[:marker].decode("latin-1").strip().rstrip(";"))
    check_length(preamble.nr_pt)
    return _curve_of(content[marker:], preamble)


def parse_curve(preamble: str, content: bytes) -> Waveform:
    """Read the answer of ``CURVe?``, with that of ``WFMPre?`` beside it. Errors as `read_waveform`."""
    described = Preamble.parse(preamble.strip())
    check_length(described.nr_pt)
    return _curve_of(content if content.lstrip()[:1] == b"#" else b"CURVE " + content, described)


def parse_answers(content: bytes) -> Waveform | None:
    """Read the answers of ``WFMPre?`` and ``CURVe?`` behind each other; ``None`` if it begins with no preamble."""
    first = _ANSWER.match(content)
    if first is None:
        return None
    preamble, rest = first.group(1).decode("latin-1"), content[first.end() :].lstrip(b"; \r\n")
    if not rest:
        raise FileFormatError("holds the answer of WFMPre? without that of CURVe?: it is cut, save it again")
    return parse_curve(preamble, rest)


def _curve_of(curve: bytes, preamble: Preamble) -> Waveform:
    start = curve.find(b"#")
    if preamble.encdg == "ASC" or start < 0:
        words = curve.split(maxsplit=1)
        return decode_curve(words[1] if len(words) > 1 else b"", preamble)
    # Some programs put more line ends behind the block than one, and some none.
    block = curve[start:]
    length = preamble.nr_pt * preamble.byt_nr
    end = len(b"#") + 1 + len(str(length)) + length
    if not block[end:].strip(b"\r\n"):
        block = block[:end]
    _, data = scpi.split_block(block, longest=length, terminated=False)
    return decode_curve(data, preamble)


_ANSWER = re.compile(
    rb"\s*([12];(?:8|16);(?:ASC|BIN)[^;]*;R[IP];[ML]SB;\d+;\"[^\"]*\"(?:;[^;\r\n#]*){9})", re.IGNORECASE
)
"""The sixteen fields of a preamble without headers."""


def is_curve(content: bytes) -> bool:
    """Whether a file begins with the binary block of ``CURVe?``."""
    start = content.lstrip()[:32].upper()
    start = start.removeprefix(b":").removeprefix(b"CURVE").removeprefix(b"CURV").lstrip()
    return start[:1] == b"#" and start[1:2].isdigit()


def is_isf(content: bytes) -> bool:
    """Whether a file begins with a preamble that has headers."""
    start = content[:64].lstrip().upper()
    return start.startswith((b":WFMP", b"WFMP"))


def _curve_position(content: bytes) -> int:
    for spelling in (b":CURVE", b":CURV", b";CURVE", b";CURV"):
        # Only the part before the block is text, so the first hit is the header.
        position = content.upper().find(spelling)
        if position >= 0:
            return position
    raise FileFormatError("the ISF file has a preamble but no curve; it is cut, save it again")
