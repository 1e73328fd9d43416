"""The fit of phases and parameters together: near the minimum one step is enough, whoever has eliminated what."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from analysis.waveform.trajectory import SampledRecord, Terms, Trajectory, polynomials


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


@pytest.mark.parametrize("seed", range(16))
def test_the_phases_are_eliminated_as_a_dense_solution_does_it(seed: int) -> None:
    """Gaps, locked gyros, loose and tight; the reference takes everything at once, by QR."""
    rng = np.random.default_rng(seed)
    count, terms = int(rng.integers(120, 200)), Terms(int(rng.integers(1, 9)), 2, 3)
    parameters = 0.01 * rng.normal(size=terms.count)
    parameters[0], parameters[terms.rate + 2] = rng.uniform(0.2, 0.9), rng.uniform(1, 100)
    parameters[terms.rate : terms.rate + 2] = parameters[0] * rng.uniform(-1, 1, 2)
    phase, mask = np.cumsum(rng.uniform(0.5, 1.5, count) * parameters[0]), np.ones(count)
    mask[10 * (seed % 2) : int(rng.integers(25, 45))] = 0.0
    amplitude, looseness = parameters[terms.rate + 2], 10.0 ** rng.uniform(-7, 0) / parameters[terms.rate + 2] ** 2
    record = SampledRecord(amplitude * np.sin(phase) + rng.normal(size=count), mask)
    before = record.fit(Trajectory(phase, parameters, terms), looseness, 1)
    model, steps, n_rate = before.model, before.model.steps, terms.rate
    moved = np.zeros((terms.count, count - 1))
    moved[:n_rate] = polynomials(count).means[:n_rate] * steps.by_rate
    moved[n_rate : n_rate + 2] = steps.by_sine, steps.by_cosine
    chain = np.eye(count)[1:] - steps.by_phase[:, np.newaxis] * np.eye(count)[:-1]
    of_phases = np.concatenate([np.diag(model.by_phase), chain / np.sqrt(looseness)])
    of_samples = np.concatenate([np.zeros((n_rate + 2, count)), model.by_sample])
    of_parameters = np.concatenate([of_samples.T, -moved.T / np.sqrt(looseness)])
    basis, upper = np.linalg.qr(of_phases)
    rest = of_parameters - basis @ (basis.T @ of_parameters)
    after = record.fit(before, looseness, 1)
    scale = np.sqrt(np.diagonal(after.normal))
    assert np.allclose(after.normal / np.outer(scale, scale), rest.T @ rest / np.outer(scale, scale), atol=1e-6)
    volume = 2 * np.log(np.abs(np.diagonal(upper))).sum() + np.linalg.slogdet(rest.T @ rest)[1]
    evidence = volume + (count - 1) * np.log(looseness) + after.degrees * np.log(after.cost)
    assert after.evidence == pytest.approx(evidence, abs=1e-3)


def beat_of_a_record(rng: np.random.Generator, n_samples: int, phase_step: float) -> np.ndarray:
    """A beat near lock-in by the integrator of SciPy, which shares nothing with the fit."""
    time = np.arange(n_samples, dtype=float)
    rate, s, c = phase_step, 0.5 * phase_step, 0.3 * phase_step
    phase = solve_ivp(
        lambda _, y: rate - s * np.sin(y) + c * np.cos(y),
        (0, n_samples),
        [rng.uniform(0, 6)],
        t_eval=time,
        rtol=1e-9,
        atol=1e-9,
    ).y[0]
    return np.stack([phase, 0.4 * np.sin(phase)])


@pytest.mark.parametrize("of", [2, 5])
def test_means_of_samples_tell_the_pull_that_the_samples_tell(of: int) -> None:
    """Where a turn has ten means; a mean is not what its middle is."""
    rng, step = np.random.default_rng(of), 2 * np.pi / 10 / of
    phase, clean = beat_of_a_record(rng, 2500, step)
    values, terms = clean + rng.normal(0.0, 1e-3, clean.size), Terms(1, 1, 1)
    parameters = np.array([step * of, 0.45 * step * of, 0.35 * step * of, 0.4, 0.0])
    record = SampledRecord(values, np.ones(values.size), of)
    start = Trajectory(phase.reshape(-1, of).mean(axis=1), parameters, terms)
    fitted = record.fit(record.fit(start, 1e-2, 30), 1e-8, 60)
    off = fitted.trajectory.parts[1] / of - step * np.array([0.5, 0.3])
    assert np.all(np.abs(off) < 4 * np.sqrt(np.diagonal(fitted.covariance)[1:3]) / of)
    assert np.std(record.residual(fitted.trajectory)) == pytest.approx(1e-3, rel=0.1)


def test_a_phase_that_walks_is_followed_between_the_means() -> None:
    """What is left of the samples must be their noise, not what the phase does within a mean."""
    rng, of, walk, noise = np.random.default_rng(7), 5, 0.02, 2e-3
    phase = np.cumsum(0.06 + walk * rng.normal(size=2500))
    values = 0.4 * np.sin(phase) + rng.normal(0.0, noise, phase.size)
    record, looseness = SampledRecord(values, np.ones(phase.size), of), of**2 * (walk / noise) ** 2
    parameters = np.array([0.06 * of, 1e-3, 1e-3, 0.4, 0.0])
    start = Trajectory(phase.reshape(-1, of).mean(axis=1), parameters, Terms(1, 1, 1))
    fitted = record.fit(start, looseness, 30)
    assert np.std(record.residual(fitted.trajectory, looseness)) < noise
    assert np.std(record.residual(fitted.trajectory)) > 2 * noise
