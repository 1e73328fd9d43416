"""Which VISA is taken: PyVISA's choice, which it makes once in a process, or what PYVISA_LIBRARY says."""

import pyvisa
from pyvisa.ctwrapper import IVIVisaLibrary

from instrument.pyvisa_sessions import visa_manager


def test_a_vendors_visa_is_looked_for_once(monkeypatch):
    chosen = type(pyvisa.ResourceManager().visalib)
    assert type(visa_manager().visalib) is chosen
    looked: list[int] = []
    monkeypatch.setattr(IVIVisaLibrary, "get_library_paths", lambda: looked.append(1) or ())
    assert type(visa_manager().visalib) is chosen
    assert not looked or chosen is IVIVisaLibrary


def test_what_the_environment_says_goes_before(monkeypatch):
    visa_manager()
    monkeypatch.setenv("PYVISA_LIBRARY", "@gyrolock")
    assert visa_manager().visalib.in_this_program
    assert type(visa_manager("@py").visalib).__module__.startswith("pyvisa_py")
