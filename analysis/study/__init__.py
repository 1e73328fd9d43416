"""The simulations of Zhan et al., Acta Optica Sinica 29, 960 (2009), beside the exact method."""

from analysis.study.causes import Causes, PeakReading, find_causes, peak_readings
from analysis.study.experiment import PAPER, ExperimentCauses, find_experiment_causes
from analysis.study.formula_bias import BiasTable, bias_table
from analysis.study.paper_figures import (
    ErrorStudy,
    WaveformStudy,
    lock_in_study,
    phase_study,
    rate_study,
    waveform_study,
)

__all__ = [
    "PAPER",
    "BiasTable",
    "Causes",
    "ErrorStudy",
    "ExperimentCauses",
    "PeakReading",
    "WaveformStudy",
    "bias_table",
    "find_causes",
    "find_experiment_causes",
    "lock_in_study",
    "peak_readings",
    "phase_study",
    "rate_study",
    "waveform_study",
]
