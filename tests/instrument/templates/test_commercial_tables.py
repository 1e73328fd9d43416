"""Templates of commercial rate tables, against fakes that speak as published programs for them expect it."""

import os
import re
import tomllib
from pathlib import Path

import pytest

from instrument import LinkError, SettingError
from instrument.controllers import Controller, parse_template
from instrument.rate_table import ControlledRateTable
from instrument.simulated import SimulatedRateTable, VirtualClock
from instrument.simulated.controllers import LineServer

SHIPPED = Path(__file__).parents[3] / "config" / "controllers"
needs_ptys = pytest.mark.skipif(os.name != "posix", reason="needs pseudo-terminals")


class Acutrol:
    """Answers as an ACUTROL 3000 with one axis: words of any length from one letter on, the axis first."""

    def __init__(self, table: SimulatedRateTable, before_numbers: str = "") -> None:
        self.table, self._before = table, before_numbers
        self.mode, self.closed, self.fault = "Off", False, True
        self.orders: list[str] = []

    def answer(self, line: str) -> str | None:
        if line == "*IDN?":
            return "ACUTRONIC,ACUTROL3000,0,2.01"
        found = re.fullmatch(r":(\w+)(?::(\w+))?(\?)?(?: 1(?:,(\S+))?)?", line)
        assert found is not None, line
        first, second, asked, value = (word or "" for word in found.groups())
        family = next(word for word in ("interlock", "mode", "demand", "read") if word.startswith(first))
        if asked:
            return self._read(family, second)
        self.orders.append(line)
        match family, second:
            case "interlock", "reset":
                self.fault = False
            case "interlock", "close" | "open":
                self.closed = second == "close" and not self.fault
            case "mode", _:
                self.mode = second.capitalize()
            case "demand", "rate" if self.closed and self.mode == "Rate":
                self.table.set_rate(float(value))
            case _:
                raise AssertionError(line)
        return None

    def _read(self, family: str, what: str) -> str:
        if family == "interlock":
            return "Fault" if self.fault else "Closed"
        number = self.table.rate() if what == "rate" else self.table.azimuth() % 360
        return f"{self._before}{number:.6f}"


class Aerosmith:
    """Answers as an Ideal Aerosmith table: an echo, perhaps a value, the prompt; a positive rate is clockwise."""

    def __init__(self, table: SimulatedRateTable) -> None:
        self.table, self.on = table, False
        self.orders: list[str] = []

    def answer(self, line: str) -> str:
        if line == "PPO":
            return f"PPO\r\n{-self.table.azimuth() % 360:.4f}\r\n"
        self.orders.append(line)
        if line in ("SRV1", "SRV0"):
            self.on = line == "SRV1"
        elif line == "STO":
            self.table.set_rate(0.0)
        elif line.startswith("JOG") and self.on and abs(float(line[3:])) <= 300:
            self.table.set_rate(-float(line[3:]))
        else:
            return f"{line}\r\n?\r\n"
        return f"{line}\r\n"


class Turned:
    """A fake of a table behind its template, on a virtual clock."""

    def __init__(self, kind: type[Acutrol | Aerosmith], name: str, *, tcp: bool, end: str, **more: str) -> None:
        self.clock = VirtualClock()
        self.device = kind(SimulatedRateTable(self.clock, acceleration=20.0), **more)
        self.server = LineServer(self.device, tcp_port=0 if tcp else None, end=end)
        values = tomllib.loads((SHIPPED / f"{name}.toml").read_text(encoding="utf-8"))
        values["link"] |= {"answer_s": 0.3, "reconnect_s": 1.0, "pause_s": 0.0, "attempts": 2}
        self.template = parse_template(values, name)

    def open(self) -> ControlledRateTable:
        clock = {"sleep": self.clock.sleep, "now": self.clock.now}
        controller = Controller(self.server.resource_name, self.template, **clock)
        return ControlledRateTable(controller, now=self.clock.now)


@pytest.mark.parametrize(("tcp", "before"), [(True, "00000000"), pytest.param(False, "", marks=needs_ptys)])
def test_acutrol(tcp: bool, before: str) -> None:
    """Behind a socket it writes eight characters before a number, as one published program cuts them off."""
    turned = Turned(Acutrol, "acutrol", tcp=tcp, end="\n", before_numbers=f"{before} " if before else "")
    with turned.server:
        table = turned.open()
        assert table.controller.identity == "ACUTRONIC,ACUTROL3000,0,2.01"
        table.set_rate(-12.5)
        assert table.rate() == pytest.approx(-12.5, abs=1e-6)
        assert table.azimuth() % 360 == pytest.approx(turned.device.table.azimuth() % 360, abs=1e-3)
        turned.device.fault = True
        with pytest.raises(SettingError, match=r"reports an error after ':demand:rate 1,3\.000000': Fault"):
            table.set_rate(3.0)
        turned.device.fault = False
        table.close()
    assert turned.device.table.motion[-1].rate_dps == 0.0
    assert turned.device.orders[:2] == [":interlock:reset", ":mode:off 1"]
    assert turned.device.orders[-2:] == [":mode:rate 1", ":demand:rate 1,0"]


@needs_ptys
def test_ideal_aerosmith() -> None:
    turned = Turned(Aerosmith, "ideal_aerosmith", tcp=False, end=">")
    with turned.server:
        table = turned.open()
        table.set_rate(40.0)
        assert turned.device.orders == ["SRV1", "JOG-40.0000"]
        motion = turned.device.table.motion[-1]
        assert (motion.rate_dps, table.rate()) == (40.0, 40.0)
        # it cannot be asked for its rate: 80 deg/s of change at 10 deg/s^2 are waited for, and 2 s
        before = turned.clock.now()
        table.set_rate(-40.0)
        assert turned.clock.now() - before == pytest.approx(10.0, abs=0.01)
        assert table.azimuth() % 360 == pytest.approx(turned.device.table.azimuth() % 360, abs=1e-3)
        with pytest.raises(SettingError, match=r"refuses 'JOG-350\.0000'"):
            table.set_rate(350.0)
        table.close()
        assert turned.device.orders[-1] == "STO"
    with pytest.raises(LinkError):
        turned.open()
