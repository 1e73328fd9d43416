"""Logs that a test writes as a text."""

import tempfile
from pathlib import Path

from instrument.fibre_gyro import Recording, read_gyro_log


def parse_gyro_log(text: str, **choices) -> Recording:
    """Read the text of a log from a file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        path.write_text(text, "utf-8", newline="")
        return read_gyro_log(path, **choices)
