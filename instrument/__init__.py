"""Drivers for the bench: the TDS2014 oscilloscope family, its files, and the rate table.

`TDS2014` gives records as `Waveform`; `read_waveform` reads the files that these scopes write.

What it offers is declared in `__init__.pyi`; a name is imported when it is first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
