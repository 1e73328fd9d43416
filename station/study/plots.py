"""The paper's figures as figures, with the exact method beside its own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from analysis.arrays import Floats
from analysis.study import PAPER, BiasTable, Causes, ErrorStudy, ExperimentCauses, WaveformStudy
from station.report.figure import ACCENT, INK, SECOND, SOFT, THIRD, legend_above, write_picture
from station.study.study import CAUSE_NAMES, WINDOW_NAMES, Study, axis_name, curve_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_COLOURS = (ACCENT, SECOND, THIRD, SOFT)
_SHOWN_S = 2.0e-3
_SHOWN_HZ = 10_000.0
_FLOOR_PERCENT = 1e-3


def write_study_plots(folder: Path, study: Study, kind: str) -> list[Path]:
    """Draw everything that was computed, one file each."""
    written = []

    def write(name: str, size: tuple[float, float], draw: Callable[[Figure], None]) -> None:
        path = folder / f"{name}.{kind}"
        write_picture(path, name, size, draw)
        written.append(path)

    for number, wave in study.waveforms.items():
        write(f"figure{number}", (10.0, 3.4), lambda figure, wave=wave: _draw_waveform(figure, wave))  # type: ignore[misc]
    for number, errors in study.errors.items():
        write(
            f"figure{number}",
            (11.0, 4.2),
            lambda figure, number=number, errors=errors: _draw_errors(figure, number, errors),  # type: ignore[misc]
        )
    if (bias := study.bias) is not None:
        write("bias", (7.0, 4.0), lambda figure: _draw_bias(figure, bias))
    if (causes := study.causes) is not None:
        write("causes", (10.0, 4.6), lambda figure: _draw_causes(figure, causes))
    if (experiment := study.experiment) is not None:
        write("experiment", (10.0, 4.8), lambda figure: _draw_experiment(figure, experiment))
    return written


def _draw_waveform(figure: Figure, wave: WaveformStudy) -> None:
    left, right = figure.subplots(1, 2)
    shown = wave.times <= _SHOWN_S
    left.plot(1e3 * wave.times[shown], wave.volts[shown], ".-", color=ACCENT, ms=4)
    left.set(xlabel="time, ms", ylabel="signal, amplitude 1", xlim=(0, 1e3 * _SHOWN_S))
    inside = (wave.frequencies <= _SHOWN_HZ) & (wave.frequencies > 0)
    level = 20 * np.log10(np.maximum(wave.amplitudes[inside], 1e-12))
    right.plot(wave.frequencies[inside] / 1e3, level, color=ACCENT, linewidth=0.7, label="spectrum, no window")
    orders = np.arange(1, wave.exact.size + 1)
    places = orders * wave.beat_frequency / 1e3
    right.plot(places, 20 * np.log10(wave.exact), "o", ms=6, mfc="none", color=SECOND, label="exact")
    right.plot(places, 20 * np.log10(wave.fitted), "+", ms=8, color=INK, label="least squares")
    right.set(xlabel="frequency, kHz", ylabel="amplitude, dB", xlim=(0, _SHOWN_HZ / 1e3), ylim=(-110, 8))
    legend_above(right)


def _draw_errors(figure: Figure, number: int, errors: ErrorStudy) -> None:
    panels = {name: errors.by_peaks[name] for name in ("boxcar", "hann", "flattop")}
    titles = [f"peaks ({WINDOW_NAMES[name]}), equation (13)" for name in panels]
    every: list[Axes] = list(figure.subplots(1, 4, sharey=True))
    for axes, title, found in zip(
        every, [*titles, "equation (13) alone"], [*panels.values(), errors.formula], strict=True
    ):
        for place, values in enumerate(found):
            name = curve_name(errors.curves[place])
            axes.plot(errors.axis, 100 * np.abs(values), color=_COLOURS[place % 4], label=name)
        axes.set_title(title, fontsize=9.5, color=INK)
        axes.set(yscale="log", xlabel=axis_name(number), xlim=(float(errors.axis[0]), float(errors.axis[-1])))
        axes.set_ylim(_FLOOR_PERCENT, 100)
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    every[0].set_ylabel("size of the relative error, %")
    ours = 100 * float(np.abs(errors.ours).max())
    every[-1].text(
        0.5, 0.94, f"ours: below {_up(ours)} %", transform=every[-1].transAxes, ha="center", va="top", color=INK
    )
    handles, labels = every[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=4, fontsize=9)


def _draw_bias(figure: Figure, bias: BiasTable) -> None:
    axes = figure.add_subplot()
    axes.plot(bias.rate_ratio, 100 * bias.formula_10, "o-", ms=4, color=SECOND, label="equation (10)")
    axes.plot(bias.rate_ratio, 100 * bias.formula_13, "o-", ms=4, color=ACCENT, label="equation (13)")
    axes.axhline(0, color=INK, linewidth=1.6, label=f"exact relation: below {_up(100 * float(bias.ours.max()))} %")
    axes.set(xlabel="lock-in rate over input rate, x = WL/W", ylabel="error of the lock-in rate, %", xlim=(0, 1))
    axes.set_ylim(-20, 70)
    legend_above(axes)


def _draw_causes(figure: Figure, causes: Causes) -> None:
    """Bars of the causes for each gyro, spectrum without a window."""
    axes = figure.add_subplot()
    series = (
        ("together", causes.together["boxcar"], INK),
        ("peak reading", causes.peak["boxcar"], ACCENT),
        ("leakage", causes.leakage["boxcar"], THIRD),
        ("equation (13)", causes.formula, SECOND),
        ("solver: Euler, 20 kHz", causes.euler, SOFT),
        ("ours, 2500 points of 8 bits", causes.rounding, "#9db4cc"),
    )
    places = np.arange(len(causes.points))
    width = 0.8 / len(series)
    for index, (name, values, color) in enumerate(series):
        axes.bar(
            places + (index - (len(series) - 1) / 2) * width, _size_percent(values), width, color=color, label=name
        )
    axes.set(yscale="log", ylim=(_FLOOR_PERCENT, 200), ylabel="size of the relative error, %")
    axes.set_xticks(places, [f"W = {w:g}\nWL = {wl:g}\nx{w / wl:.2g}" for w, wl in causes.points])
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.grid(visible=False, axis="x")
    axes.text(0.995, 0.97, "spectrum without a window", transform=axes.transAxes, ha="right", va="top", color=SOFT)
    legend_above(axes, columns=6)


def _draw_experiment(figure: Figure, experiment: ExperimentCauses) -> None:
    """Bars of each cause at each rate, rms, beside the paper's 6.8 %."""
    axes = figure.add_subplot()
    every = (*experiment.causes, experiment.ours)
    places, width = np.arange(len(every)), 0.8 / len(experiment.over_lock_in)
    for index, over in enumerate(experiment.over_lock_in):
        values = np.array([cause.rms[index] for cause in every])
        shift = (index - (len(experiment.over_lock_in) - 1) / 2) * width
        colour = (SECOND, THIRD, SOFT, ACCENT)[index % 4]
        axes.bar(places + shift, 100 * values, width, color=colour, label=f"{over:g} lock-in rates")
    axes.axhline(
        100 * PAPER, color=INK, linestyle=(0, (5, 3)), linewidth=1.1, label="the paper's experiment, 6.8 %"
    )
    axes.set(yscale="log", ylim=(0.02, 60), ylabel="rms error of the lock-in rate, %")
    names = [CAUSE_NAMES[cause.name] for cause in every]
    broken = (", ", ",\n"), ("distortion ", "distortion\n"), ("noise 1 % ", "noise 1 %\n")
    for before, after in broken:
        names = [name.replace(before, after) for name in names]
    axes.set_xticks(places, names)
    axes.tick_params(axis="x", labelsize=8)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.grid(visible=False, axis="x")
    legend_above(axes, columns=5)


def _size_percent(values: Floats) -> Floats:
    return np.asarray(np.maximum(100 * np.abs(values), _FLOOR_PERCENT * 1.0001))


def _up(value: float) -> str:
    """Round up to a power of ten."""
    return f"1e{int(np.ceil(np.log10(max(value, 1e-15)))):d}"
