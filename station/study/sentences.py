"""What the study says of the paper's 5 %, cause by cause, in numbers that were just computed."""

from __future__ import annotations

import numpy as np

from analysis.study import Causes
from station.study.study import Study


def study_sentences(study: Study) -> list[str]:
    """Conclude from what was computed."""
    said = []
    for number, errors in study.errors.items():
        plain, hann = (np.abs(errors.by_peaks[name]).max() for name in ("boxcar", "hann"))
        said.append(
            f"Fig. {number}: peaks of the spectrum and equation (13) are wrong by up to {100 * plain:.2g} % "
            f"without a window and {100 * hann:.2g} % with a Hann window; equation (13) alone by up to "
            f"{100 * np.abs(errors.formula).max():.2g} %; the exact method, from the first 2500 of the 60000 "
            f"samples, by {100 * np.abs(errors.ours).max():.0e} %."
        )
    if study.causes is not None:
        said += _five_per_cent(study, study.causes)
    return said


def _five_per_cent(study: Study, causes: Causes) -> list[str]:
    twenty = [place for place, (rate, lock_in) in enumerate(causes.points) if abs(rate / lock_in - 20) < 1e-6]
    formula = 100 * np.abs(causes.formula[twenty]).max()
    readings = {reading.window: reading for reading in study.readings}
    windows = ", ".join(
        f"{name} {100 * readings[window].largest:.2g} % at most and {100 * readings[window].rms:.2g} % rms"
        for window, name in (
            ("boxcar", "without a window"),
            ("hann", "Hann"),
            ("blackmanharris", "Blackman-Harris"),
            ("flattop", "flat top"),
        )
    )
    leakage = 100 * max(float(np.abs(values).max()) for name, values in causes.leakage.items() if name == "boxcar")
    windowed = 100 * max(
        float(np.abs(values).max()) for name, values in causes.leakage.items() if name != "boxcar"
    )
    solvers = [100 * np.abs(values).max() for values in (causes.euler, causes.runge_kutta)]
    return [
        f"The paper's 5 % at 20 times lock-in is not its equation (13): that is wrong by {formula:.2g} % there.",
        "What is left at that rate is the reading of peaks, the beat lying anywhere between two lines and its "
        f"second harmonic elsewhere: {windows}. With a usual window that is, rms, the size of the paper's 5 %.",
        f"Leakage (the skirts of the lines under each other) adds up to {leakage:.2g} % without a window, "
        f"{windowed:.1g} % with one; it is what makes the error depend on the initial phase.",
        f"Nearer to lock-in equation (13) takes over: {100 * causes.formula.min():.4g} % at W = 0.2, WL = 0.15 "
        f"deg/s (Fig. 5), {100 * float(causes.formula[-1]):.3g} % at WL = W/2 (end of Fig. 6). That the error "
        "falls with the rate and grows with the lock-in rate, as the paper says of those figures, is equation "
        "(13); peaks know no such rule.",
        f"A solver that steps at 20 kHz would add up to {solvers[0]:.2g} % (Euler) or {solvers[1]:.2g} % (fourth "
        "order). The paper names neither its window nor its solver.",
        f"Without any of these causes {100 * np.abs(causes.ours).max():.0e} % is left; on the 2500 eight-bit "
        f"points of the oscilloscope, without noise, {100 * causes.rounding.max():.2g} % rms at most.",
    ]
