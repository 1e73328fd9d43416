"""The closed loop written down once more, as plainly as can be: one sample after the other, unbounded integers."""

from __future__ import annotations

import math

import numpy as np

from analysis.fibre_gyro import FibreCoil, LoopDesign


def slow_outputs(
    coil: FibreCoil, s: LoopDesign, seed: int, n_pairs: int, rate_dps: float, injected: float
) -> list[float]:
    """Feedback step of every sample pair, sign reversed, in codes; only the phase of the staircase is wrapped."""
    rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(1)[0])
    unit = 2**s.fractional_bits
    full = 2**s.dac_bits * unit if s.wrap_codes is None else s.wrap_codes * unit
    factor = 2 * math.pi * coil.length_m * coil.diameter_m / (coil.wavelength_m * 299792458.0)
    sagnac = factor * math.radians(rate_dps)
    walk = math.radians(s.angle_random_walk_deg_per_sqrt_h) / 60 / math.sqrt(2 * coil.transit_time)
    phase_noise = factor * walk
    half = 2 ** (s.adc_bits - 1)
    gain = round(s.loop_gain * 2**s.dac_bits / (2 * math.pi) / (2 * half) * unit * 65536)

    def phase(total: int, second: int, bias: bool) -> float:
        code = (total % full) // unit + (2**s.dac_bits // 4 if bias else 0)
        if s.bias_in_wrap:
            code %= full // unit
        x = code / 2**s.dac_bits - 0.5
        bow = s.inl_quadratic * (x * x - 0.25) + s.inl_cubic * x * (x * x - 0.25)
        own = 2 * math.pi * (code / 2**s.dac_bits + bow) * (1 + s.two_pi_error)
        other = (second % full) // unit / 2**s.dac_bits * 2 * math.pi * (1 + s.injection_two_pi_error)
        return own + other

    number = round(injected * unit)
    total = second = register = 0
    before, steps = phase(0, 0, False), []
    for _ in range(n_pairs):
        feedback, falls, counts = register // 65536, (total // full, second // full), []
        for bias in (True, False):
            if s.injection_path == "shared":
                total += feedback + number
            else:
                total, second = total + feedback, second + number
            now = phase(total, second, bias)
            intensity = half * s.light_level * (1 + s.contrast * math.cos(sagnac + now - before))
            noise = math.sqrt(2) * half * s.light_level * s.contrast * phase_noise * rng.standard_normal()
            counts.append(int(min(max(intensity + s.adc_offset + noise, 0), 2 * half - 1)))
            before = now
        if not (s.gated and falls != (total // full, second // full)):
            limit = (full // 2 - 1) * 65536
            register = min(max(register + gain * (counts[0] - counts[1]), -limit), limit)
        steps.append(-feedback / unit)
    return steps
