"""The named PyVISA backend, used by a program that knows only PyVISA."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import pyvisa

ROOT = Path(__file__).parents[2]
PROGRAM = """
import pyvisa

manager = pyvisa.ResourceManager()
name = manager.list_resources()[0]
scope = manager.open_resource(name)
scope.read_termination = scope.write_termination = "\\n"
print(scope.query("*IDN?"))
scope.write("HEADER OFF")
scope.write("DATA:ENCDG RIBINARY")
codes = scope.query_binary_values("CURVE?", datatype="b")
print(len(codes), max(codes) - min(codes))
scope.close()
manager.close()
"""


def run(library):
    environment = {**os.environ, "PYVISA_LIBRARY": library, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "-W", "error::ResourceWarning", "-c", PROGRAM],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_program_that_knows_only_pyvisa():
    result = run("@gyrolock")
    assert result.stderr == ""
    identity, numbers = result.stdout.splitlines()
    assert identity == "TEKTRONIX,TDS 2014,0,CF:91.1CT FV:v4.12 TDS2CM:CMV:v1.04"
    count, span = map(int, numbers.split())
    assert count == 2500
    # 4 V from peak to peak at 1 V/div and 25 codes a division, and noise.
    assert abs(span - 100) <= 6


def test_another_model():
    result = run("TDS1002@gyrolock")
    assert result.stderr == ""
    assert result.stdout.startswith("TEKTRONIX,TDS 1002,")


def test_unknown_model_is_named():
    with pytest.raises(OSError, match="TDS9999"):
        pyvisa.ResourceManager("TDS9999@gyrolock")


@pytest.mark.parametrize("name", ["GPIB0::1::INSTR", "USB0::0x0699::0x0368::C010101::INSTR", "ASRL1::INSTR"])
def test_every_name_is_the_same_scope(name):
    manager = pyvisa.ResourceManager("@gyrolock")
    assert name in manager.list_resources("?*")
    with manager.open_resource(name) as scope:
        scope.write("HEADER OFF")
        scope.write("DATA:ENCDG RIBINARY")
        scope.timeout = 5000
        codes = scope.query_binary_values("CURVE?", datatype="b", container=np.ndarray)
        assert codes.shape == (2500,)
    manager.close()
