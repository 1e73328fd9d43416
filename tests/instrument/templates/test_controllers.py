"""Rate table, chamber and power supply by their templates: through bytes, on links that fail."""

import itertools
import os
import signal
import subprocess
import sys
import time
import tomllib
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from instrument import LinkError, RateTable, SettingError, WrongInstrument
from instrument.controllers import Controller, ControllerTemplate, parse_template
from instrument.rate_table import ControlledRateTable
from instrument.simulated import SimulatedRateTable, VirtualClock
from instrument.simulated.controllers import (
    LineServer,
    RateTableController,
    SimulatedChamber,
    SimulatedPowerSupply,
)

SHIPPED = Path(__file__).parents[3] / "config" / "controllers"
needs_ptys = pytest.mark.skipif(os.name != "posix", reason="needs pseudo-terminals")


def values(name: str, **sections: dict[str, Any]) -> dict[str, Any]:
    """A shipped template with sections changed; answers are waited for shortly."""
    found = tomllib.loads((SHIPPED / f"{name}.toml").read_text())
    for section, changes in {"link": {"answer_s": 0.3, "reconnect_s": 2.0}, **sections}.items():
        found[section] = found.get(section, {}) | changes
    return found


def template(name: str, **sections: dict[str, Any]) -> ControllerTemplate:
    return parse_template(values(name, **sections), name)


class Turned:
    """A simulated table behind its controller and a link, on a virtual clock."""

    def __init__(self, *, tcp: bool = True, **sections: dict[str, Any]) -> None:
        self.clock = VirtualClock()
        self.table = SimulatedRateTable(self.clock, acceleration=50.0)
        self.device = RateTableController(self.table)
        self.server = LineServer(self.device, tcp_port=0 if tcp else None)
        self.told: list[str] = []
        self.template = template("rate_table", **sections)

    def open(self) -> ControlledRateTable:
        clock = {"sleep": self.clock.sleep, "now": self.clock.now}
        controller = Controller(self.server.resource_name, self.template, tell=self.told.append, **clock)
        return ControlledRateTable(controller, tell=self.told.append, now=self.clock.now)


@pytest.mark.parametrize("tcp", [True, pytest.param(False, marks=needs_ptys)])
def test_a_table_is_turned_read_and_stopped_through_bytes(tcp: bool) -> None:
    turned = Turned(tcp=tcp)
    with turned.server:
        table: RateTable = turned.open()
        table.set_rate(-20.0)
        assert table.rate() == -20.0
        # 0.4 s to come to the rate, 4 deg; then steady for 0.5 s, seen at looks every 0.1 s
        assert turned.clock.now() == pytest.approx(0.9, abs=0.21)
        assert table.azimuth() % 360 == pytest.approx(turned.table.azimuth() % 360, abs=1e-3)
        table.close()
        assert turned.table.rate_at(turned.table.motion[-1].start) == 0.0
        assert turned.device.lines == ["ENABLE", "RATE -20.000000", "STOP"]


def test_the_azimuth_does_not_jump_where_the_display_begins_anew() -> None:
    turned = Turned()
    with turned.server:
        table = turned.open()
        table.set_rate(20.0)
        seen = []
        for _ in range(60):
            turned.clock.sleep(0.7)
            seen.append(table.azimuth())
        steps = [after - before for before, after in itertools.pairwise(seen)]
        assert steps == pytest.approx([14.0] * 59, abs=1e-3)
        table.close()


def test_units_and_sense_of_the_controller_are_those_of_the_template() -> None:
    hourly = {"per_dps": -3600.0, "lowest_dps": -0.1, "highest_dps": 0.1}
    turned = Turned(rate=hourly)
    with turned.server, closing(turned.open()) as table:
        table.set_rate(0.01)
        assert "RATE -36.000000" in turned.device.lines
        assert turned.table.motion[-1].rate_dps == -36.0
        assert table.rate() == pytest.approx(0.01)
        with pytest.raises(SettingError, match=r"0\.2 dps is beyond its limits, -0\.1 to 0\.1"):
            table.set_rate(0.2)
        assert len([line for line in turned.device.lines if line.startswith("RATE")]) == 1


def test_a_table_that_refuses_or_does_not_come_to_its_rate_is_an_error() -> None:
    turned = Turned(rate={"highest_dps": 5000.0})
    refused = r"refuses 'RATE 2000\.000000': ERR the rate table turns at most"
    with turned.server, closing(turned.open()) as table, pytest.raises(SettingError, match=refused):
        table.set_rate(2000.0)
    stuck = Turned(rate={"per_dps": 1.0, "answer": r"^RATE ([-+.0-9eE]+)$"})
    stuck.table.set_rate = lambda rate_dps: None  # type: ignore[method-assign]  # the drive hums and does not turn
    reads = "was to be 5 dps and reads 0 after"
    with stuck.server, closing(stuck.open()) as table, pytest.raises(SettingError, match=reads):
        table.set_rate(5.0)


class Spoiled:
    """A device whose answers to some lines are lost (None) or damaged, once each."""

    def __init__(self, device: RateTableController, damage: dict[str, list[str | None]]) -> None:
        self._device, self._damage = device, damage

    def answer(self, line: str) -> str | None:
        answer = self._device.answer(line)
        left = self._damage.get(line)
        return left.pop(0) if left else answer


def test_answers_that_are_lost_or_damaged_are_asked_for_again() -> None:
    clock = VirtualClock()
    simulated = SimulatedRateTable(clock)
    damage: dict[str, list[str | None]] = {
        "RATE 5.000000": [None],
        "RATE?": ["R#TE 5.00", "RATE -"],
        "STOP": ["?"],
    }
    device = Spoiled(RateTableController(simulated), damage)
    with LineServer(device, tcp_port=0) as server:
        controller = Controller(server.resource_name, template("rate_table"), sleep=clock.sleep, now=clock.now)
        table = ControlledRateTable(controller)
        table.set_rate(5.0)
        assert table.rate() == 5.0
        table.close()
    assert controller.repeated == 4
    assert simulated.motion[-1].rate_dps == 0.0


def test_a_lost_link_is_opened_again_and_one_that_stays_lost_is_told_loudly() -> None:
    turned = Turned(link={"answer_s": 0.3, "reconnect_s": 10.0})
    port = int(turned.server.resource_name.split("::")[2])
    with turned.server:
        table = turned.open()
        table.set_rate(5.0)
    with LineServer(turned.device, tcp_port=port):
        assert table.rate() == 5.0
        assert "is there again" in turned.told[-1]
        table.close()
    gone = Turned(link={"answer_s": 0.2, "reconnect_s": 0.2, "attempts": 1})
    with gone.server:
        table = gone.open()
        table.set_rate(5.0)
    table.close()
    assert "THE RATE TABLE MAY STILL TURN" in gone.told[-1]


def test_another_instrument_is_refused() -> None:
    server = LineServer(SimulatedChamber(), tcp_port=0)
    with server, pytest.raises(WrongInstrument, match="something else answers there: 'NA:CMDERR"):
        Controller(server.resource_name, template("rate_table"))
    with pytest.raises(LinkError, match=r"cannot be opened|refused"):
        Controller("TCPIP0::127.0.0.1::1::SOCKET", template("rate_table"))


KILLED = """
import sys, tomllib, time
from instrument.rate_table import *
from instrument.controllers import *
values = tomllib.load(open(sys.argv[2], "rb"))
controller = Controller(sys.argv[1], parse_template(values, "x"))
table = ControlledRateTable(controller, Guard(sys.argv[1], values))
table.set_rate(5.0)
print("turns", flush=True)
time.sleep(60)
"""


@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_the_guard_stops_the_table_of_a_program_that_is_killed(tmp_path: Path) -> None:
    table = SimulatedRateTable()
    device = RateTableController(table)
    with LineServer(device, tcp_port=0) as server:
        command = [sys.executable, "-c", KILLED, server.resource_name, str(SHIPPED / "rate_table.toml")]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "turns\n"
            assert table.motion[-1].rate_dps == 5.0
            process.send_signal(signal.SIGKILL)
        deadline = time.monotonic() + 60
        while "STOP" not in device.lines and time.monotonic() < deadline:
            time.sleep(0.05)
    assert table.motion[-1].rate_dps == 0.0


def test_a_supply_and_a_chamber_by_the_shipped_templates() -> None:
    supply = SimulatedPowerSupply()
    with LineServer(supply, tcp_port=0, end="\n") as server:
        with Controller(server.resource_name, template("power_supply")) as controller:
            controller.do("on")
            assert controller.set("voltage", 24.0) == 24.0
            assert controller.readings() == {"voltage_v": 24.0, "current_a": 0.5}
            assert "SIM-2" in controller.identity
        assert supply.on  # it is left as it is
    clock = VirtualClock()
    chamber = SimulatedChamber(clock, speed_degc_per_s=0.05)
    with (
        LineServer(chamber, tcp_port=0) as server,
        Controller(server.resource_name, template("chamber"), sleep=clock.sleep, now=clock.now) as controller,
    ):
        controller.do("on")
        assert controller.set("temperature", 40.0) == pytest.approx(40.0, abs=0.5)
        # 17 K at 0.05 K/s, within 0.5 K after 330 s; steady for 300 s, with a look every 10 s
        assert clock.now() == pytest.approx(330 + 300, abs=21)
        controller.do("off")
        assert not chamber.on


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rate": {"set": ["RATE"]}}, "place for the number"),
        ({"rate": {"answer": "RATE"}}, "group in round brackets"),
        ({"rate": {"answer": "("}}, "no regular expression"),
        ({"rate": {"lowest_dps": 5.0, "highest_dps": 1.0}}, "lowest value must lie below"),
        ({"rate": {"lowest": 5.0}}, "rate.lowest"),
        ({"link": {"parity": "mark"}}, "link.parity"),
    ],
)
def test_mistakes_of_a_template_are_told(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(SettingError, match=said):
        template("rate_table", **changes)


def test_a_template_without_what_its_kind_needs() -> None:
    with pytest.raises(SettingError, match=r"a chamber needs a section \[temperature\]"):
        parse_template({"kind": "chamber", "name": "x"}, "x.toml")
