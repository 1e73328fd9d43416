"""Exact normal equations of the tied series from the sums of a record's harmonics, in closed form.

With g = e / (1 - q e), e = exp(i w m), the waveform is c0 + Re(H g), and its derivatives are made of g and g^2:

    d/dH: g        d/dq: H g^2        d/dw: i m H (g + q g^2)

so every inner product that the normal equations need is a sum over the samples, weighted with t^p, of a product
of two of 1, g, g^2 and their conjugates. Powers of g are power series in e, sums of which are the kernels:

    g^j = sum over k >= j of C(k-1, j-1) q^(k-j) e^k

and products with conjugates reduce to them by |g|^2 = (1 + 2 Re(q g)) / (1 - |q|^2), since |e| = 1. The cost of a
record is proportional to its number of harmonics, and nothing is left out: few periods, where the harmonics are
not orthogonal, and folded harmonics, which fall onto each other, are exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy.special

from analysis.arrays import Floats, Indices, Phasors, Samples
from analysis.waveform.series.geometric_series import Series, orders_needed
from analysis.waveform.series.harmonic_sums import UNIFORM_PHASES, data_sums, uniform_kernels
from analysis.waveform.series.normal_equations import Step, empty_matrices

LEFT_OUT_OF_DATA = {np.dtype(np.float32): 1e-6, np.dtype(np.float64): 1e-14}
LEFT_OUT_OF_KERNELS = {np.dtype(np.float32): 1e-9, np.dtype(np.float64): 1e-18}
"""Powers of the ratio below these are left out of the sums. A harmonic that folds onto the fundamental, or onto
zero frequency, has a large sum, and the coefficients hold factors up to its order, or binomials up to thousands:
so they must be small indeed."""


@dataclass(frozen=True)
class SeriesSums:
    """Sums over the samples of (R,) records, of which the normal equations are made.

    counts : (R, 3) of t^p
    of_g : (R, 3, 4) of t^p g^j, j = 1..4
    of_data : (R, 2, 2) of v t^p g^j, j = 1, 2
    """

    counts: Floats
    of_g: Phasors
    of_data: Phasors

    @staticmethod
    def zeros(n_records: int) -> SeriesSums:
        """Room for those of so many records."""
        of_g, of_data = (np.zeros((n_records, *shape), dtype=np.complex128) for shape in ((3, 4), (2, 2)))
        return SeriesSums(np.zeros((n_records, 3)), of_g, of_data)

    @staticmethod
    def of(values: Samples, weights: Samples | None, series: Series, largest: float) -> SeriesSums:
        """Sums of (R, N) records, 0 where missing, none of whose ratios exceeds `largest`."""
        n_samples, kind = values.shape[1], values.dtype
        n_harmonics = orders_needed(largest, LEFT_OUT_OF_DATA[kind], 3)
        n_orders = orders_needed(largest, LEFT_OUT_OF_KERNELS[kind], 6)
        of_powers = _powers_of_g(series.ratio, n_orders)
        if weights is None:
            kernels = uniform_kernels(series.omega, n_samples, n_orders)
            counts = kernels[:, :, 0]
            # real matrices times complex ones, as two real ones side by side
            of_g = np.matmul(kernels[:, :, 1:], of_powers.view(np.float64)).view(np.complex128)
            of_g *= np.conj(UNIFORM_PHASES)
        else:
            of_weights = np.conj(data_sums(weights, series.omega, n_orders, 2))
            counts = of_weights[:, :, 0].real
            of_g = np.matmul(of_weights[:, :, 1:], of_powers)
        of_data = np.conj(data_sums(values, series.omega, n_harmonics, 1, lowest=1))
        return SeriesSums(counts, of_g, np.matmul(of_data, of_powers[:, :n_harmonics, :2]))

    def put(self, part: Indices, other: SeriesSums) -> None:
        """Write the other's records into the places `part` of this one."""
        self.counts[part], self.of_g[part], self.of_data[part] = other.counts, other.of_g, other.of_data


def _powers_of_g(ratio: Phasors, n_orders: int) -> Phasors:
    """Coefficients C(k-1, j-1) q^(k-j) of e^k in g^j; k = 1..n_orders, j = 1..4; (R, n_orders, 4)."""
    powers = np.empty((ratio.size, n_orders), dtype=np.complex128)
    powers[:, 0] = 1.0
    powers[:, 1:] = ratio[:, np.newaxis]
    np.multiply.accumulate(powers, axis=1, out=powers)
    coefficients = np.zeros((ratio.size, n_orders, 4), dtype=np.complex128)
    for j, binomials in enumerate(_binomials(n_orders)):
        np.multiply(powers[:, : n_orders - j], binomials, out=coefficients[:, j:, j])
    return coefficients


@cache
def _binomials(n_orders: int) -> list[Floats]:
    """C(k-1, j-1), k = j..n_orders, for j = 1..4."""
    return [np.asarray(scipy.special.comb(np.arange(j, n_orders), j)) for j in range(4)]


def equations_of_sums(series: Series, sums: SeriesSums, power: Floats, total: Floats) -> Step:
    """Normal equations of (R,) records at the given parameters."""
    counts, g_sums, v_sums = sums.counts, sums.of_g, sums.of_data
    first, ratio, offset = series.first, series.ratio, series.offset
    column = ratio[:, np.newaxis]
    poisson = 1 / (1 - np.abs(column) ** 2)
    one, two, three, four = (g_sums[..., j] for j in range(4))
    # sums of t^p times |g|^2, g^2 conj(g) and |g|^4
    g_g = poisson * (counts + 2 * (column * one).real)
    gg_g = poisson * (one + column * two + np.conj(column) * g_g)
    gg_gg = poisson * (g_g + 2 * (column * gg_g).real)
    # the slope s = g + q g^2: sums of t^p times s, s g and s conj(g), s g^2 and s conj(g^2), s^2 and |s|^2
    s_, s_g, s_gg = one + column * two, two + column * three, three + column * four
    s_cg, s_cgg = g_g + column * gg_g, np.conj(gg_g) + column * gg_gg
    s_s, s_cs = s_g + column * s_gg, (s_cg + np.conj(column) * s_cgg).real

    normal = empty_matrices(first.size, 6)
    h_gg, turn = first * two[:, 0], 1j * first
    h_squared: Phasors = first * first
    normal[:, 0, 0] = counts[:, 0]
    normal[:, 0, 1], normal[:, 0, 2] = one[:, 0].real, -one[:, 0].imag
    normal[:, 0, 3], normal[:, 0, 4] = h_gg.real, -h_gg.imag
    normal[:, 0, 5] = (turn * s_[:, 1]).real
    _put_block(normal, 1, 1, g_g[:, 0] + 0j, two[:, 0])
    _put_block(normal, 1, 3, np.conj(first * gg_g[:, 0]), first * three[:, 0])
    _put_block(normal, 3, 3, np.abs(first) ** 2 * gg_gg[:, 0] + 0j, h_squared * four[:, 0])
    _put_column(normal, 1, turn * s_cg[:, 1], turn * s_g[:, 1])
    _put_column(normal, 3, turn * np.conj(first) * s_cgg[:, 1], turn * first * s_gg[:, 1])
    normal[:, 5, 5] = np.abs(first) ** 2 * s_cs[:, 2] - (h_squared * s_s[:, 2]).real
    normal[:, 1:, 1:] /= 2
    for row in range(1, 6):
        normal[:, row, :row] = normal[:, :row, row]

    # what the model leaves, times 1, g, g^2 and the slope
    back = np.conj(first)
    left = total - offset * counts[:, 0] - (first * one[:, 0]).real
    left_g = v_sums[:, 0, 0] - offset * one[:, 0] - (first * two[:, 0] + back * g_g[:, 0]) / 2
    left_gg = v_sums[:, 0, 1] - offset * two[:, 0] - (first * three[:, 0] + back * gg_g[:, 0]) / 2
    left_s = v_sums[:, 1, 0] + ratio * v_sums[:, 1, 1] - offset * s_[:, 1]
    left_s -= (first * s_g[:, 1] + back * s_cg[:, 1]) / 2
    by_ratio = first * left_gg
    gradient = np.stack(
        [left, left_g.real, -left_g.imag, by_ratio.real, -by_ratio.imag, (turn * left_s).real], axis=-1
    )
    explained = offset * (total + left) + (first * (v_sums[:, 0, 0] + left_g)).real
    return Step(normal, gradient, np.maximum(power - explained, 0.0))


def _put_block(normal: Floats, row: int, column: int, with_conjugate: Phasors, without: Phasors) -> None:
    """Inner products of Re a, -Im a with Re b, -Im b, twice, from the sums of a conj(b) and of a b."""
    sum_, difference = with_conjugate + without, with_conjugate - without
    normal[:, row, column], normal[:, row, column + 1] = sum_.real, difference.imag
    np.negative(sum_.imag, out=normal[:, row + 1, column])
    normal[:, row + 1, column + 1] = difference.real


def _put_column(normal: Floats, row: int, with_conjugate: Phasors, without: Phasors) -> None:
    """Inner products of Re a, -Im a with Re b, twice, from the sums of b conj(a) and of b a."""
    sum_ = with_conjugate + without
    normal[:, row, 5] = sum_.real
    np.subtract(with_conjugate.imag, without.imag, out=normal[:, row + 1, 5])
