"""Numbers that several measurements give, or that a simulation, a plan or a table of records has too.

A measurement says with :func:`dataclasses.replace` where its evaluation holds them and how well it knows them.
"""

from station.results.quantity import Quantity

# of a ring laser
LOCK_IN_RATE = Quantity("lock_in_rate", "dps", u=True, expected="gyro.expected_lock_in_rate_dps")
LOCK_IN_RATE_NOISE_U = Quantity("lock_in_rate_noise_u", "dps", doc="by the noise of the records alone")
INPUT_RATE = Quantity("input_rate", "dps", doc="rate on the axis")
BEAT_FREQUENCY = Quantity("beat_frequency", "hz", u=True)
RATIO = Quantity("ratio", u=True, doc="second harmonic over fundamental, A2/A1")
BACKSCATTER_PHASE = Quantity("backscatter_phase", "rad", doc="less the readout phase")
AMPLITUDE = Quantity("amplitude", "v", doc="of the fundamental; of several rates the mean")
NOISE_RMS = Quantity("noise_rms", "v", limit=True, doc="in each sample; of several rates of all records")
SCALE_FACTOR = Quantity("scale_factor", "pulses_per_deg", doc="as used")
BIAS_RATE = Quantity("bias_rate", "dps", u=True)
DEAD_BAND_WIDTH = Quantity(
    "dead_band", "dps", u=True, doc="between the edges: twice the lock-in rate",
    expected=lambda settings: 2 * settings.gyro.expected_lock_in_rate_dps,
)  # fmt: skip

# of a fibre gyro's modulator
TWO_PI_VOLTAGE = Quantity("two_pi_voltage", "v", "two_pi_voltage.value", "two_pi_voltage.u")
TWO_PI_ERROR_PPM = Quantity("two_pi_error", "ppm", scale=1e6)
