"""A second way to everything that the tests compare with; shares no code with the `analysis` package."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares


def integrated_beat(times, k, w, wl, *, amplitude=1.0, phi0=0.0, beta=0.0, delta=0.0):
    """A sin(phi + delta) by an eighth-order integrator; `w` is a number or a function of time."""
    rate = w if callable(w) else (lambda _t: w)

    def slope(t, phi):
        return 2 * np.pi * k * (rate(t) - wl * np.sin(phi + beta))

    solved = solve_ivp(slope, (times[0], times[-1]), [phi0], method="DOP853", t_eval=times, rtol=3e-14, atol=1e-13)
    return amplitude * np.sin(solved.y[0] + delta)


def adler_beat(times, f_over_k, wl, k, theta, delta, amplitude, offset):
    """The beat by the textbook solution tan(chi/2) = x + sqrt(1-x^2) tan(pi f t + theta); chi = phi + beta."""
    w = np.hypot(f_over_k, wl)
    x = wl / w
    tangent = x + np.sqrt(1 - x * x) * np.tan(np.pi * k * f_over_k * times + theta)
    return offset + amplitude * np.sin(2 * np.arctan(tangent) + delta)


def bound(times, truth, noise):
    """Cramer-Rao bound of the lock-in rate, by numerical derivatives of `adler_beat`.

    `truth`: f_over_k, wl, k, theta, delta, amplitude, offset; k is known, the six others are not.
    """
    names = ("f_over_k", "wl", "theta", "delta", "amplitude", "offset")
    columns = []
    for name in names:
        step = 1e-5 * max(abs(truth[name]), 1e-3)
        if name == "f_over_k":
            step = 1e-4 / (times[-1] * truth["k"])
        up, down = (adler_beat(times, **{**truth, name: truth[name] + s}) for s in (step, -step))
        columns.append((up - down) / (2 * step))
    jacobian = np.stack(columns, axis=-1)
    scale = np.linalg.norm(jacobian, axis=0)
    covariance = np.linalg.inv((jacobian / scale).T @ (jacobian / scale)) / np.outer(scale, scale)
    return float(noise * np.sqrt(covariance[1, 1]))


def slow_fit(times, volts, truth):
    """Maximum-likelihood fit of `adler_beat` by a general optimiser, started at the truth; returns WL."""
    names = ("f_over_k", "wl", "theta", "delta", "amplitude", "offset")
    typical = np.array(
        [1 / (times[-1] * truth["k"]), truth["wl"], 1.0, 1.0, truth["amplitude"], truth["amplitude"]]
    )

    def left(p):
        values = dict(zip(names, p * typical, strict=True))
        return adler_beat(times, k=truth["k"], **values) - volts

    start = np.array([truth[name] for name in names]) / typical
    fit = least_squares(left, start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return float(fit.x[1] * typical[1])


def random_records(rng, n_records, *, x_range, noise_range, periods_range, n_samples=2500):
    """Noisy eight-bit codes of random gyros, and the truth of each."""
    records, truths, noises = [], [], []
    times = np.arange(n_samples, dtype=float)
    for _ in range(n_records):
        rate_over_lock_in = np.exp(rng.uniform(*np.log(x_range)))
        periods = np.exp(rng.uniform(*np.log(periods_range)))
        noise = rng.uniform(*noise_range)
        f_over_k = 0.1
        truth = {
            "f_over_k": f_over_k,
            "wl": f_over_k / np.sqrt(rate_over_lock_in**2 - 1),
            "k": periods / n_samples / f_over_k,
            "theta": rng.uniform(0, np.pi),
            "delta": rng.uniform(-np.pi, np.pi),
            "amplitude": rng.uniform(20, 120),
            "offset": rng.uniform(-3, 3),
        }
        codes = np.rint(adler_beat(times, **truth) + rng.normal(scale=noise, size=n_samples))
        records.append(codes)
        truths.append(truth)
        noises.append(np.hypot(noise, 1 / np.sqrt(12)))
    return times, np.array(records), truths, np.array(noises)
