"""The code on the driver's documentation page runs as printed, on a simulated scope."""

import importlib
import re
import runpy
from pathlib import Path

import matplotlib
import pytest
import pyvisa

from instrument.simulated import resource_manager

PAGE = Path(__file__).parents[3] / "docs" / "driver.md"


@pytest.mark.slow
def test_page_runs(tmp_path, monkeypatch, capsys):
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(blocks) >= 6
    script = tmp_path / "page.py"
    script.write_text("\n".join(blocks), encoding="utf-8")
    matplotlib.use("Agg")
    visa = resource_manager()
    # The page opens "GPIB0::1::INSTR" with whatever VISA there is: here the simulated one.
    importlib.import_module("instrument.discovery")  # its annotations are of the real class
    monkeypatch.setattr(pyvisa, "ResourceManager", lambda *_: visa)
    monkeypatch.chdir(tmp_path)
    results = runpy.run_path(str(script))
    visa.close()
    results["plt"].close("all")
    assert results["first"].codes.shape == (2500,)
    printed = capsys.readouterr().out
    assert "TDS 2014 ('CH1', 'CH2', 'CH3', 'CH4')" in printed
    assert "F0000CH1.CSV" in printed
    assert "did not complete within 0.1 s" in printed


def test_every_exception_is_on_the_page():
    import instrument

    text = PAGE.read_text(encoding="utf-8")
    errors = [
        name
        for name in instrument.__all__
        if isinstance(getattr(instrument, name), type) and issubclass(getattr(instrument, name), Exception)
    ]
    assert len(errors) > 8
    missing = [
        name for name in errors if f"`{name}`" not in text and name not in ("ScopeEvent", "FileFormatError")
    ]
    assert missing == []
