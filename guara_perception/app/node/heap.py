"""Trimming of the C library's heap: freed memory is returned to the system."""

from __future__ import annotations

import ctypes
import time

# [s] Shortest interval between two trims. A scan frees 100 MB in pieces allocated by several threads. If the C library
# keeps these pieces, they accumulate over hours.
PERIOD_S = 60.0


class Heap:
    """Heap of the C library, trimmed at most once in PERIOD_S. Without glibc, nothing is done."""

    def __init__(self) -> None:
        """Look up `malloc_trim` in the C library."""
        self._trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        self._last = time.monotonic()

    def trim(self) -> None:
        """Return freed memory to the system, at most once in PERIOD_S; takes a few milliseconds."""
        if self._trim is not None and time.monotonic() - self._last >= PERIOD_S:
            self._trim(0)
            self._last = time.monotonic()
