"""The phase of every sample and the few numbers that rule them all, fitted at the same time.

    minimise  sum over samples of (v - C - A sin(phi_n))^2  +  (1/l) sum over steps of (phi_(n+1) - F(phi_n))^2

F is the exact step of the lock-in equation, a(t), A(t) and C(t) are polynomials. l is the variance of what moves
the phase beside them over that of the noise of the samples: large, the phases follow the samples whatever the
motion may be; small, the equation holds exactly. So a fit that starts large and goes small does not get lost, and
one that stays in between is that of a rate with noise of its own: in a linear problem this is the estimate of
generalised least squares, and its covariance.

Each Gauss-Newton step solves one tridiagonal system for the phases, with one right side for each parameter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lapack

from analysis.arrays import Floats
from analysis.waveform.moving_rate.exact_steps import Steps, exact_steps
from analysis.waveform.moving_rate.polynomials import polynomials

LARGEST_TURN = 1.0
"""rad by which a phase may change in one step of the fit."""

SHORTER, SHORTENED = 4.0, 6
"""A step that makes the fit worse is tried again so many times shorter, and so often."""

ENOUGH = 1e-3
"""Gain of a last step, in variances of a sample's noise: a thirtieth of a standard uncertainty."""

RIDGE = 1e-12


@dataclass(frozen=True)
class Terms:
    """How many terms rate, amplitude and offset have, polynomials unless said otherwise.

    step : first sample behind a step of the offset, which is then one term more
    jump : number of the step from sample to sample in which the rate jumps; its last two terms are then the jump,
        and what it does in that step
    stretched : whether s and c jump with it, as where the time base does
    """

    rate: int
    amplitude: int
    offset: int
    step: int | None = None
    jump: int | None = None
    stretched: bool = False

    @property
    def count(self) -> int:
        """Number of parameters, s and c included."""
        return self.rate + 2 + self.amplitude + self.offset + (self.step is not None)


@dataclass(frozen=True)
class Trajectory:
    """phase : (N,) rad
    parameters : (P,) rate, s, c, amplitude, offset, step of the offset; `terms` says how many of each.
    """

    phase: Floats
    parameters: Floats
    terms: Terms

    @property
    def rate(self) -> Floats:
        """Coefficients of a(t), rad per sample: of the columns of `rate_columns`, its mean first."""
        return self.parameters[: self.terms.rate]

    @property
    def pull(self) -> Floats:
        """s and c, rad per sample."""
        return self.parameters[self.terms.rate : self.terms.rate + 2]

    @property
    def amplitude(self) -> Floats:
        """Legendre coefficients of A(t)."""
        return self.parameters[self.terms.rate + 2 : self.terms.rate + 2 + self.terms.amplitude]

    @property
    def offset(self) -> Floats:
        """Legendre coefficients of C(t), and its step last, if it has one."""
        return self.parameters[self.terms.rate + 2 + self.terms.amplitude :]


def rate_columns(n_samples: int, terms: Terms) -> tuple[Floats, Floats]:
    """What a(t) is made of: at the samples (terms, N), and its mean between them (terms, N - 1)."""
    low = polynomials(n_samples)
    if terms.jump is None:
        return low.values[: terms.rate], low.means[: terms.rate]
    smooth, places = terms.rate - 2, np.arange(n_samples)
    after, during = (places > terms.jump).astype(np.float64), (places == terms.jump).astype(np.float64)
    at_samples = np.stack([after, np.zeros(n_samples)])
    between = np.stack([after[:-1], during[:-1]])
    means = between.mean(axis=1, keepdims=True)
    return (
        np.concatenate([low.values[:smooth], at_samples - means]),
        np.concatenate([low.means[:smooth], between - means]),
    )


@dataclass(frozen=True)
class Fitted:
    """A trajectory with what is known of it at the minimum.

    cost : the sum that was minimised, in squared units of the samples
    degrees : samples less parameters
    normal : (P, P) normal matrix of the parameters, phases eliminated
    evidence : -2 log of the restricted likelihood, without a constant, its noise at its best
    left : (N,) residuals of the samples
    moved : (N - 1,) rad, residuals of the steps: what moves the phase beside the equation
    converged : whether the last step gained next to nothing
    """

    trajectory: Trajectory
    looseness: float
    cost: float
    degrees: float
    normal: Floats
    evidence: float
    left: Floats
    moved: Floats
    converged: bool

    @property
    def variance(self) -> float:
        """Of the noise of a sample."""
        return self.cost / self.degrees

    @property
    def covariance(self) -> Floats:
        """Of the parameters, (P, P)."""
        scale = 1 / np.sqrt(np.maximum(np.diagonal(self.normal), 1e-300))
        scaled = self.normal * scale * scale[:, np.newaxis] + RIDGE * np.eye(scale.size)
        return np.asarray(np.linalg.inv(scaled) * scale * scale[:, np.newaxis] * self.variance)


@dataclass(frozen=True)
class _Model:
    """What a trajectory makes of a record: residuals of samples and steps, and their derivatives."""

    left: Floats
    moved: Floats
    steps: Steps
    by_phase: Floats
    by_sample: Floats

    def cost(self, looseness: float) -> float:
        return float(self.left @ self.left + self.moved @ self.moved / looseness)


class Record:
    """One record (N,), `mask` 0 where a sample is missing."""

    def __init__(self, values: Floats, mask: Floats) -> None:
        self.values, self.mask, self.count = values, mask, float(mask.sum())

    def fit(self, start: Trajectory, looseness: float, iterations: int) -> Fitted:
        """Gauss-Newton from a start; `looseness` is l above, in 1 over squared units of the samples."""
        now, model = start, self._model(start)
        cost, converged = model.cost(looseness), False
        for _ in range(iterations):
            equations = _Equations.of(self, now, model, looseness)
            by_phase, by_parameters, gain = equations.solve()
            share = min(1.0, LARGEST_TURN / max(float(np.abs(by_phase).max()), 1e-300))
            for _ in range(SHORTENED):
                trial = replace(
                    now, phase=now.phase + share * by_phase, parameters=now.parameters + share * by_parameters
                )
                trial_model = self._model(trial)
                trial_cost = trial_model.cost(looseness)
                if trial_cost <= cost:
                    break
                share /= SHORTER
            enough = ENOUGH * cost / self.count
            # At the minimum the cost repeats to rounding.
            converged = share == 1.0 and gain < enough
            if not trial_cost <= cost:
                converged = gain < enough
                break
            now, model, cost = trial, trial_model, trial_cost
            if converged:
                break
        # one more phase than parameters is free: that of the start
        degrees = max(self.count - now.terms.count - 1, 1.0)
        evidence = equations.evidence + degrees * np.log(max(cost, 1e-300))
        return Fitted(
            now, looseness, cost, degrees, equations.normal, evidence, model.left, model.moved, converged
        )

    def drift_of_pull(self, fitted: Fitted) -> tuple[Floats, Floats]:
        """What s and c would gain from the middle of the record to its end if they drifted evenly.

        One step from the minimum of a fit without such a drift.
        """
        at, model = fitted.trajectory, self._model(fitted.trajectory)
        equations = _Equations.of(self, at, model, fitted.looseness, drifting=True)
        # the two of the drift last
        first = at.terms.rate + 2
        order = np.concatenate([np.delete(np.arange(at.terms.count + 2), [first, first + 1]), [first, first + 1]])
        normal, gradient = equations.normal[np.ix_(order, order)], equations.gradient[order]
        scale = 1 / np.sqrt(np.maximum(np.diagonal(normal), 1e-300))
        scaled = normal * scale * scale[:, np.newaxis]
        scaled[np.diag_indices_from(scaled)] += RIDGE
        inverse = (np.linalg.inv(scaled) * scale * scale[:, np.newaxis])[-2:]
        return inverse @ gradient, inverse[:, -2:] * fitted.variance

    def columns(self, terms: Terms) -> tuple[Floats, Floats]:
        """What A and C are made of, (terms, N) each."""
        low = polynomials(self.values.size).values
        of_offset = low[: terms.offset]
        if terms.step is not None:
            behind = (np.arange(self.values.size) >= terms.step).astype(np.float64)
            of_offset = np.concatenate([of_offset, behind[np.newaxis]])
        return low[: terms.amplitude], of_offset

    def waveform(self, trajectory: Trajectory) -> Floats:
        """The samples that a trajectory makes, (N,)."""
        of_amplitude, of_offset = self.columns(trajectory.terms)
        amplitude = trajectory.amplitude @ of_amplitude
        return np.asarray(trajectory.offset @ of_offset + amplitude * np.sin(trajectory.phase))

    def _model(self, trajectory: Trajectory) -> _Model:
        of_amplitude, of_offset = self.columns(trajectory.terms)
        amplitude, sine = trajectory.amplitude @ of_amplitude, np.sin(trajectory.phase)
        left = (self.values - trajectory.offset @ of_offset - amplitude * sine) * self.mask
        at_samples, between = rate_columns(self.values.size, trajectory.terms)
        rate = trajectory.rate
        pull = trajectory.pull
        if trajectory.terms.stretched:
            pull = pull[:, np.newaxis] * (rate @ between / rate[0])
        steps = exact_steps(trajectory.phase, rate @ between, rate @ at_samples, *pull)
        return _Model(
            left,
            np.diff(trajectory.phase) - steps.advance,
            steps,
            amplitude * np.cos(trajectory.phase) * self.mask,
            np.concatenate([of_amplitude * sine, of_offset]) * self.mask,
        )


@dataclass(frozen=True)
class _Equations:
    """Normal equations with the phases eliminated: tridiagonal for the phases, dense for the parameters."""

    normal: Floats
    gradient: Floats
    sides: Floats
    phase_gradient: Floats
    full_gradient: Floats
    factor: tuple[Floats, Floats]
    evidence: float

    @staticmethod
    def of(
        record: Record, at: Trajectory, model: _Model, looseness: float, *, drifting: bool = False
    ) -> _Equations:
        """`drifting`: behind s and c two more parameters, by which they grow from the middle to the end."""
        steps, tight = model.steps, 1 / looseness
        diagonal = model.by_phase**2
        diagonal += RIDGE * np.mean(diagonal)
        diagonal[1:] += tight
        diagonal[:-1] += steps.by_phase**2 * tight
        factor, ratios, failed = lapack.dpttrf(diagonal, -steps.by_phase * tight)
        if failed:
            raise np.linalg.LinAlgError("the phases are not determined")
        basis = rate_columns(record.values.size, at.terms)[1]
        n_rate, n_more = at.terms.rate, 2 if drifting else 0
        n_moved, n_all = n_rate + 2 + n_more, at.terms.count + n_more
        by_step = np.empty((n_moved, record.values.size - 1))
        np.multiply(basis, steps.by_rate, out=by_step[:n_rate])
        by_step[n_rate : n_rate + 2] = steps.by_sine, steps.by_cosine
        if at.terms.stretched:
            growth = at.rate @ basis / at.rate[0]
            pulled = (at.pull @ by_step[n_rate : n_rate + 2]) / at.rate[0]
            by_step[0] += (1 - growth) * pulled
            by_step[1:n_rate] += basis[1:] * pulled
            by_step[n_rate : n_rate + 2] *= growth
        if drifting:
            by_step[-2:] = by_step[n_rate : n_rate + 2] * polynomials(record.values.size).means[1]
        sides = np.zeros((n_all, record.values.size))
        np.multiply(by_step, steps.by_phase * tight, out=sides[:n_moved, :-1])
        sides[:n_moved, 1:] -= tight * by_step
        np.multiply(model.by_sample, model.by_phase, out=sides[n_moved:])
        moved = model.moved * tight
        phase_gradient = model.by_phase * model.left
        phase_gradient[1:] -= moved
        phase_gradient[:-1] += steps.by_phase * moved
        normal = np.zeros((n_all, n_all))
        normal[:n_moved, :n_moved] = tight * (by_step @ by_step.T)
        normal[n_moved:, n_moved:] = model.by_sample @ model.by_sample.T
        full_gradient = np.concatenate([by_step @ moved, model.by_sample @ model.left])
        # Half a solution is enough: with L D L' the matrix of the phases and y = L^-1 sides they take y' D^-1 y.
        band = np.stack([np.ones_like(factor), np.append(ratios, 0.0)])
        half = lapack.dtbtrs(band, sides.T, uplo="L", diag="U")[0].T
        half /= np.sqrt(factor)
        normal -= half @ half.T
        solved = lapack.dpttrs(factor, ratios, phase_gradient)[0]
        evidence = float(np.log(factor).sum() + (record.values.size - 1) * np.log(looseness))
        sign, size = np.linalg.slogdet(normal)
        return _Equations(
            normal,
            full_gradient - sides @ solved,
            sides,
            phase_gradient,
            full_gradient,
            (factor, ratios),
            evidence + (float(size) if sign > 0 else 0.0),
        )

    def solve(self) -> tuple[Floats, Floats, float]:
        """Change of the phases and of the parameters, and what they gain if all is linear."""
        scale = 1 / np.sqrt(np.maximum(np.diagonal(self.normal), 1e-300))
        scaled = self.normal * scale * scale[:, np.newaxis]
        scaled[np.diag_indices_from(scaled)] += RIDGE
        by_parameters = scale * np.linalg.solve(scaled, scale * self.gradient)
        by_phase = lapack.dpttrs(*self.factor, self.phase_gradient - by_parameters @ self.sides)[0]
        gain = float(self.phase_gradient @ by_phase + self.full_gradient @ by_parameters)
        return by_phase, by_parameters, gain
