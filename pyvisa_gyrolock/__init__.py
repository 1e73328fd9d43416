"""The simulated oscilloscope as a PyVISA backend: ``pyvisa.ResourceManager("@gyrolock")``.

A program that knows nothing of this package uses it when PYVISA_LIBRARY is ``@gyrolock``. The instrument answers
as ``GPIB0::1::INSTR``, ``USB0::0x0699::0x0368::C010101::INSTR`` and ``ASRL1::INSTR``, with sines of 1 kHz
at channels 1 and 2 that stand well on the screen with factory settings. Before the ``@`` another model of the
family may stand: ``TDS2024B@gyrolock``.
"""

from pyvisa.util import DebugInfo, LibraryPath

from instrument.simulated import SimulatedTDS2014
from instrument.simulated.links.visa_library import DEFAULT_NAMES, SimulatedVisaLibrary, demonstration_signals

DEFAULT_MODEL = "TDS2014"
RESOURCE_NAMES = (*DEFAULT_NAMES, "ASRL1::INSTR")


class GyrolockVisaLibrary(SimulatedVisaLibrary):
    """A simulated bench with one oscilloscope; the library path is the name of its model."""

    @staticmethod
    def get_library_paths() -> tuple[LibraryPath, ...]:
        """The default model."""
        return (LibraryPath(DEFAULT_MODEL, "simulated"),)

    @staticmethod
    def get_debug_info() -> DebugInfo:
        """What ``pyvisa-info`` prints about this backend."""
        return {"Instruments": ", ".join(RESOURCE_NAMES)}

    def _init(self) -> None:
        super()._init()
        model = str(self.library_path)
        try:
            scope = SimulatedTDS2014(demonstration_signals(), model=model)
        except ValueError as error:
            # PyVISA's word for a library that cannot be opened.
            raise OSError(str(error)) from None
        self.connect(dict.fromkeys(RESOURCE_NAMES, scope))


WRAPPER_CLASS = GyrolockVisaLibrary
"""Where PyVISA looks for the backend."""

__all__ = ["WRAPPER_CLASS", "GyrolockVisaLibrary"]
