"""Who has an instrument: two processes on one link, one that was killed, and names that mean the same link."""

import os
import signal
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
import pyvisa

from instrument import TDS2014, LinkError, SettingError
from instrument.claims import claim, link_of
from instrument.controllers import Controller, parse_template
from instrument.discovery import check_resource
from instrument.pyvisa_sessions import claim_instrument
from instrument.rate_table import ControlledRateTable
from instrument.simulated import SimulatedRateTable, SimulatedTDS2014, TcpServer
from instrument.simulated.controllers import LineServer, RateTableController, SimulatedPowerSupply
from instrument.simulated.links.scope_servers import GpibAdapterServer

SHIPPED = Path(__file__).parents[3] / "config" / "controllers" / "rate_table.toml"

HOLDS = """
import sys, time
from instrument.claims import claim
claim(sys.argv[1], "campaign Acceptance, unit 7")
print("holds", flush=True)
time.sleep(60)
"""


@pytest.fixture(autouse=True)
def locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GYROLOCK_LOCKS", str(tmp_path))
    return tmp_path


@contextmanager
def another_program(name: str) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen([sys.executable, "-c", HOLDS, name], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "holds\n"
        try:
            yield process
        finally:
            process.kill()


class Refusing(RateTableController):
    """A rate table whose drive cannot be switched on."""

    def answer(self, line: str) -> str | None:
        return "ERR the interlock is open" if line == "ENABLE" else super().answer(line)


def test_a_table_that_cannot_be_switched_on_is_let_go() -> None:
    template = parse_template(tomllib.loads(SHIPPED.read_text(encoding="utf-8")), "rate_table")
    with LineServer(Refusing(SimulatedRateTable()), tcp_port=0) as server:
        with pytest.raises(SettingError, match="refuses 'ENABLE': ERR the interlock is open"):
            ControlledRateTable(Controller(server.resource_name, template))
        with another_program(server.resource_name):
            pass


@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_a_second_program_is_refused_by_name_and_one_that_was_killed_holds_nothing(locks: Path) -> None:
    supply = SimulatedPowerSupply()
    with TcpServer(SimulatedTDS2014()) as server, LineServer(supply, tcp_port=0, end="\n") as other:
        host, port = f"localhost::{server.port}", str(server.port)
        with another_program(f"TCPIP::{host}::SOCKET") as process:
            said = rf"is in use by process {process.pid} \(campaign Acceptance, unit 7\), since 20\d\d-.* UTC; end"
            with pytest.raises(LinkError, match=rf"^TCPIP0::127\.0\.0\.1::{port}::SOCKET {said}"):
                TDS2014(server.resource_name)
            assert "is in use by process" in str(check_resource(server.resource_name).problem)
            process.send_signal(signal.SIGKILL)
            process.wait(10)
        assert len(list(locks.iterdir())) == 1  # what is left of it
        with TDS2014(server.resource_name) as scope, TDS2014(server.resource_name) as again:
            assert scope.identity == again.identity  # one program may do so twice
        assert list(locks.iterdir()) == []
        with another_program(other.resource_name), pytest.raises(LinkError, match="is in use by process"):
            template = {"kind": "power supply", "name": "x", "voltage": {"ask": "VOLT?"}}
            Controller(other.resource_name, parse_template(template, "x"))


def test_a_claim_is_kept_until_the_last_one_is_released(locks: Path) -> None:
    first, second = claim("GPIB0::1::INSTR"), claim("gpib0::1")
    first.release()
    first.release()
    with another_process_tries("GPIB::1::INSTR") as refused:
        assert refused
    second.release()
    with another_process_tries("GPIB::1::INSTR") as refused:
        assert not refused


@contextmanager
def another_process_tries(name: str) -> Iterator[bool]:
    text = "import sys; from instrument.claims import claim; claim(sys.argv[1])"
    done = subprocess.run([sys.executable, "-c", text, name], capture_output=True, text=True, check=False)
    assert done.returncode == 0 or "is in use by process" in done.stderr
    yield done.returncode != 0


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write every file")
def test_another_users_file_that_cannot_be_written_is_locked_all_the_same(locks: Path) -> None:
    with claim("GPIB0::5::INSTR"):
        (path,) = locks.iterdir()
    path.write_text('{"link": "gpib 0 5", "pid": 1, "user": "li", "doing": "old", "since": "2020"}')
    path.chmod(0o444)
    with claim("GPIB0::5::INSTR"), another_process_tries("GPIB0::5::INSTR") as refused:
        assert refused


def test_where_no_file_can_be_written_nobody_is_kept_from_anything(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GYROLOCK_LOCKS", "/nowhere/at/all")
    with claim("GPIB0::1::INSTR"), claim("loop://"):
        pass


def test_names_of_one_link(tmp_path: Path) -> None:
    device = tmp_path / "ttyUSB0"
    device.write_text("")
    link = tmp_path / "by-id"
    link.symlink_to(device)
    alike = [
        ("TCPIP0::localhost::4001::SOCKET", "TCPIP::127.0.0.1::4001::SOCKET"),
        ("socket://[::1]:4002", "TCPIP0::127.0.0.1::4002::SOCKET"),
        ("PRLGX-TCPIP0::127.0.0.1::1234::GPIB0::1::INSTR", "PRLGX-TCPIP::127.0.0.1::1234::GPIB::7"),
        ("TCPIP0::10.0.0.5::INSTR", "TCPIP::10.0.0.5::inst0::INSTR"),
        (f"ASRL{link}::INSTR", f"asrl{device}::INSTR"),
        ("COM3", "ASRL3::INSTR", "ASRLCOM3::INSTR"),
        (
            "USB0::0x0699::0x0368::C012345::INSTR",
            "USB0::0x0699::0x0368::C012345::0::INSTR",
            "USB::1689::872::c012345::0::INSTR",
            "usb0::0X0699::0x368::C012345::instr",
            "USB0::0x0699::0x0368::C012345",
        ),
        ("GPIB0::1::INSTR", "gpib::1", "GPIB0::01::instr"),
        ("TCPIP0::10.0.0.6::hislip0::INSTR", "TCPIP::10.0.0.6::hislip0,4880"),
        ("PRLGX-TCPIP0::10.0.0.7::GPIB0::1::INSTR", "PRLGX-TCPIP0::10.0.0.7::1234::INTFC"),
    ]
    for names in alike:
        assert len({link_of(one) for one in names}) == 1, names
    different = [names[0] for names in alike]
    assert len({link_of(one) for one in different}) == len(different)
    assert link_of("TCPIP0::10.0.0.5::hislip0::INSTR") != link_of("TCPIP0::10.0.0.5::hislip1::INSTR")


def test_an_alias_of_a_vendors_visa_is_the_scope_that_it_stands_for(locks: Path) -> None:
    class Vendor:
        visalib = object()

        def resource_info(self, name: str) -> SimpleNamespace:
            return SimpleNamespace(
                resource_name="USB0::0x0699::0x036A::C7::INSTR" if name == "bench scope" else None
            )

    vendor = cast(pyvisa.ResourceManager, Vendor())
    with another_program("USB0::1689::874::C7::0::INSTR") as process, pytest.raises(LinkError) as refused:
        claim_instrument("bench scope", vendor)
    assert str(refused.value).startswith(f"bench scope is in use by process {process.pid} ")
    with claim_instrument("another scope", vendor):
        pass


def test_a_gpib_name_behind_an_adapter_that_is_open_is_that_adapter(locks: Path) -> None:
    with GpibAdapterServer(SimulatedTDS2014(), address=7) as server:
        manager = pyvisa.ResourceManager("@py")
        adapter = manager.open_resource(server.interface_name)
        try:
            with another_program(server.resource_name), pytest.raises(LinkError, match="in use by process"):
                claim_instrument("GPIB0::7::INSTR", manager)
        finally:
            adapter.close()
