"""Memory that the C library keeps after it was freed: given back to the system from time to time."""

from __future__ import annotations

import ctypes
import time

# [s] A scan frees 100 MB in pieces that several threads took: kept, they add up over hours.
PERIOD_S = 60.0


class Heap:
    """Gives back what is freed, at most once in PERIOD_S; does nothing without glibc."""

    def __init__(self) -> None:
        """Look for the function of the C library."""
        self._trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        self._last = time.monotonic()

    def trim(self) -> None:
        """Give back what is freed, if the last time is long ago; takes some milliseconds."""
        if self._trim is not None and time.monotonic() - self._last >= PERIOD_S:
            self._trim(0)
            self._last = time.monotonic()
