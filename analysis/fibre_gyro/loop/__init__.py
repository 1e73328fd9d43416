"""Electronics of a closed-loop fibre gyro, simulated: at every transit time of the light, and by output words.

`design` the converters, loop and noise, `registers` what the loop holds in bits, `clock` and `output` what comes
out when, `closed_loop` the simulation on one of two kernels, `output_model` the fast one.
"""

from analysis.fibre_gyro.loop.closed_loop import ClosedLoop, Kernel
from analysis.fibre_gyro.loop.design import LoopDesign, LoopTrace, OutputBlock
from analysis.fibre_gyro.loop.output_model import OutputModel

__all__ = ["ClosedLoop", "Kernel", "LoopDesign", "LoopTrace", "OutputBlock", "OutputModel"]
