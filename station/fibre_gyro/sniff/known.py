"""The descriptions of frames that are known: those that come with the program, and a user's own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from instrument import InstrumentError
from instrument.fibre_gyro import FrameFormat, parse_frame_format
from station.errors import SettingsError
from station.fibre_gyro.settings import FogSettings
from station.settings.load import shipped_settings
from station.settings.toml_files import read_toml

_SHIPPED = "fibre_gyro_frames"
_FOLDER = "frames"


@dataclass(frozen=True)
class KnownFormat:
    """A description of frames, and the file that it stands in."""

    name: str
    layout: FrameFormat
    file: Path

    @property
    def shipped(self) -> bool:
        """Whether it came with the program, so that settings need not name its file."""
        return self.file in shipped_files()


def shipped_files() -> list[Path]:
    """Files with descriptions that came with the program; SettingsError if the installation is incomplete."""
    first = shipped_settings(_SHIPPED)
    return [first, *sorted((first.parent / _FOLDER).glob("*.toml"))]


def known_formats(files: list[Path] | None = None) -> dict[str, KnownFormat]:
    """Read all descriptions."""
    found: dict[str, KnownFormat] = {}
    for file in shipped_files() if files is None else files:
        for name, table in _tables(file):
            found[name] = KnownFormat(name, _parsed(table, name, file), file)
    return found


def read_frame_format(settings: FogSettings) -> FrameFormat:
    """Find and parse the frame format that the settings name."""
    name, given = settings.link.frame_format, settings.link.frame_format_file
    files = [Path(given)] if given else shipped_files()
    there = []
    for file in files:
        for known, table in _tables(file):
            if known == name:
                return _parsed(table, name, file)
            there.append(known)
    place = given or f"the files of {files[0].parent / _FOLDER} and {files[0].name}"
    raise SettingsError(
        f"{place}: there is no [formats.{name}]; link.frame_format can be: {', '.join(there) or 'none'}"
    )


def _tables(file: Path) -> Iterator[tuple[str, object]]:
    formats = read_toml(file).get("formats", {})
    if not isinstance(formats, dict):
        raise SettingsError(f"{file}: formats is no table: each format is a [formats.NAME] of its own")
    yield from formats.items()


def _parsed(table: object, name: str, file: Path) -> FrameFormat:
    try:
        return parse_frame_format(table, where=f"formats.{name}")  # type: ignore[arg-type]
    except InstrumentError as error:
        raise SettingsError(f"{file}: {error}") from None
