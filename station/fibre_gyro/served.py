"""The simulated gyro behind a serial port, for practice and for tests: the model of the output words as frames."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import OutputModel
from analysis.rotation import EARTH_RATE_DPS
from instrument.fibre_gyro import FrameFormat, counts_per_unit
from instrument.simulated.fibre_gyro import PtyGyroServer, TcpGyroServer
from station.errors import UsageError
from station.fibre_gyro.bench import as_the_gyro_sees, loop_settings
from station.fibre_gyro.settings import FogSettings


class ServedGyro:
    """What a gyro server asks for numbers: output words of the settings' gyro at a rate that can be changed."""

    def __init__(self, settings: FogSettings, interval_s: float) -> None:
        self.rate_dps = 0.0
        self.temperature_c = settings.figures.reference_temperature_c
        self._settings, self._interval_s = settings, interval_s
        simulation = settings.simulation
        self._loop = loop_settings(settings)
        coil = settings.coil.scaled(1 + 1e-6 * simulation.scale_change_ppm)
        self._model = OutputModel(coil, self._loop, simulation.seed)
        self._earth = EARTH_RATE_DPS * np.sin(np.deg2rad(settings.site.latitude_deg))
        self._step, self._held = 0.0, False

    def noise_from(self, number: int) -> None:
        """Begin anew with other noise, for one of several gyros."""
        coil = self._settings.coil.scaled(1 + 1e-6 * self._settings.simulation.scale_change_ppm)
        self._model = OutputModel(coil, self._loop, self._settings.simulation.seed + number)

    def samples(self, count: int) -> Mapping[str, NDArray[np.float64]]:
        """The next output words, in counts."""
        block = self._model.run(
            count,
            output_period_s=self._interval_s,
            rate_dps=as_the_gyro_sees(np.array(self.rate_dps + self._earth), self._settings),
            injected_step=self._step,
            closed=not self._held,
        )
        gyro = self._settings.gyro
        resolution = gyro.output_resolution or 1.0
        counts = resolution * np.round(gyro.counts_per_code * block.counts / resolution)
        return {
            "counts": counts,
            "temperature": np.full(count, self.temperature_c),
            "normal_error": np.nan_to_num(block.normal_error),
            "reset_error": np.nan_to_num(block.reset_error),
        }

    def command(self, name: str, step: float) -> None:
        """Inject, hold the feedback, open or close the loop; ValueError for a step beyond the converter."""
        if name != "inject":
            self._held = name != "close_loop"
        elif abs(step) > self._loop.largest_step:
            raise ValueError(f"a step of {step:g} codes is beyond the converter")
        else:
            self._step = step


class SpokenAs:
    """A served gyro whose outputs are named, and in the unit, as a frame format has them."""

    # Of several outputs that of the table's last axis sees its rate, the others are gyros at rest.

    def __init__(self, gyro: ServedGyro, settings: FogSettings, layout: FrameFormat) -> None:
        self._gyro = gyro
        self._unit = 1.0
        if layout.unit != "counts":
            self._unit = 1 / counts_per_unit(layout.unit, layout.interval_s, settings.nominal_scale_factor)
        turned = layout.output_of(settings.table.axes[-1])
        self._turned = turned
        self._others = {name: ServedGyro(settings, layout.interval_s) for name in layout.outputs if name != turned}
        for number, other in enumerate(self._others.values(), start=1):
            other.noise_from(number)

    def samples(self, count: int) -> Mapping[str, NDArray[np.float64]]:
        """The next output words of all gyros."""
        made = dict(self._gyro.samples(count))
        made[self._turned] = self._unit * made.pop("counts")
        for name, other in self._others.items():
            made[name] = self._unit * other.samples(count)["counts"]
        return made

    def command(self, name: str, step: float) -> None:
        """What the gyro on the table is told; ValueError as there."""
        self._gyro.command(name, step)


@contextmanager
def serve_gyro(
    settings: FogSettings,
    layout: FrameFormat,
    *,
    tcp_port: int | None = None,
    speed: float = 1.0,
    rate_dps: float = 0.0,
    clock_ppm: float = 0.0,
) -> Iterator[PtyGyroServer | TcpGyroServer]:
    """Serve the simulated gyro until the context ends."""
    gyro = ServedGyro(settings, layout.interval_s)
    gyro.rate_dps = rate_dps
    model = SpokenAs(gyro, settings, layout)
    try:
        if tcp_port is None:
            server: PtyGyroServer | TcpGyroServer = PtyGyroServer(model, layout, speed=speed, clock_ppm=clock_ppm)
        else:
            server = TcpGyroServer(model, layout, tcp_port=tcp_port, speed=speed, clock_ppm=clock_ppm)
    except OSError as error:
        raise UsageError(f"the simulated gyro cannot be served: {error.strerror or error}") from None
    with server:
        yield server
