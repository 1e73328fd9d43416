"""A waveform file of whatever kind: its content decides, not its name; ISF files."""

import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from instrument import scpi
from instrument.errors import FileFormatError, TransferError
from instrument.tek_files.csv import cells_of, check_length, decoded, heading_row, parse_cells, parse_later
from instrument.text_files import read_small_file
from instrument.waveform import Preamble, Waveform, decode_curve

_LARGEST_FILE = 8_000_000  # bytes; a scope's CSV has about 100 kB
PREAMBLE_ENDING = ".wfmpre"
_SETUP = re.compile(r"(CH\d|MTH|REF\w)$", re.IGNORECASE)
_KEYS = {
    "model": ("Model Number", "Model"),
    "serial": ("Serial Number",),
    "firmware": ("Firmware Version",),
    "probe": ("Probe Atten", "Probe Attenuation"),
}


@dataclass(frozen=True)
class TekFile:
    """A record and what the file says of the scope that wrote it."""

    waveform: Waveform
    kind: str  # {"csv", "isf", "curve"}: CSV; ISF; the answers of ``WFMPre?`` and ``CURVe?`` as they came
    keys: dict[str, str]  # rows of a CSV by their names, as they stand there
    # content of the ``*TEK.SET`` file beside it: the settings of the scope as one text; empty if there is none
    setup: str

    @property
    def about(self) -> dict[str, str]:
        """``model``, ``serial``, ``firmware`` and ``probe``, as far as the file names them."""
        found = {name: next((self.keys[k] for k in keys if self.keys.get(k)), "") for name, keys in _KEYS.items()}
        found["firmware"] = found["firmware"].removeprefix("FV:")
        return {name: text for name, text in found.items() if text}

    def setting(self, command: str) -> str:
        """Setting of the channel in the setup beside the file: ``COUPLING``, ``INVERT``...; "" if unknown."""
        source = self.waveform.preamble.wfid.split(",")[0].upper()
        for part in self.setup.upper().split(";:"):
            header, _, rest = part.removeprefix(":").partition(":")
            if header == source:
                for one in rest.split(";"):
                    name, _, value = one.partition(" ")
                    if name == command:
                        return value.strip()
        return ""


def read_waveform(path: str | os.PathLike[str]) -> Waveform:
    """Read the record of a waveform file; see `read_tek_file`."""
    return read_tek_file(path).waveform


def read_tek_file(path: str | os.PathLike[str]) -> TekFile:
    """Read a waveform file of a Tektronix oscilloscope; the content decides which kind it is, not the name."""
    file = Path(path)
    content = read_small_file(file, _LARGEST_FILE)
    try:
        with np.errstate(all="ignore"):  # what is not finite is looked for
            waveform, kind, keys = _parsed(file, content)
    except (FileFormatError, TransferError) as error:
        reason = str(error).removesuffix("; ask again")
        raise FileFormatError(f"{file}: {reason}") from None
    except (ArithmeticError, ValueError) as error:
        raise FileFormatError(f"{file}: holds a number that no record has ({error})") from None
    return TekFile(waveform, kind, keys, _setup_beside(file))


def _parsed(file: Path, content: bytes) -> tuple[Waveform, str, dict[str, str]]:
    if content[:64].lstrip().upper().startswith((b":WFMP", b"WFMP")):
        return parse_isf(content), "isf", {}
    if is_curve(content):
        preamble = file.with_suffix(PREAMBLE_ENDING)
        if not preamble.is_file():
            raise FileFormatError(
                "holds the answer of CURVe? alone: put that of WFMPre? beside it in a file named "
                f"{preamble.name}, or both into one file"
            )
        return parse_curve(decoded(read_small_file(preamble, _LARGEST_FILE)), content), "curve", {}
    if (answers := parse_answers(content)) is not None:
        return answers, "curve", {}
    rows = cells_of(decoded(content))
    heading = heading_row(rows)
    if heading is not None:
        waveform, keys = parse_later(rows, heading)
        return waveform, "csv", keys
    waveform, keys = parse_cells(rows)
    return waveform, "csv", keys


def _setup_beside(file: Path) -> str:
    """The ``F0000TEK.SET`` of a record ``F0000CH1.CSV``."""
    stem = _SETUP.sub("TEK", file.stem)
    if stem == file.stem:
        return ""
    for name in (f"{stem}.SET", f"{stem}.set"):
        try:
            return read_small_file(file.with_name(name), _LARGEST_FILE).decode("latin-1").strip()
        except (OSError, FileFormatError):
            continue
    return ""


# --------------------
# ISF files, and the answers of ``WFMPre?`` and ``CURVe?`` as a program has kept them


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


def _curve_position(content: bytes) -> int:
    for spelling in (b":CURVE", b":CURV", b";CURVE", b";CURV"):
        # Only the part before the block is text, so the first hit is the header.
        position = content.upper().find(spelling)
        if position >= 0:
            return position
    raise FileFormatError("the ISF file has a preamble but no curve; it is cut, save it again")
