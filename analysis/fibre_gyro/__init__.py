"""A digital closed-loop fibre gyro: what a table, an injected staircase and a log say of it.

`loop` simulates the electronics; a file beside it is a question.
"""

from analysis.fibre_gyro.allan import AllanCurve, NoiseFit, allan_curve, deviation_of_means, fit_noise
from analysis.fibre_gyro.figures_of_merit import (
    ResidualPattern,
    ScaleFigures,
    residual_pattern,
    scale_figures,
    temperature_coefficient_ppm,
)
from analysis.fibre_gyro.injection import (
    FixedPoint,
    InjectionPlan,
    NetOutputs,
    ScaleComparison,
    SlopeFit,
    StaticLevel,
    TwoPiError,
    compare_scale,
    drift_in_slope,
    estimate_two_pi_error,
    fit_slope,
    largest_step,
    predicted_difference_ppm,
    predicted_self_scale,
    predicted_table_scale,
    round_to_words,
    scaled_numbers,
    static_level,
    steps_beyond_dac,
    superposed_numbers,
)
from analysis.fibre_gyro.largest_rate import InputRange, RangeEnd, Recovery, input_range, recovery
from analysis.fibre_gyro.loop import ClosedLoop, Kernel, LoopDesign, LoopTrace, OutputBlock, OutputModel
from analysis.fibre_gyro.loop.design import FibreCoil
from analysis.fibre_gyro.noise_terms import (
    allan_variance,
    averaged_periodogram,
    noise_spectrum,
    sinusoid_variance,
    window_covariance,
)
from analysis.fibre_gyro.rate_table import (
    LADDER_TERMS,
    AxisFit,
    InputAxisTilt,
    Linearity,
    OddEven,
    RateDifferences,
    TableRuns,
    ThreeAxes,
    bias_at_latitude,
    correlation_with_numbers,
    fit_axis,
    fit_three_axes,
    horizontal_earth_rate_dps,
    input_axis_tilt,
    missing_senses,
    odd_even_parts,
    rate_differences,
    scale_linearity,
    table_runs,
    vertical_earth_rate_dph,
)
from analysis.fibre_gyro.response import (
    FilterResponse,
    SinePoint,
    StepTrain,
    sine_point,
    sine_response,
    step_response,
)
from analysis.fibre_gyro.scatter import RunScatter, few_values_factor, find_run_scatter
from analysis.fibre_gyro.sensitivity import StimulusResponse, stimulus_response, tumble
from analysis.fibre_gyro.staircase import (
    StaircaseWitness,
    describe_witness_flag,
    rounding_left,
    two_pi_error_of_drive,
    witness_staircase,
)
from analysis.fibre_gyro.temperature import OverTemperature, fit_over_temperature, temperature_course
from analysis.fibre_gyro.threshold import (
    Edge,
    Ladder,
    References,
    Responses,
    SmallRates,
    plan_ladder,
    refined,
    responses,
    slopes_beyond,
    small_rates,
)
from analysis.fibre_gyro.turn_on import Repeatability, TurnOn, repeatability, turn_on_transient
from analysis.fibre_gyro.window_mean import (
    WindowMean,
    check_whole_turns,
    mean_at_rest,
    mean_over_turns,
    noise_of_means,
    pooled_noise,
    turn_by_encoder,
    turn_time,
    whole_turns_in,
)
