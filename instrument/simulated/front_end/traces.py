"""What stands on the screen as data: a trace is 8-bit codes with the scales that WFMPre? tells.

Source: programmer manual 071-1075-04, pp. 2-84 to 2-91 and 2-240 to 2-260.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from instrument.facts import LEVELS_PER_DIVISION, NO_DATA, POINTS
from instrument.simulated.front_end.acquisition import Record
from instrument.simulated.front_end.frontend import Codes
from instrument.simulated.panel.formats import block, nr3, quoted
from instrument.simulated.panel.panel import ChannelSettings, Panel

MODE_WORDS = {"SAMPLE": "Sample", "AVERAGE": "Average", "PEAKDETECT": "Pk Detect"}
PREAMBLE_FIELDS = (
    "BYT_Nr", "BIT_Nr", "ENCdg", "BN_Fmt", "BYT_Or", "NR_Pt", "WFId", "PT_Fmt", "XINcr", "PT_Off", "XZEro",
    "XUNit", "YMUlt", "YZEro", "YOFf", "YUNit",
)  # fmt: skip
TRANSMISSION_FIELDS = PREAMBLE_FIELDS[:5]


@dataclass(frozen=True)
class Trace:
    """One waveform as it can be transferred; scales are those of one-byte codes."""

    codes: Codes
    wfid: str
    pt_fmt: str
    xincr: float
    xzero: float
    xunit: str
    ymult: float
    yzero: float
    yoff: float
    yunit: str

    @property
    def points(self) -> int:
        """Number of codes: 2500, or 1024 of a spectrum."""
        return len(self.codes)


@dataclass(frozen=True)
class Transfer:
    """The DATa settings: how codes travel, and which of them."""

    encoding: str
    width: int
    start: int
    stop: int

    @classmethod
    def of(cls, panel: Panel) -> Transfer:
        """Read the DATa settings from the panel."""
        return cls(
            encoding=panel.text("DATA:ENCDG"),
            width=int(panel.number("DATA:WIDTH")),
            start=int(panel.number("DATA:START")),
            stop=int(panel.number("DATA:STOP")),
        )

    @property
    def positive(self) -> bool:
        """True for the unsigned formats."""
        return self.encoding in ("RPBINARY", "SRPBINARY")

    @property
    def swapped(self) -> bool:
        """True if START lies behind STOP; CURVe? takes them the other way round."""
        return self.start > self.stop

    def window(self, points: int) -> slice:
        """The points from START to STOP, at least one."""
        low, high = sorted((self.start, self.stop))
        return slice(min(low, points) - 1, min(high, points))

    @property
    def fields(self) -> dict[str, str]:
        """The five fields of the preamble that a waveform is not needed for."""
        ascii_ = self.encoding == "ASCII"
        return {
            "BYT_Nr": str(self.width),
            "BIT_Nr": str(8 * self.width),
            "ENCdg": "ASC" if ascii_ else "BIN",
            "BN_Fmt": "RP" if self.positive or ascii_ else "RI",
            "BYT_Or": "LSB" if self.encoding.startswith("SR") else "MSB",
        }


def empty_reference(name: str) -> Trace:
    """A reference memory that was never written."""
    letter = name[-1]
    wfid = f"Ref{letter}, DC coupling, 1.0E0 V/div, 5.0E-4 s/div, {POINTS} points, Sample mode"
    codes = np.full(POINTS, NO_DATA, dtype=np.int8)
    return Trace(codes, wfid, "Y", 2e-6, -2.5e-3, "s", 0.04, 0.0, 0.0, "Volts")


def channel_trace(record: Record, name: str, codes: Codes, channel: ChannelSettings, yunit: str) -> Trace:
    """Trace of a channel with the settings of its acquisition."""
    wfid = (
        f"Ch{name[2:]}, {channel.coupling} coupling, {nr3(channel.scale)} V/div, "
        f"{nr3(record.seconds_per_division)} s/div, {POINTS} points, {MODE_WORDS[record.mode]} mode"
    )
    return Trace(
        codes=codes,
        wfid=wfid,
        pt_fmt="ENV" if record.mode == "PEAKDETECT" else "Y",
        xincr=record.xincr,
        xzero=record.xzero,
        xunit="s",
        ymult=channel.scale / LEVELS_PER_DIVISION,
        yzero=0.0,
        yoff=LEVELS_PER_DIVISION * channel.position,
        yunit=yunit,
    )


def preamble(trace: Trace | None, transfer: Transfer) -> dict[str, str]:
    """Values of the 16 fields of WFMPre?, or of the first five without a trace."""
    fields = transfer.fields
    if trace is None:
        return fields
    window = transfer.window(trace.points)
    scale = 256 if transfer.width == 2 else 1
    centre = 128 if transfer.positive else 0
    return {
        **fields,
        "NR_Pt": str(window.stop - window.start),
        "WFId": quoted(trace.wfid),
        "PT_Fmt": trace.pt_fmt,
        "XINcr": nr3(trace.xincr, 9),
        "PT_Off": "0",
        "XZEro": nr3(trace.xzero, 9),
        "XUNit": quoted(trace.xunit),
        "YMUlt": nr3(trace.ymult / scale, 9),
        "YZEro": nr3(trace.yzero, 9),
        "YOFf": nr3(scale * (trace.yoff + centre), 9),
        "YUNit": quoted(trace.yunit),
    }


def encode(trace: Trace, transfer: Transfer) -> bytes:
    """The codes as CURVe? sends them: a block, or a list of numbers."""
    codes = trace.codes[transfer.window(trace.points)]
    if transfer.encoding == "ASCII":
        scale = 256 if transfer.width == 2 else 1
        return ",".join(map(str, (codes.astype(np.int32) * scale).tolist())).encode()
    if transfer.positive:
        codes = (codes.view(np.uint8) ^ 0x80).view(np.int8)
    if transfer.width == 1:
        return block(codes.tobytes())
    wide = np.zeros((len(codes), 2), dtype=np.int8)
    wide[:, 1 if transfer.encoding.startswith("SR") else 0] = codes
    return block(wide.tobytes())


def decode(data: bytes, transfer: Transfer) -> Codes:
    """Codes of a block that CURVe sends to the instrument; the low byte of two is dropped."""
    raw = np.frombuffer(data[: len(data) // transfer.width * transfer.width], dtype=np.int8)
    if transfer.width == 2:
        raw = raw[1::2] if transfer.encoding.startswith("SR") else raw[::2]
    return (raw.view(np.uint8) ^ 0x80).view(np.int8) if transfer.positive else raw.copy()


def stored(trace: Trace, codes: Codes) -> Trace:
    """The same trace with other codes."""
    return replace(trace, codes=codes)
