"""Signals and faults that `gyrolock simulate` takes as text."""

import numpy as np
import pytest

from instrument.simulated import SimulatedTDS2014, VirtualClock, resource_manager
from station.errors import UsageError
from station.scope.tools import KINDS, parse_fault, parse_signal


def test_a_file_is_repeated_without_a_gap(tmp_path):
    path = tmp_path / "saw.csv"
    path.write_text("time;volts\n0.0;0.0\n0.001;1.0\n0.002;2.0\n0.003;1.0\n")
    shown = parse_signal(f"CH3={path}")
    times = np.array([0.0, 0.5e-3, 2e-3, 3.5e-3, 4e-3, 1.0015, -1e-3])
    assert shown.channel == 3
    assert shown.signal(times) == pytest.approx([0.0, 0.5, 2.0, 0.5, 0.0, 1.5, 1.0])


def test_a_file_of_the_scope_comes_back_as_it_was_recorded(tmp_path):
    scope = SimulatedTDS2014(
        {1: lambda t: np.sin(2 * np.pi * 400.0 * t)}, model="TDS2014B", clock=VirtualClock(), noise_levels=0.0
    )
    manager = resource_manager(scopes={"GPIB0::1::INSTR": scope})
    with manager.open_resource("GPIB0::1::INSTR") as opened:
        opened.write(
            "CH1:PROBE 1;SCALE 0.5;:HOR:SCALE 1E-3;:ACQ:STOPA SEQ;STATE RUN;*WAI;:SAVE:WAVEFORM CH1,'A.CSV'"
        )
        opened.query("*OPC?")
    manager.close()
    path = tmp_path / "A.CSV"
    path.write_bytes(scope.storage.files["A:\\A.CSV"])
    played = parse_signal(str(path)).signal
    volts = played(4e-6 * np.arange(5000))
    # 10 ms hold four periods: begun again without a step
    assert np.abs(np.diff(volts)).max() < 0.05
    assert np.ptp(volts) == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("hello\n", "neither a Tek file"),
        ("0,1\n1,2\n5,3\n", "even steps"),
        ("1,1\n0,2\n", "even steps"),
        ("", "Tek"),
    ],
)
def test_files_that_are_no_signal(tmp_path, content, words):
    path = tmp_path / "bad.csv"
    path.write_text(content)
    with pytest.raises(UsageError, match=words):
        parse_signal(str(path))


def test_every_kind_of_fault_can_be_named():
    for kind in KINDS:
        command = ":CH1:SCALE 2" if kind.startswith("knob") else ""
        assert parse_fault(f"{kind}:0.5{command}").kind == kind
    with pytest.raises(UsageError, match="what the hand turns"):
        parse_fault("knob turned:0.5")
