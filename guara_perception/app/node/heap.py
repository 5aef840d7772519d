"""Return of freed memory from the C library to the system."""

from __future__ import annotations

import ctypes
import time

# [s] Least time between two returns. A scan frees 100 MB in pieces allocated by several threads; if the C library keeps
# them, they add up over hours.
PERIOD_S = 60.0


class Heap:
    """Heap of the C library, trimmed at most once in PERIOD_S; does nothing without glibc."""

    def __init__(self) -> None:
        """Look for the function of the C library."""
        self._trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        self._last = time.monotonic()

    def trim(self) -> None:
        """Return freed memory to the system, unless done within the last PERIOD_S; takes some milliseconds."""
        if self._trim is not None and time.monotonic() - self._last >= PERIOD_S:
            self._trim(0)
            self._last = time.monotonic()
