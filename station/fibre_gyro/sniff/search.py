"""Listens to a gyro, or reads a file, and tries every known description on what comes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from instrument import LinkError
from instrument.fibre_gyro import FrameFormat
from instrument.fibre_gyro.sniff import (
    Capture,
    Structure,
    Trial,
    capture_port,
    captured_file,
    find_structure,
    poll_of,
    try_format,
)
from station.errors import UsageError
from station.fibre_gyro.sniff.known import KnownFormat

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
