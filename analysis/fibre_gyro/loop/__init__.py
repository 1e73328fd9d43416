"""Electronics of a closed-loop fibre gyro, simulated: at every transit time of the light, and by output words."""

from analysis.fibre_gyro.loop.closed_loop import ClosedLoop, Kernel
from analysis.fibre_gyro.loop.design import LoopDesign, LoopTrace, OutputBlock
from analysis.fibre_gyro.loop.output_model import OutputModel
