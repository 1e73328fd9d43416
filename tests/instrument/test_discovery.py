"""Finding instruments, and one sentence about each that cannot be used."""

import re
from threading import Event

import pytest
from pyvisa.constants import InterfaceType

from instrument import TDS2014, FoundResource, LinkError, find_resources
from instrument.discovery import check_resource, missing_transports
from instrument.simulated import Faults, SimulatedTDS2014, resource_manager


def test_scopes_are_found_and_others_explained(impatient):
    other = Faults()
    other.identity = "HEWLETT-PACKARD,34401A,0,10-5-2"
    scopes = {"GPIB0::1::INSTR": SimulatedTDS2014(), "GPIB0::5::INSTR": SimulatedTDS2014(faults=other)}
    visa = resource_manager(scopes=scopes)
    found = {resource.resource_name: resource for resource in find_resources(visa)}
    visa.close()
    assert set(found) == set(scopes)
    scope = found["GPIB0::1::INSTR"]
    assert scope.problem is None
    assert scope.identity is not None
    assert scope.identity.model == "TDS 2014"
    assert found["GPIB0::5::INSTR"].identity is None
    assert "34401A" in (found["GPIB0::5::INSTR"].problem or "")


def test_looking_at_a_scope_changes_nothing(impatient):
    scope = SimulatedTDS2014()
    list(scope.execute(b"HEADER ON"))

    def setup():
        return b"".join(answer or b"" for answer in scope.execute(b"SET?"))

    before = setup()
    visa = resource_manager(scopes={"GPIB0::1::INSTR": scope})
    find_resources(visa)
    visa.close()
    assert setup() == before


def test_a_name_that_cannot_be_opened(manager):
    found = check_resource("ASRL/dev/none::INSTR", manager)
    assert found == FoundResource("ASRL/dev/none::INSTR", None, found.problem)
    assert "cannot open ASRL/dev/none::INSTR" in (found.problem or "")


def test_a_scope_on_a_socket(line_server, line_scope, manager):
    found = check_resource(line_server.resource_name, manager)
    assert found.identity is not None
    assert line_scope.settings["HEADER"] == "1"


def test_port_without_permission(manager, monkeypatch):
    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied", "/dev/ttyUSB0")

    monkeypatch.setattr(manager.visalib, "open", refuse)
    found = check_resource("ASRL1::INSTR", manager)
    assert "Permission denied" in (found.problem or "")
    assert "dialout" in (found.problem or "")


def test_visa_that_cannot_list(manager, monkeypatch):
    sessions = pytest.importorskip("pyvisa_py.sessions")

    class Refusing:
        @staticmethod
        def list_resources():
            raise OSError("no driver")

    kinds = [((InterfaceType.asrl, "INSTR"), Refusing)]
    monkeypatch.setattr(sessions.Session, "iter_valid_session_classes", classmethod(lambda cls: iter(kinds)))
    with pytest.raises(LinkError, match="no driver"):
        find_resources(manager)


def test_the_network_is_not_waited_for_without_end(manager, monkeypatch):
    """A kind of link on the network that never ends its look costs neither the others nor the list."""
    sessions = pytest.importorskip("pyvisa_py.sessions")
    ended, asked = Event(), []

    class Silent:
        @staticmethod
        def list_resources():
            asked.append("network")
            ended.wait()
            return ["TCPIP::late::INSTR"]

    class Local:
        @staticmethod
        def list_resources():
            return ["ASRL/dev/none::INSTR"]

    kinds = [((InterfaceType.tcpip, "INSTR"), Silent), ((InterfaceType.asrl, "INSTR"), Local)]
    monkeypatch.setattr(sessions.Session, "iter_valid_session_classes", classmethod(lambda cls: iter(kinds)))
    monkeypatch.setattr("instrument.discovery.LAN_PATIENCE_S", 0.05)
    try:
        assert [one.resource_name for one in find_resources(manager)] == ["ASRL/dev/none::INSTR"]
        assert [one.resource_name for one in find_resources(manager, lan=False)] == ["ASRL/dev/none::INSTR"]
    finally:
        ended.set()
    assert asked == ["network"]


def test_missing_transports_name_the_remedy(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert missing_transports()["USB"] == "install pyusb and libusb"
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    assert missing_transports() == {}


@pytest.mark.parametrize(
    ("name", "form"),
    [
        ("192.168.1.5", "TCPIP0::192.168.1.5::INSTR or TCPIP0::192.168.1.5::PORT::SOCKET"),
        ("scope-2.lab", "TCPIP0::scope-2.lab::INSTR"),
        ("/dev/ttyUSB9", "ASRL/dev/ttyUSB9::INSTR"),
        ("COM7", "ASRLCOM7::INSTR"),
    ],
)
def test_a_host_or_a_port_in_the_place_of_a_visa_name_is_told_its_right_form(name: str, form: str) -> None:
    with pytest.raises(LinkError, match=re.escape(form)):
        TDS2014(name)
