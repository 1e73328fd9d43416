"""Every known description tried on a gyro that is listened to, or on a file, and what fits in words."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from instrument import InstrumentError, LinkError
from instrument.fibre_gyro import FrameFormat, parse_frame_format
from instrument.fibre_gyro.identify import (
    LOOKED_AT,
    Capture,
    Structure,
    Trial,
    capture_port,
    captured_file,
    find_structure,
    poll_of,
    try_format,
)
from station.errors import SettingsError, UsageError
from station.fibre_gyro.settings import FogSettings
from station.live.console import stdout_console
from station.report.show import text_table
from station.results.result import TextTable, with_uncertainty
from station.settings import read_toml, shipped_settings
from station.terminal import say

_FIRST = ("115200", "460800", "921600", "614400", "230400", "38400", "9600")
"""Baud rates in the order in which they are tried; others follow."""

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Sniffed:
    """What was found out."""

    source: str  # the port or file
    capture: Capture  # the bytes that speak most clearly
    trials: tuple[Trial, ...]  # of every known description on them, the likeliest first
    structure: Structure | None  # where no description fits
    quiet: tuple[str, ...] = ()  # line settings with which nothing fitting came

    @property
    def proposed(self) -> Trial | None:
        """The likeliest description; ``None`` where none fits."""
        return self.trials[0] if self.trials and self.trials[0].fits else None

    @property
    def as_likely(self) -> tuple[Trial, ...]:
        """Others that fit as well."""
        best = self.proposed
        if best is None:
            return ()
        return tuple(one for one in self.trials[1:] if one.merit == best.merit)


def sniff_file(path: Path, formats: Mapping[str, KnownFormat]) -> Sniffed:
    """Try every description on the bytes of a file."""
    try:
        capture = captured_file(path)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror})") from None
    if not capture.size:
        raise UsageError(f"{path}: is empty")
    return _judged(str(path), capture, formats, ())


def sniff_port(
    port: str, formats: Mapping[str, KnownFormat], *, seconds: float, baud: int | None, poll: bool, tell: Tell
) -> Sniffed:
    """Listen to a port with one line setting after the other until a description fits."""
    heard: list[Sniffed] = []
    quiet: list[str] = []
    refused: LinkError | None = None
    for layout in _line_settings(formats, baud, one_only="://" in port):
        try:
            capture = capture_port(port, layout, seconds)
        except LinkError as error:
            refused = error
            continue
        tell(f"{port}: {capture.line}: {capture.size} bytes in {seconds:g} s")
        if not capture.size:
            quiet.append(capture.line)
            break
        found = _judged(port, capture, formats, tuple(quiet))
        if found.proposed is not None and not found.proposed.doubts:
            return found
        heard.append(found)
        quiet.append(capture.line)
    if poll and not heard:
        heard += _ask(port, formats, seconds, baud, tell, tuple(quiet))
    if heard:
        # not only what fits best: rubbish of a wrong baud rate shows no structure at all
        return replace(max(heard, key=_clearness), quiet=tuple(quiet))
    if refused is not None and not quiet:
        raise refused
    raise LinkError(
        f"{port} sent nothing in {seconds:g} s; is the gyro on, is it the right port, are transmit and receive "
        "the right way round? A gyro that waits to be asked needs --poll"
    )


def _ask(
    port: str,
    formats: Mapping[str, KnownFormat],
    seconds: float,
    baud: int | None,
    tell: Tell,
    quiet: tuple[str, ...],
) -> list[Sniffed]:
    heard = []
    for known in formats.values():
        if known.layout.poll is None:
            continue
        layout = known.layout if baud is None else replace(known.layout, baud_rate=baud)
        capture = capture_port(port, layout, seconds, poll=poll_of(layout))
        tell(f"{port}: {capture.line}, asked as {known.name} does: {capture.size} bytes in {seconds:g} s")
        if capture.size:
            heard.append(_judged(port, capture, {known.name: known}, quiet))
    return heard


def _clearness(found: Sniffed) -> tuple[bool, int, int]:
    best = found.proposed
    structure = found.structure
    repeats = 0 if structure is None else len(structure.constant) + len(structure.checks) + 8 * structure.text
    return best is not None, best.frames if best is not None else 0, repeats


def _judged(source: str, capture: Capture, formats: Mapping[str, KnownFormat], quiet: tuple[str, ...]) -> Sniffed:
    trials = [try_format(name, known.layout, capture) for name, known in formats.items()]
    trials.sort(key=lambda one: (one.merit, one.explained, one.frames), reverse=True)
    structure = None if trials and trials[0].fits else find_structure(capture.data)
    return Sniffed(source, capture, tuple(trials), structure, quiet)


def _line_settings(
    formats: Mapping[str, KnownFormat], baud: int | None, *, one_only: bool
) -> Sequence[FrameFormat]:
    """One format for each line setting, the usual ones first."""
    layouts = [
        known.layout if baud is None else replace(known.layout, baud_rate=baud) for known in formats.values()
    ]
    found = {(one.baud_rate, one.data_bits, one.parity, one.stop_bits): one for one in layouts}
    usual = {int(rate): place for place, rate in enumerate(_FIRST)}
    ordered = sorted(found.values(), key=lambda one: (usual.get(one.baud_rate, len(usual)), one.parity != "N"))
    return ordered[:1] if one_only else ordered


# --------------------
# What sniffing found, for the terminal and as JSON


_HEADER = ("format", "frames", "rate", "gaps", "checksum", "bytes left over", "")


def document_of(found: Sniffed, formats: Mapping[str, KnownFormat]) -> dict[str, Any]:
    """Return everything as plain JSON."""
    best = found.proposed
    return {
        "schema": "gyrolock.fog.sniff/1",
        "source": found.source,
        "line": found.capture.line or None,
        "bytes": found.capture.size,
        "seconds": found.capture.seconds if found.capture.timed else None,
        "proposed": best.name if best is not None else None,
        "file": str(formats[best.name].file) if best is not None else None,
        "doubts": list(best.doubts) if best is not None else [],
        "as_likely": [one.name for one in found.as_likely],
        "formats": [_trial(one, formats[one.name]) for one in found.trials],
        "structure": {
            "text": found.structure.text,
            "frame_length": found.structure.length or None,
            "constant_bytes": {str(place): f"{byte:02X}" for place, byte in found.structure.constant.items()},
            "counting_bytes": {str(place): step for place, step in found.structure.counting.items()},
            "checksums": list(found.structure.checks),
            "highest_bit_clear": list(found.structure.highest_bit_clear),
            "remarks": list(found.structure.remarks),
            "example": found.structure.example.hex(" ").upper(),
        }
        if found.structure is not None
        else None,
        "tried_lines": list(found.quiet),
    }


def _trial(one: Trial, known: KnownFormat) -> dict[str, Any]:
    clock = one.clock
    return {
        "name": one.name,
        "file": str(known.file),
        "fits": one.fits,
        "frames": one.frames,
        "unusable": one.unusable,
        "damaged": one.damaged,
        "checksum_hits": one.frames if one.has_checksum else None,
        "checksum_misses": one.checksum_misses if one.has_checksum else None,
        "counter_gaps": one.gaps if one.has_counter else None,
        "missing": one.missing if one.has_counter else None,
        "stated_rate_hz": one.stated_rate_hz,
        "rate_hz": one.rate_hz,
        "rate_u_hz": clock.output_rate_hz * clock.u_ppm * 1e-6 if clock is not None else None,
        "difference_ppm": clock.difference_ppm if clock is not None else None,
        "bytes_unexplained": 1 - one.explained,
        "doubts": list(one.doubts),
    }


def show(found: Sniffed, formats: Mapping[str, KnownFormat]) -> None:
    """Print the table of descriptions and the proposal, or what the bytes show without one."""
    capture = found.capture
    how = f" at {capture.line} in {capture.seconds:.3g} s" if capture.timed else ""
    first = "the first " if not capture.timed and capture.size >= LOOKED_AT else ""
    say(f"{found.source}: {first}{capture.size} bytes{how}")
    rows = tuple(_row(one) for one in found.trials if one.frames)
    if rows:
        stdout_console().print(text_table(TextTable(_HEADER, rows), left=1))
    if len(rows) < len(found.trials):
        none = [one.name for one in found.trials if not one.frames]
        say(f"no frame of: {', '.join(none)}")
    best = found.proposed
    if best is None:
        say("No known description fits.", answer=True)
        for line in _told(found.structure):
            say(line)
        return
    known = formats[best.name]
    file = "" if known.shipped else f', link.frame_format_file = "{known.file}"'
    say(f'Proposed: link.frame_format = "{best.name}"{file}', answer=True)
    for other in found.as_likely:
        say(f"{other.name} fits as well: the data sheet decides.")
    for doubt in best.doubts:
        say(f"But: {doubt}.")
    if best.clock is not None and abs(best.clock.difference_ppm) > 1e4:
        say(
            f"The rate is {best.clock} from the stated {best.stated_rate_hz:g} Hz: it is measured and allowed for."
        )


def _row(one: Trial) -> tuple[str, ...]:
    clock = one.clock
    rate = "-"
    if clock is not None:
        rate = with_uncertainty(clock.output_rate_hz, clock.output_rate_hz * clock.u_ppm * 1e-6, "Hz")
    elif one.rate_hz is not None:
        rate = f"{one.rate_hz:.4g} Hz"
    gaps = f"{one.gaps} ({one.missing} missing)" if one.has_counter else "no counter"
    checks = f"{one.frames} right, {one.checksum_misses} wrong" if one.has_checksum else "none"
    verdict = "doubtful" if one.fits and one.doubts else "fits" if one.fits else ""
    return one.name, str(one.frames), rate, gaps, checks, f"{100 * (1 - one.explained):.1f} %", verdict


def _told(found: Structure | None) -> list[str]:
    """Say what is periodic in the bytes."""
    if found is None or not (found.length or found.text):
        example = found.example.hex(" ").upper() if found is not None else ""
        return [
            "Nothing repeats: most likely baud rate or parity are wrong, or the frames differ in length.",
            f"The first bytes: {example}",
        ]
    if found.text:
        lines = [f"{remark[0].upper()}{remark[1:]}." for remark in found.remarks]
        return [*lines, f"One of them: {found.example.decode('ascii', 'replace')}"]
    lines = [f"Most likely a frame has {found.length} bytes. Counted from 0:"]
    if found.constant:
        lines.append("  constant: " + ", ".join(f"byte {at} is {byte:02X}" for at, byte in found.constant.items()))
    if found.counting:
        lines.append("  counting: " + ", ".join(f"byte {at} by {step}" for at, step in found.counting.items()))
    if found.highest_bit_clear:
        places = ", ".join(map(str, found.highest_bit_clear))
        lines.append(f"  the highest bit is never set in bytes {places}: perhaps seven data bits a byte")
    lines += [f"  {check}" for check in found.checks]
    lines.append(f"  one frame: {found.example.hex(' ').upper()}")
    lines.append(
        "Copy the nearest file of config/frames, describe the frame in it, and try it with --formats FILE."
    )
    return lines


# --------------------
# The descriptions of frames that are known: those that come with the program, and a user's own


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
