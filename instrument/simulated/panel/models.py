"""The models of the family: what differs between a TDS1002 and a TPS2014."""

import difflib
import re
from dataclasses import dataclass
from functools import cached_property

from instrument.simulated.panel.parsing import Mnemonics


@dataclass(frozen=True)
class Model:
    """One model: its answer to `*IDN?` and the sizes that shape its command set."""

    name: str
    identity: str
    channels: int
    references: str  # letters
    sample_rate: float  # S/s, the highest
    fastest: float  # s/div
    bandwidth: float  # Hz
    probes: tuple[float, ...]
    letter_series: bool  # B, C and TPS: other answers for PROBe, YUNit, MATH:VERtical

    @cached_property
    def series(self) -> str:
        """`TPS`, `B` or `C`; empty for the first series. A TBS1000 is a C by another name."""
        return {"TPS": "TPS", "TBS": "C"}.get(self.name[:3], self.name[-1] if self.letter_series else "")

    @cached_property
    def firmware(self) -> float:
        """Version by `*IDN?`, such as 22.16; 0 where the answer names none."""
        found = re.search(r"FV:v(\d+\.\d+)", self.identity)
        return float(found[1]) if found else 0.0

    @cached_property
    def has_rms(self) -> bool:
        """Whether it measures the RMS of the whole record, by a method that can be chosen: C, and B from 24 on."""
        return self.series == "C" or (self.series == "B" and self.firmware >= 24)

    @cached_property
    def has_storage(self) -> bool:
        """Whether a memory card or a USB stick fits in; the first series needs the module TDS2MEM for it."""
        return self.letter_series or "TDS2MEM" in self.identity

    @cached_property
    def has_power_key(self) -> bool:
        """Whether the application key for power measurements is in (TPS)."""
        return "TPS2PWR1" in self.identity

    @cached_property
    def measurements(self) -> int:
        """How many stand on the screen at once."""
        return 6 if self.name.startswith("TBS") and self.name.endswith("B") else 5

    @cached_property
    def channel_names(self) -> Mnemonics:
        """`CH1` and so on."""
        return tuple(f"CH{number}" for number in range(1, self.channels + 1))

    @cached_property
    def reference_names(self) -> Mnemonics:
        """`REFA` and so on."""
        return tuple(f"REF{letter}" for letter in self.references)

    @cached_property
    def waveform_names(self) -> Mnemonics:
        """Everything that can be shown on the screen."""
        return (*self.channel_names, "MATH", *self.reference_names)


_FIRST = (1.0, 10.0, 100.0, 1000.0)
_LATER = (1.0, 10.0, 20.0, 50.0, 100.0, 500.0, 1000.0)

# name, serial, firmware, channels, MHz, GS/s
_ROWS = (
    ("TDS1002", "0", "FV:v2.06 TDS2CM:CMV:v1.04", 2, 60, 1),
    ("TDS1012", "0", "FV:v2.12 TDS2CM:CMV:v1.04", 2, 100, 1),
    ("TDS2002", "0", "FV:v2.12 TDS2CM:CMV:v1.04", 2, 60, 1),
    ("TDS2004", "0", "FV:v4.12 TDS2CM:CMV:v1.04", 4, 60, 1),
    ("TDS2012", "0", "FV:v2.12 TDS2CM:CMV:v1.04", 2, 100, 1),
    ("TDS2014", "0", "FV:v4.12 TDS2CM:CMV:v1.04", 4, 100, 1),
    ("TDS2022", "0", "FV:v2.12 TDS2CM:CMV:v1.04", 2, 200, 2),
    ("TDS2024", "0", "FV:v4.12 TDS2CM:CMV:v1.04", 4, 200, 2),
    ("TDS2012+TDS2MEM", "0", "TDS2MEM:FV:v6.08", 2, 100, 1),
    ("TDS2014+TDS2MEM", "0", "TDS2MEM:FV:v6.08", 4, 100, 1),
    ("TDS1001B", "C010105", "FV:v22.11", 2, 40, 0.5),
    ("TDS1002B", "C010106", "FV:v22.11", 2, 60, 1),
    ("TDS1012B", "C010103", "FV:v22.01", 2, 100, 1),
    ("TDS2002B", "C010107", "FV:v22.11", 2, 60, 1),
    ("TDS2004B", "C010108", "FV:v22.11", 4, 60, 1),
    ("TDS2012B", "C062851", "FV:v22.01", 2, 100, 1),
    ("TDS2014B", "C010101", "FV:v22.16", 4, 100, 1),
    ("TDS2022B", "C010104", "FV:v22.01", 2, 200, 2),
    ("TDS2024B", "C100044", "FV:v24.02", 4, 200, 2),
    ("TDS2001C", "C010109", "FV:v24.26", 2, 50, 0.5),
    ("TDS2002C", "C010110", "FV:v24.26", 2, 70, 1),
    ("TDS2004C", "C010111", "FV:v24.26", 4, 70, 1),
    ("TDS2012C", "C010112", "FV:v24.26", 2, 100, 2),
    ("TDS2014C", "C010102", "FV:v24.26", 4, 100, 2),
    ("TDS2022C", "C010113", "FV:v24.26", 2, 200, 2),
    ("TDS2024C", "C042765", "FV:v24.26", 4, 200, 2),
    ("TPS2012", "0", "FV:v9.48 TPS2PWR1:v1.00", 2, 100, 1),
    ("TPS2014", "0", "FV:v10.14", 4, 100, 1),
    ("TPS2024", "0", "FV:v10.14", 4, 200, 2),
    ("TBS1022", "C010114", "FV:v26.01", 2, 25, 0.5),
    ("TBS1042", "C010115", "FV:v26.01", 2, 40, 0.5),
    ("TBS1062", "C010116", "FV:v26.01", 2, 60, 1),
    ("TBS1102", "C010117", "FV:v26.01", 2, 100, 1),
    ("TBS1152", "C010118", "FV:v26.01", 2, 150, 1),
    ("TBS1052B", "C010119", "FV:v4.06", 2, 50, 1),
    ("TBS1072B", "C010120", "FV:v4.06", 2, 70, 1),
    ("TBS1102B", "C010121", "FV:v4.06", 2, 100, 2),
    ("TBS1152B", "C010122", "FV:v4.06", 2, 150, 2),
    ("TBS1202B", "C010123", "FV:v4.06", 2, 200, 2),
)  # fmt: skip


def _model(name: str, serial: str, firmware: str, channels: int, megahertz: float, gigasamples: float) -> Model:
    brand, digits = name[:3], name[3:].partition("+")[0]
    first = digits.isdigit() and brand == "TDS"
    return Model(
        name=name,
        identity=f"TEKTRONIX,{brand} {digits},{serial},CF:91.1CT {firmware}",
        channels=channels,
        references="ABCD" if channels == 4 else "AB",
        sample_rate=gigasamples * 1e9,
        fastest=2.5e-9 if gigasamples > 1 else 5e-9,
        bandwidth=megahertz * 1e6,
        probes=_FIRST if first else _LATER,
        letter_series=not first,
    )


MODELS = {row[0]: _model(*row) for row in _ROWS}


def find_model(name: str) -> Model:
    """Look up a model by its name, or a family's first (``TBS1000B``); ValueError names those spelled alike."""
    wanted = name.upper().replace(" ", "")
    family = re.compile(re.escape(wanted).replace("000", r"\d{3}"))
    for one in (wanted, *MODELS):
        if one in MODELS and family.fullmatch(one):
            return MODELS[one]
    known = difflib.get_close_matches(wanted, MODELS, 3, 0.7) or list(MODELS)
    raise ValueError(f"there is no simulated model {name!r}; choose one of {', '.join(known)}")
