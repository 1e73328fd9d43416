"""The models of the family: what differs between a TDS1002 and a TPS2014."""

from __future__ import annotations

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
        """`TPS`, `B` or `C`; empty for the first series."""
        return "TPS" if self.name.startswith("TPS") else self.name[-1] if self.letter_series else ""

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


_BANDWIDTHS = {"0": 60e6, "1": 100e6, "2": 200e6}  # Hz, by the third digit of the name
_FIRST = (1.0, 10.0, 100.0, 1000.0)
_LATER = (1.0, 10.0, 20.0, 50.0, 100.0, 500.0, 1000.0)


def _model(name: str, serial: str, firmware: str, channels: int, rate: float = 1e9) -> Model:
    brand, digits = name[:3], name[3:].partition("+")[0]
    first = digits.isdigit() and brand == "TDS"
    return Model(
        name=name,
        identity=f"TEKTRONIX,{brand} {digits},{serial},CF:91.1CT {firmware}",
        channels=channels,
        references="ABCD" if channels == 4 else "AB",
        sample_rate=rate,
        fastest=2.5e-9 if rate > 1e9 else 5e-9,
        bandwidth=_BANDWIDTHS[digits[2]],
        probes=_FIRST if first else _LATER,
        letter_series=not first,
    )


MODELS = {
    model.name: model
    for model in (
        _model("TDS1002", "0", "FV:v2.06 TDS2CM:CMV:v1.04", 2),
        _model("TDS1012", "0", "FV:v2.12 TDS2CM:CMV:v1.04", 2),
        _model("TDS2002", "0", "FV:v2.12 TDS2CM:CMV:v1.04", 2),
        _model("TDS2004", "0", "FV:v4.12 TDS2CM:CMV:v1.04", 4),
        _model("TDS2012", "0", "FV:v2.12 TDS2CM:CMV:v1.04", 2),
        _model("TDS2014", "0", "FV:v4.12 TDS2CM:CMV:v1.04", 4),
        _model("TDS2022", "0", "FV:v2.12 TDS2CM:CMV:v1.04", 2, 2e9),
        _model("TDS2024", "0", "FV:v4.12 TDS2CM:CMV:v1.04", 4, 2e9),
        _model("TDS2012+TDS2MEM", "0", "TDS2MEM:FV:v6.08", 2),
        _model("TDS2014+TDS2MEM", "0", "TDS2MEM:FV:v6.08", 4),
        _model("TDS1012B", "C010103", "FV:v22.01", 2),
        _model("TDS2012B", "C062851", "FV:v22.01", 2),
        _model("TDS2022B", "C010104", "FV:v22.01", 2, 2e9),
        _model("TDS2014B", "C010101", "FV:v22.16", 4),
        _model("TDS2024B", "C100044", "FV:v24.02", 4, 2e9),
        _model("TDS2014C", "C010102", "FV:v24.26", 4, 2e9),
        _model("TDS2024C", "C042765", "FV:v24.26", 4, 2e9),
        _model("TPS2012", "0", "FV:v9.48 TPS2PWR1:v1.00", 2),
        _model("TPS2014", "0", "FV:v10.14", 4),
    )
}


def find_model(name: str) -> Model:
    """Look up a model by its name."""
    try:
        return MODELS[name.upper().replace(" ", "")]
    except KeyError:
        known = ", ".join(MODELS)
        raise ValueError(f"there is no simulated model {name!r}; choose one of {known}") from None
