"""Mathematics of the lock-in measurement, on arrays: no files, no instruments, no clock, no printing.

An *estimate* is what each record says, in arrays of the shape of the records.
A *fit* is one statement that many records make together.

What it offers is declared in `__init__.pyi`; a name is imported when it is first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
