"""The fields of a two-mode laser in the time domain, integrated: independent of every estimator."""

import numpy as np
from scipy.integrate import solve_ivp


def integrated_fields(laser, rate, duration, n_samples):
    """Complex fields of the two beams in the time domain, by an eighth-order integrator.

    dE1/dt = (gain (1 + i h) + i s)/2 E1 + a2 exp(-i eps/2) E2,  dE2/dt = (gain (1 + i h) - i s)/2 E2 + ... E1:
    intensities and the phase psi = arg E1 - arg E2 follow without a division by an intensity.
    """
    a1, a2 = laser.backscatter
    back, g, xi = complex(np.exp(-0.5j * laser.phase_sum)), laser.gain_rate, laser.cross_saturation
    j1, j2, turning = (
        1 + laser.beam_imbalance,
        1 - laser.beam_imbalance,
        0.5 * g / (1 + xi) * (1 + 1j * laser.gain_dispersion),
    )
    sagnac = float(2 * np.pi * laser.scale_factor * rate)

    def slope(_t, y):
        x1, y1, x2, y2 = y.tolist()  # numbers of Python: those of NumPy are slow one by one
        e1, e2 = complex(x1, y1), complex(x2, y2)
        i1, i2 = x1 * x1 + y1 * y1, x2 * x2 + y2 * y2
        left1, left2 = j1 * (1 - i1), j2 * (1 - i2)
        d1 = (turning * (left1 + xi * left2) + 0.5j * sagnac) * e1 + a2 * back * e2
        d2 = (turning * (left2 + xi * left1) - 0.5j * sagnac) * e2 + a1 * back * e1
        return [d1.real, d1.imag, d2.real, d2.imag]

    settle = 40 * (1 + xi) / (g * (1 - xi))  # the difference of the intensities relaxes more slowly than their sum
    times = np.linspace(settle, settle + duration, n_samples, endpoint=False)
    solved = solve_ivp(slope, (0, times[-1]), [1, 0, 1, 0], method="DOP853", t_eval=times, rtol=1e-10, atol=1e-12)
    return solved.y[0] + 1j * solved.y[1], solved.y[2] + 1j * solved.y[3]
