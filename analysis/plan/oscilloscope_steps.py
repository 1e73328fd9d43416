"""Which of an oscilloscope's steps suit a beat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class OscilloscopeSteps:
    """What the knobs of an oscilloscope allow.

    Attributes
    ----------
    time_bases : sequence of float
        s/div, ascending.
    vertical_scales : sequence of float
        V/div at the input, ascending.
    samples, divisions, levels_per_division : int
        Of a record: its samples, its horizontal divisions, the converter's levels per vertical division.
    """

    time_bases: Sequence[float]
    vertical_scales: Sequence[float]
    samples: int = 2500
    divisions: int = 10
    levels_per_division: int = 25

    def time_base(self, frequency: float, periods_min: float, samples_per_period_min: float) -> float:
        """The fastest step that holds so many periods of the beat, s/div.

        Where that would leave too few samples in a period it is the slowest step that leaves enough.
        """
        slowest = self.samples / (self.divisions * frequency * samples_per_period_min)
        sampled = [base for base in self.time_bases if base <= slowest * (1 + 1e-9)] or [self.time_bases[0]]
        enough = periods_min / (self.divisions * frequency)
        return next((base for base in sampled if base >= enough * (1 - 1e-9)), sampled[-1])

    def vertical_scale(self, amplitude: float, levels: float) -> float:
        """The most sensitive step, V/div, on which an amplitude in V stays within so many levels of the middle."""
        wanted = amplitude * self.levels_per_division / levels
        found = next((scale for scale in self.vertical_scales if scale >= wanted * (1 - 1e-9)), None)
        if found is None:
            highest = self.vertical_scales[-1] * levels / self.levels_per_division
            raise ValueError(
                f"an amplitude of {amplitude:g} V does not fit on the screen, which takes {highest:g} V at most: "
                "use a probe that divides"
            )
        return found
