"""A digital closed-loop fibre gyro: its models, and what a rate table and an injected staircase say of its scale.

`coil` the optics, `loop` the electronics (simulated at every transit time, and by output words), `staircase` the
modulator's drive on an oscilloscope; the rest evaluates runs.
"""

from analysis.fibre_gyro.allan import (
    AllanCurve,
    NoiseFit,
    allan_curve,
    allan_variance,
    fit_noise,
    window_covariance,
)
from analysis.fibre_gyro.bias.over_temperature import (
    Candidate,
    OverTemperature,
    fit_over_temperature,
    temperature_course,
)
from analysis.fibre_gyro.bias.small_rates import (
    Edge,
    Ladder,
    References,
    Responses,
    SmallRates,
    plan_ladder,
    refined,
    responses,
    small_rates,
)
from analysis.fibre_gyro.bias.turn_on import Repeatability, TurnOn, repeatability, turn_on_transient
from analysis.fibre_gyro.coil import FibreCoil
from analysis.fibre_gyro.fixed_point import LONGEST_WORD, FixedPoint, round_to_words
from analysis.fibre_gyro.loop import ClosedLoop, Kernel, LoopDesign, OutputBlock, OutputModel, Trace
from analysis.fibre_gyro.merit import (
    ResidualPattern,
    ScaleFigures,
    repeatability_ppm,
    residual_pattern,
    scale_figures,
    temperature_coefficient_ppm,
)
from analysis.fibre_gyro.rate_table.axis_fit import (
    AxisFit,
    bias_at_latitude,
    correlation_with_numbers,
    fit_axis,
    horizontal_earth_rate_dps,
    vertical_earth_rate_dph,
)
from analysis.fibre_gyro.rate_table.input_axis import InputAxisTilt, ThreeAxes, fit_three_axes, input_axis_tilt
from analysis.fibre_gyro.rate_table.linearity import Linearity, scale_linearity
from analysis.fibre_gyro.rate_table.odd_even import OddEven, RateDifferences, odd_even_parts, rate_differences
from analysis.fibre_gyro.rate_table.scatter import (
    NORMAL_95,
    RunScatter,
    few_values_factor,
    find_run_scatter,
)
from analysis.fibre_gyro.rate_table.table_runs import TableRuns, missing_senses, table_runs
from analysis.fibre_gyro.rate_table.whole_turns import check_whole_turns, turn_time, whole_turns_in
from analysis.fibre_gyro.rate_table.window_mean import (
    WindowMean,
    mean_at_rest,
    mean_over_turns,
    noise_of_means,
    pooled_noise,
)
from analysis.fibre_gyro.staircase import (
    StaircaseWitness,
    describe_witness_flag,
    rounding_left,
    two_pi_error_of_drive,
    witness_staircase,
)
from analysis.fibre_gyro.staircase_calibration import (
    InjectionPlan,
    NetOutputs,
    ScaleComparison,
    SlopeFit,
    compare_scale,
    fit_slope,
    largest_step,
    net_outputs,
    predicted_difference_ppm,
    predicted_self_scale,
    predicted_table_scale,
    scaled_numbers,
    steps_beyond_dac,
    superposed_numbers,
)
from analysis.fibre_gyro.static_output import StaticLevel, drift_in_slope, static_level
from analysis.fibre_gyro.two_pi_error import TwoPiError, estimate_two_pi_error

__all__ = [
    "LONGEST_WORD",
    "NORMAL_95",
    "AllanCurve",
    "AxisFit",
    "Candidate",
    "ClosedLoop",
    "Edge",
    "FibreCoil",
    "FixedPoint",
    "InjectionPlan",
    "InputAxisTilt",
    "Kernel",
    "Ladder",
    "Linearity",
    "LoopDesign",
    "NetOutputs",
    "NoiseFit",
    "OddEven",
    "OutputBlock",
    "OutputModel",
    "OverTemperature",
    "RateDifferences",
    "References",
    "Repeatability",
    "ResidualPattern",
    "Responses",
    "RunScatter",
    "ScaleComparison",
    "ScaleFigures",
    "SlopeFit",
    "SmallRates",
    "StaircaseWitness",
    "StaticLevel",
    "TableRuns",
    "ThreeAxes",
    "Trace",
    "TurnOn",
    "TwoPiError",
    "WindowMean",
    "allan_curve",
    "allan_variance",
    "bias_at_latitude",
    "check_whole_turns",
    "compare_scale",
    "correlation_with_numbers",
    "describe_witness_flag",
    "drift_in_slope",
    "estimate_two_pi_error",
    "few_values_factor",
    "find_run_scatter",
    "fit_axis",
    "fit_noise",
    "fit_over_temperature",
    "fit_slope",
    "fit_three_axes",
    "horizontal_earth_rate_dps",
    "input_axis_tilt",
    "largest_step",
    "mean_at_rest",
    "mean_over_turns",
    "missing_senses",
    "net_outputs",
    "noise_of_means",
    "odd_even_parts",
    "plan_ladder",
    "pooled_noise",
    "predicted_difference_ppm",
    "predicted_self_scale",
    "predicted_table_scale",
    "rate_differences",
    "refined",
    "repeatability",
    "repeatability_ppm",
    "residual_pattern",
    "responses",
    "round_to_words",
    "rounding_left",
    "scale_figures",
    "scale_linearity",
    "scaled_numbers",
    "small_rates",
    "static_level",
    "steps_beyond_dac",
    "superposed_numbers",
    "table_runs",
    "temperature_coefficient_ppm",
    "temperature_course",
    "turn_on_transient",
    "turn_time",
    "two_pi_error_of_drive",
    "vertical_earth_rate_dph",
    "whole_turns_in",
    "window_covariance",
    "witness_staircase",
]
