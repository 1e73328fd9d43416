"""A waveform file of whatever kind: its content decides, not its name."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from instrument.errors import FileFormatError, TransferError
from instrument.small_files import read_small_file
from instrument.tek_files.cells import cells_of, decoded
from instrument.tek_files.isf import is_curve, is_isf, parse_answers, parse_curve, parse_isf
from instrument.tek_files.later_csv import heading_row, parse_later
from instrument.tek_files.scope_csv import parse_cells
from instrument.waveform import Waveform

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
    if is_isf(content):
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
