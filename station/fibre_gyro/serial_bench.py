"""The real bench of a fibre gyro: its serial link, and a rate table that an operator turns."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from instrument import InstrumentError, ManualRateTable, RateTable
from instrument.fibre_gyro import FibreGyroLink, Recording
from station.controllers.open import open_rate_table, open_surroundings
from station.fibre_gyro.segments import FogBench, PlannedSegment
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.sniff.known import read_frame_format
from station.runs.operator import ask_operator
from station.terminal.lines import remark

Ask = Callable[[str], str]


class SerialFogBench:
    """A gyro on a serial link, and a table."""

    _BY_HAND = ("axis", "end_up", "run", "temperature_c", "by_hand")

    def __init__(
        self,
        link: FibreGyroLink,
        table: RateTable,
        ask: Ask,
        surroundings: Callable[[], dict[str, float]] = dict,
        counts_per_dps: float | None = None,
    ) -> None:
        self._link, self._table, self._ask, self._surroundings = link, table, ask, surroundings
        self._counts_per_dps = counts_per_dps
        self._by_hand: tuple[Any, ...] = ()
        self._rate = 0.0
        self._step = 0.0
        self._held = False

    def refuses(self, planned: PlannedSegment) -> str:
        """Axes that the frames do not hold, steps beyond what they can express, commands that are not there."""
        layout, wanted = self._link.layout, planned.conditions
        try:
            layout.output_of(str(wanted.get("axis") or ""))
        except InstrumentError as error:
            return str(error)
        if "loop" in wanted and "hold_feedback" not in layout.commands:
            return "the frame format of this gyro has no command hold_feedback"
        step = float(wanted.get("step_codes", 0.0))
        lowest, highest = layout.step_range
        if not lowest <= step <= highest:
            return (
                f"a step of {step:+.6g} codes cannot be injected, the gyro takes {lowest:g} to {highest:g}: "
                "choose a smaller rate"
            )
        return ""

    def prepare(self, planned: PlannedSegment) -> dict[str, Any]:
        """Turn, inject, hold the feedback; return the rate and the step that were reached."""
        wanted = planned.conditions
        self._set_by_hand(wanted)
        reached: dict[str, Any] = {}
        rate = float(wanted["rate_dps"])
        if rate != self._rate:
            self._table.set_rate(rate)
            self._rate = rate
        if rate:
            reached["table_rate_dps"] = self._table.rate()
        self._set_loop(wanted.get("loop") == "held")
        if "step_codes" in wanted:
            reached |= self._inject(float(wanted["step_codes"]), wanted)
        if not self._link.acknowledges and ("step_codes" in wanted or "loop" in wanted):
            reached["acknowledged"] = False
        if self._link.layout.unit != "counts":
            reached["output_unit"] = self._link.layout.unit
        return reached | self._surroundings()

    def record(self, planned: PlannedSegment, progress: Callable[[float], None]) -> Recording:
        """Record from the link; where frames hold several outputs, that of the segment's axis."""
        return self._link.record(
            planned.seconds,
            skip_s=planned.settle_s,
            progress=progress,
            axis=str(planned.conditions.get("axis") or ""),
            counts_per_dps=self._counts_per_dps,
        )

    def leave(self) -> None:
        """Take the injection away, close the loop and stop the table; never raises."""
        for undo in (self._stop_injecting, lambda: self._set_loop(False), self._stop_turning):
            with suppress(InstrumentError, OSError):
                undo()

    def _set_by_hand(self, wanted: Any) -> None:
        now = tuple(wanted.get(name) for name in self._BY_HAND)
        if now == self._by_hand or now == (None,) * len(now):
            return
        self._by_hand = now
        axis, end_up, run, temperature, also = now
        asked = [f"Bring axis {axis} of the gyro to the table's axis, {'up' if end_up != -1 else 'upside down'}."]
        if run is not None:
            asked.append(f"For {run}: switch the gyro off, let it take {temperature:g} deg C, switch it on.")
        if also is not None:
            asked.append(str(also))
        self._ask("\n".join([*asked, "Press Enter when done: "]))

    def _set_loop(self, held: bool) -> None:
        if held != self._held:
            if held:
                self._link.hold_feedback()
            else:
                self._link.close_loop()
            self._held = held

    def _inject(self, step: float, wanted: Any) -> dict[str, float]:
        """Inject a step; the number that was really sent replaces the one that was wanted."""
        sent = self._link.inject(step) if step or self._step else 0.0
        self._step = sent
        reached = {"step_codes": sent}
        if step and "number" in wanted:
            reached["number"] = float(wanted["number"]) * sent / step
        return reached

    def _stop_injecting(self) -> None:
        if self._step:
            self._link.inject(0.0)

    def _stop_turning(self) -> None:
        if self._rate:
            self._table.close()


@contextmanager
def _table(settings: FogSettings, tell: Callable[[str], None]) -> Iterator[RateTable]:
    named = None if settings.controllers is None else settings.controllers.rate_table
    if settings.table.kind == "controller" and named is not None:
        with open_rate_table(named, tell=tell) as table:
            yield table
    else:
        yield ManualRateTable(ask=ask_operator)


@contextmanager
def open_fog_bench(settings: FogSettings, tell: Callable[[str], None] = remark) -> Iterator[FogBench]:
    """Open the bench that the settings describe; afterwards the injection is off and the loop is closed."""
    if settings.simulated:
        from station.fibre_gyro.simulated_bench import SimulatedFogBench

        yield SimulatedFogBench(settings)
        return
    layout = read_frame_format(settings)
    with (
        FibreGyroLink(settings.link.port, layout, speed=settings.link.speed) as link,
        open_surroundings(settings.controllers, tell=tell) as surroundings,
        _table(settings, tell) as table,
    ):
        bench = SerialFogBench(link, table, ask_operator, surroundings, settings.nominal_scale_factor)
        try:
            yield bench
        finally:
            bench.leave()
