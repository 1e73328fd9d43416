"""The fibre coil: Sagnac phase, transit time and nominal scale factor.

    phi_s = (2 pi L D)/(lambda c) Omega           Sagnac phase, Omega in rad/s                           (13)
    tau   = n L / c                               time that the light takes through the coil
    K0    = 2^N L D/(lambda c) (pi/180)           codes per deg/s, when the 2^N codes span exactly 2 pi  (14)

L length of the fibre, D mean diameter of the coil, lambda wavelength in vacuum, n group index, N bits of the
converter. The index is in the transit time only, not in the Sagnac phase. Equations are numbered as in
docs/fibre_gyro.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

LIGHT_SPEED = 299_792_458.0
"""m/s, exact by definition."""


@dataclass(frozen=True)
class FibreCoil:
    """A coil of fibre and the light in it.

    Attributes
    ----------
    group_index : float
        About 1.46 to 1.47 for silica.

    Raises
    ------
    ValueError
        One of them is not positive.

    Examples
    --------
    >>> coil = FibreCoil(1000.0, 0.1, 1.55e-6, 1.468)
    >>> round(coil.transit_time * 1e6, 4), round(coil.sagnac_factor, 5), round(coil.nominal_scale(16), 6)
    (4.8967, 1.35216, 246.152866)
    """

    length_m: float = 1000.0
    diameter_m: float = 0.1
    wavelength_m: float = 1.55e-6
    group_index: float = 1.468

    def __post_init__(self) -> None:
        for name in ("length_m", "diameter_m", "wavelength_m", "group_index"):
            value = getattr(self, name)
            if not (value > 0 and np.isfinite(value)):
                raise ValueError(f"{name} of a fibre coil must be a positive number, not {value!r}")

    @property
    def transit_time(self) -> float:
        """Time of the light through the coil, s."""
        return self.group_index * self.length_m / LIGHT_SPEED

    @property
    def proper_frequency(self) -> float:
        """Frequency of the bias modulation, 1/(2 tau), Hz."""
        return 1.0 / (2.0 * self.transit_time)

    @property
    def sagnac_factor(self) -> float:
        """Sagnac phase per rate, rad per rad/s, that is s."""
        return 2.0 * np.pi * self.length_m * self.diameter_m / (self.wavelength_m * LIGHT_SPEED)

    @property
    def turns_per_dps(self) -> float:
        """Sagnac phase in whole fringes per deg/s."""
        return self.sagnac_factor / 360.0

    @property
    def fringe_limit_dps(self) -> float:
        """Rate with a Sagnac phase of pi: above it a loop that starts from rest settles on another fringe, deg/s.

        Examples
        --------
        >>> round(FibreCoil().fringe_limit_dps, 1)
        133.1
        """
        return 0.5 / self.turns_per_dps

    def nominal_scale(self, dac_bits: int) -> float:
        """K0 of equation (14), codes per deg/s."""
        return 2.0**dac_bits * self.turns_per_dps

    def scaled(self, factor: float) -> FibreCoil:
        """Coil whose L D/lambda is `factor` times this one's and whose transit time is the same.

        Examples
        --------
        >>> round(FibreCoil().scaled(1.0001).nominal_scale(16) / FibreCoil().nominal_scale(16) - 1, 9)
        0.0001
        """
        return replace(self, wavelength_m=self.wavelength_m / factor)
