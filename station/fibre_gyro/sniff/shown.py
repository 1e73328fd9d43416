"""What sniffing found, for the terminal and as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from instrument.fibre_gyro.sniff import LOOKED_AT, Structure, Trial
from station.fibre_gyro.sniff.known import KnownFormat
from station.fibre_gyro.sniff.search import Sniffed
from station.report.console import text_table
from station.results.numbers import with_uncertainty
from station.results.parts import TextTable
from station.terminal.console import stdout_console
from station.terminal.lines import say

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
        "structure": _structure(found.structure) if found.structure is not None else None,
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


def _structure(found: Structure) -> dict[str, Any]:
    return {
        "text": found.text,
        "frame_length": found.length or None,
        "constant_bytes": {str(place): f"{byte:02X}" for place, byte in found.constant.items()},
        "counting_bytes": {str(place): step for place, step in found.counting.items()},
        "checksums": list(found.checks),
        "highest_bit_clear": list(found.highest_bit_clear),
        "remarks": list(found.remarks),
        "example": found.example.hex(" ").upper(),
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
        say("No known description fits.")
        for line in _told(found.structure):
            say(line)
        return
    known = formats[best.name]
    file = "" if known.shipped else f', link.frame_format_file = "{known.file}"'
    say(f'Proposed: link.frame_format = "{best.name}"{file}')
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
