"""Where input axes point: by the earth rate's sine of one axis, or by three axes that are recorded at once.

One axis along the table's: an input axis tilted by psi sees the horizontal earth rate as a sine of amplitude
K w_h sin(psi) with the period of a turn. Its phase says nothing where nobody knows the azimuth at the begin of
each window, so its power is taken, freed of that of the noise.

Three axes at once, each brought to the table's axis in turn: with body axis b along the vertical the output of
gyro i over whole turns is

    N_i = S_ib end (Omega + w_v) + B_i

The columns of S are measured one after the other; row i over its length is the direction of input axis i in the
axes of the body, as the fixture brings them to the table's axis. What the fixture is out of square is in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats
from analysis.fibre_gyro.rate_table import with_drift
from analysis.fibre_gyro.scatter import find_run_scatter, signal_interval

_RIGHT_ANGLE_MRAD = 500.0 * np.pi


@dataclass(frozen=True)
class InputAxisTilt:
    """Angle between input axis and table axis."""

    # 0 where the sine does not stand out of its noise; the interval says up to where it may be hidden there
    tilt_mrad: float
    low_95_mrad: float
    high_95_mrad: float


def input_axis_tilt(
    sines: ArrayLike, sines_u: ArrayLike, horizontal_counts: float, *, freedom: float = 1e6
) -> InputAxisTilt:
    """Angle between input axis and table axis from the once-per-turn sines of several windows."""
    amplitude, u = np.abs(np.asarray(sines)), np.asarray(sines_u, dtype=np.float64)
    if not horizontal_counts > 0:
        raise ValueError("the horizontal earth rate is zero at the pole: a tilt of the input axis does not show")
    known = np.isfinite(u) & (u > 0)
    if not known.any():
        raise ValueError("no window has whole turns enough")
    power = float(np.sum((amplitude[known] / u[known]) ** 2))
    # of the power for an amplitude of one count
    each = float(np.sum(u[known] ** -2.0))
    own = 2 * int(known.sum())
    squares = [max(power - own, 0.0), *signal_interval(power, own, freedom)]
    sizes = np.sqrt(np.array(squares) / each) / horizontal_counts
    tilts = [1e3 * float(np.arcsin(size)) if size < 1 else _RIGHT_ANGLE_MRAD for size in sizes]
    return InputAxisTilt(*tilts)


@dataclass(frozen=True)
class ThreeAxes:
    """Scale factors and directions of gyros that were recorded at once."""

    gyros: tuple[str, ...]  # gyros, and body axes that were brought to the table's axis
    turned: tuple[str, ...]
    matrix: Floats  # (gyros, turned): S, counts per deg/s; with its uncertainty
    matrix_u: Floats
    bias: Floats  # (gyros,): counts; with its uncertainty
    bias_u: Floats
    # (gyros,): length of each row: along the input axis. nan unless all three axes were turned.; with its
    # uncertainty
    scale_factor: Floats
    scale_factor_u: Floats
    # (gyros, turned): direction of each input axis towards the other body axes: S_ib over S_ii; 0 towards its own.
    # nan for a gyro whose own axis was not turned.
    misalignment_mrad: Floats
    misalignment_u_mrad: Floats


def fit_three_axes(
    gyros: Sequence[str],
    turned: Sequence[str],
    rate_dps: ArrayLike,
    means: ArrayLike,
    means_u: ArrayLike,
    *,
    end_up: ArrayLike = 1,
    at_s: ArrayLike = np.nan,
    vertical_earth_rate_dps: float = 0.0,
    irreproducibility_ppm: float | None = None,
    table_rate_u_ppm: float = 0.0,
    slow: Sequence[Floats | None] = (),
) -> ThreeAxes:
    """Fit the matrix of scale factors and misalignments to all runs."""
    rates = np.asarray(rate_dps, dtype=np.float64)
    ends = np.broadcast_to(np.asarray(end_up, dtype=np.float64), rates.shape)
    mean, u = np.asarray(means, dtype=np.float64), np.asarray(means_u, dtype=np.float64)
    axes = tuple(dict.fromkeys(turned))
    about = np.array([[name == axis for axis in axes] for name in turned], dtype=np.float64)
    for axis, chosen in zip(axes, about.T, strict=True):
        if np.unique(np.sign((ends * rates)[chosen > 0])).size < 2:
            raise ValueError(f"axis {axis} was turned in one sense only")
    along = ends * (rates + vertical_earth_rate_dps)
    when = np.broadcast_to(np.asarray(at_s, dtype=np.float64), rates.shape)
    design = with_drift(np.column_stack([about * along[:, np.newaxis], np.ones(rates.size)]), when)
    stated = None if irreproducibility_ppm is None else 1e-6 * irreproducibility_ppm
    count = len(axes)
    matrix, matrix_u = np.empty((len(gyros), count)), np.empty((len(gyros), count))
    bias, bias_u, scale_u = np.empty(len(gyros)), np.empty(len(gyros)), np.empty(len(gyros))
    angle, angle_u = np.zeros((len(gyros), count)), np.zeros((len(gyros), count))
    for place, gyro in enumerate(gyros):
        known = slow[place] if slow else None
        scatter = find_run_scatter(
            design, mean[:, place], u[:, place], stated, slow=known, by_model=known is not None
        )
        estimator = scatter.estimator(design)
        values = estimator @ mean[:, place]
        spread = [scatter.standard_u(row) for row in estimator]
        common = 1e-6 * table_rate_u_ppm * np.abs(values[:count])
        size = float(np.linalg.norm(values[:count]))
        matrix[place], bias[place] = values[:count], values[count]
        matrix_u[place], bias_u[place] = np.hypot(spread[:count], common), spread[count]
        along_axis = scatter.standard_u(values[:count] @ estimator[:count] / size)
        scale_u[place] = np.hypot(along_axis, 1e-6 * table_rate_u_ppm * size)
        own = axes.index(gyro) if gyro in axes else None
        for other in range(count):
            if own is None:
                angle[place, other] = angle_u[place, other] = np.nan
            elif other != own:
                ratio = values[other] / values[own]
                angle[place, other] = 1e3 * ratio
                combined = (estimator[other] - ratio * estimator[own]) / values[own]
                angle_u[place, other] = 1e3 * scatter.standard_u(combined)
    whole = count == 3
    return ThreeAxes(
        tuple(gyros), axes, matrix, matrix_u, bias, bias_u,
        np.linalg.norm(matrix, axis=1) if whole else np.full(len(gyros), np.nan),
        scale_u if whole else np.full(len(gyros), np.nan),
        angle, angle_u,
    )  # fmt: skip
