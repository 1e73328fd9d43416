"""Numbers and sentences of a dead band."""

from dataclasses import replace

import numpy as np
import pytest

from analysis import find_dead_band, simulate_sweep
from station.dead_band.measurement import DeadBandEvaluation, draw_sweep, result, sections
from station.shell.finish import evaluate_run
from tests.station.dead_band.conftest import Sweep


def test_a_corner_rounded_by_noise_is_told(sweep: Sweep) -> None:
    up = np.arange(0, 0.1, 0.0025)
    rates = np.concatenate([up, up[::-1], -up[1:], -up[::-1]])
    pulses = simulate_sweep(rates, 2.0, scale_factor=2000, lock_in_rate=0.0512, random_walk=3e-4, seed=1)
    band = find_dead_band(rates, pulses, 2.0, scale_factor=2000)
    evaluated = evaluate_run(sweep())
    found: DeadBandEvaluation = replace(evaluated.found, band=band)
    said = result(found, evaluated.run, evaluated.settings)
    assert "rounded" in said.flags
    assert any("whole corner" in sentence for sentence in said.to_watch)
    assert said.document["corner"]["random_walk_deg_per_sqrt_s"] > 0
    # without rounding the fit's random walk means nothing
    assert evaluated.result.document["corner"]["random_walk_deg_per_sqrt_s"] is None


@pytest.mark.slow
def test_records_too_short_for_the_band_are_told(sweep: Sweep) -> None:
    """Of a gyro with 20 pulses a degree the slowest beat that is seen stands for 0.1 deg/s, ten lock-in rates."""
    evaluated = evaluate_run(sweep(), choices={"scale_factor": 20.0})
    assert any("too short for this band" in sentence for sentence in evaluated.result.to_watch)
    assert evaluated.document()["lock_in_rate_u_dps"] > 0.005


def test_a_hyperbola_that_disagrees_is_told(sweep: Sweep) -> None:
    evaluated = evaluate_run(sweep())
    assert evaluated.found.hyperbola is not None
    other = replace(evaluated.found, hyperbola=replace(evaluated.found.hyperbola, lock_in_rate=0.02))
    said = result(other, evaluated.run, evaluated.settings)
    assert "hyperbola_disagrees" in said.flags
    none = result(replace(evaluated.found, hyperbola=None), evaluated.run, evaluated.settings)
    assert "no_hyperbola" in none.flags


@pytest.mark.slow
def test_labels_of_the_figure_do_not_overlap(sweep: Sweep) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    draw_sweep(evaluate_run(sweep()).found, figure)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    axes = figure.axes[0]
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["dead band", "no lock-in", "fitted hyperbola", "up", "down"]
    boxes = [axes.get_legend().get_window_extent(), axes.get_window_extent(), axes.xaxis.label.get_window_extent()]
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


@pytest.mark.slow
def test_the_report_shows_every_record(sweep: Sweep) -> None:
    evaluated = evaluate_run(sweep())
    *_, rates = sections(evaluated.found, evaluated.run, evaluated.settings, evaluated.result)
    assert rates.table is not None
    assert len(rates.table.rows) == 25
    assert {"locked"} < {row[3] for row in rates.table.rows}
