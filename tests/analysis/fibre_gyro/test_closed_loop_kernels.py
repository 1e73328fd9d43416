"""All kernels of the loop give the same numbers, and those of a loop written down without any of their tricks."""

from __future__ import annotations

import importlib
import math
import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from slow_loop import slow_outputs

from analysis.fibre_gyro import ClosedLoop, FibreCoil, LoopDesign
from analysis.fibre_gyro.loop.kernels import cosine_of_turns

COIL = FibreCoil()
SCALAR = "analysis.fibre_gyro.loop.compiled_kernel"
BUILDS = {
    "gated": LoopDesign(two_pi_error=0.01),
    "all samples": LoopDesign(two_pi_error=-0.01, gated=False),
    "second electrode": LoopDesign(
        two_pi_error=0.003, injection_path="separate", injection_two_pi_error=-0.02, bias_in_wrap=True
    ),
    "coarse": LoopDesign(dac_bits=12, fractional_bits=0, adc_bits=10, gated=False, adc_offset=0.3),
    "bow": LoopDesign(inl_quadratic=2e-3, inl_cubic=4e-3, wrap_codes=66_000, light_level=0.8, contrast=0.9),
    "dark": LoopDesign(angle_random_walk_deg_per_sqrt_h=20.0, loop_gain=0.9),  # the converter clips
}


@pytest.fixture
def plain_python(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """As on a machine without Numba."""
    monkeypatch.setitem(sys.modules, "numba", None)
    monkeypatch.delitem(sys.modules, SCALAR, raising=False)
    yield
    sys.modules.pop(SCALAR, None)


def outputs(kernel: str, design: LoopDesign, runs: int = 3) -> list[np.ndarray]:
    """All that can be seen of some outputs: words, errors, falls, 2 pi error."""
    gyro = ClosedLoop(COIL, design, seed=5, runs=runs, kernel=kernel)
    rate, step = np.array([[20.0], [-3.0], [0.01]])[:runs], np.array([[0.0], [700.3], [-50.0]])[:runs]
    blocks = [
        gyro.run(4, output_period_s=1e-3, rate_dps=rate, injected_step=step),
        gyro.run(2, output_period_s=7e-4, rate_dps=lambda t: 30.0 * np.sin(2e3 * t)),
        gyro.run(2, output_period_s=1e-3, injected_step=step * 2, closed=False),
    ]
    seen = [getattr(b, name) for b in blocks for name in ("counts", "normal_error", "reset_error", "reset_pairs")]
    return [*seen, gyro.two_pi_error]


@pytest.mark.parametrize("name", BUILDS)
def test_compiled_kernel_gives_the_bits_of_the_numpy_kernel(name: str) -> None:
    pytest.importorskip("numba", reason="the compiled kernel needs the extra 'fast'")
    for compiled, numpy in zip(outputs("numba", BUILDS[name]), outputs("numpy", BUILDS[name]), strict=True):
        np.testing.assert_array_equal(compiled, numpy)


@pytest.mark.usefixtures("plain_python")
@pytest.mark.parametrize("name", BUILDS)
def test_without_numba_plain_python_gives_the_same_bits(name: str) -> None:
    for plain, numpy in zip(outputs("auto", BUILDS[name]), outputs("numpy", BUILDS[name]), strict=True):
        np.testing.assert_array_equal(plain, numpy)
    assert not importlib.import_module(SCALAR).COMPILED


@pytest.mark.usefixtures("plain_python")
def test_numba_asked_for_but_not_there_is_one_clear_error() -> None:
    with pytest.raises(ValueError, match=r"install gyrolock\[fast\]"):
        ClosedLoop(COIL, LoopDesign(), kernel="numba")


def test_second_loop_is_the_same_in_both_kernels() -> None:
    design = LoopDesign(two_pi_error=0.01, two_pi_loop_gain=0.01)
    auto, numpy = outputs("auto", design), outputs("numpy", design)
    for one, other in zip(auto, numpy, strict=True):
        np.testing.assert_array_equal(one, other)
    assert np.all(numpy[-1] != 0.01)  # it has moved


@pytest.mark.parametrize("name", BUILDS)
def test_loop_is_the_one_that_its_equations_say(name: str) -> None:
    design, n_pairs = BUILDS[name], 600
    for rate, step in ((20.0, 0.0), (-3.0, 700.25)):
        gyro = ClosedLoop(COIL, design, seed=5, kernel="numpy")
        # one sample pair an output
        block = gyro.run(n_pairs, output_period_s=2 * COIL.transit_time, rate_dps=rate, injected_step=step)
        expected = slow_outputs(COIL, design, 5, n_pairs, rate, step)
        np.testing.assert_array_equal(block.counts, expected)
        assert block.reset_pairs.sum() > 2


def test_noise_does_not_depend_on_how_the_time_is_cut_nor_on_the_neighbours() -> None:
    design = LoopDesign()
    whole = ClosedLoop(COIL, design, seed=2, kernel="numpy").run(6, output_period_s=5e-4, rate_dps=5.0)
    cut = ClosedLoop(COIL, design, seed=2, runs=2, kernel="numpy")
    parts = [cut.run(n, output_period_s=5e-4, rate_dps=5.0).counts[0] for n in (1, 3, 2)]
    np.testing.assert_array_equal(whole.counts, np.concatenate(parts))


def test_long_output_is_the_mean_of_short_ones() -> None:
    """An output of more sample pairs than one piece of the computation holds."""
    n = 1 << 19
    pair = 2 * COIL.transit_time
    long = ClosedLoop(COIL, LoopDesign(), seed=3).run(1, output_period_s=n * pair, rate_dps=1.0)
    short = ClosedLoop(COIL, LoopDesign(), seed=3).run(512, output_period_s=n // 512 * pair, rate_dps=1.0)
    assert long.counts[0] == pytest.approx(short.counts.mean(), abs=1e-9)
    assert long.reset_pairs[0] == short.reset_pairs.sum()


def test_moving_rate_goes_on_from_piece_to_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    def words() -> np.ndarray:
        gyro = ClosedLoop(COIL, LoopDesign(), seed=3, kernel="numpy")
        return gyro.run(3, output_period_s=1e-3, rate_dps=lambda t: 1e4 * t).counts

    whole = words()
    monkeypatch.setattr("analysis.fibre_gyro.loop.closed_loop._CHUNK_SAMPLES", 74)
    np.testing.assert_array_equal(words(), whole)


def test_cosine_polynomial_is_the_cosine() -> None:
    turns = np.linspace(-3.0, 3.0, 20_001)
    result, u, w = np.empty((3, turns.size))
    cosine_of_turns(turns, result, u, w)
    np.testing.assert_allclose(result, [math.cos(2 * math.pi * t) for t in turns], atol=2e-13)


def test_settings_out_of_range_and_impossible_requests_are_named() -> None:
    for change, words in (
        ({"dac_bits": 4}, "dac_bits must be from 8 to 18"),
        ({"fractional_bits": 24}, "fractional_bits must be from 0 to 18"),
        ({"injection_path": "third"}, "'shared' or 'separate'"),
        ({"wrap_codes": 40_000}, "within 10 %"),
        ({"two_pi_error": math.nan}, "two_pi_error"),
    ):
        with pytest.raises(ValueError, match=words):
            replace(LoopDesign(), **change)
    gyro = ClosedLoop(COIL, LoopDesign(), kernel="numpy")
    with pytest.raises(ValueError, match="40000 codes is beyond half of the range of a 16-bit converter"):
        gyro.run(1, injected_step=40_000.0)
    with pytest.raises(ValueError, match="output period"):
        gyro.run(1, output_period_s=1e-6)
    with pytest.raises(ValueError, match="number of outputs"):
        gyro.run(0)
    with pytest.raises(ValueError, match="number of runs"):
        ClosedLoop(COIL, LoopDesign(), runs=0)
    with pytest.raises(ValueError, match="kernel"):
        ClosedLoop(COIL, LoopDesign(), kernel="cython")
