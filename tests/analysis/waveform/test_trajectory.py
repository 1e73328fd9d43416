"""The fit of phases and parameters together: near the minimum one step is enough, whoever has eliminated what."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.waveform.trajectory import SampledRecord, Terms, Trajectory


@pytest.mark.parametrize(("terms", "looseness"), [(3, 1e-4), (3, 1e-8), (40, 1e-6)])
def test_one_step_from_beside_the_minimum_reaches_it(terms: int, looseness: float) -> None:
    rng, time = np.random.default_rng(terms), np.arange(1000)
    phase = 0.06 * time + 0.3 * np.sin(0.005 * time)
    values = 0.4 * np.sin(phase + 0.1 * np.sin(phase)) + rng.normal(0.0, 3e-3, time.size)
    record = SampledRecord(values, (rng.uniform(size=time.size) > 0.05).astype(float))
    parameters = np.concatenate([[0.06], np.zeros(terms - 1), [0.004, 0.002], [0.4], [0.0]])
    start = Trajectory(phase, parameters, Terms(terms, 1, 1))
    best = record.fit(start, looseness, 60)
    assert best.converged
    beside = replace(
        best.trajectory,
        phase=best.trajectory.phase + 1e-3 * np.cos(0.01 * time),
        parameters=best.trajectory.parameters * (1 + rng.normal(0.0, 3e-4, parameters.size)),
    )
    lost = record.fit(beside, looseness, 1).cost / best.cost - 1
    assert abs(lost) < 1e-4
