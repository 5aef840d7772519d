"""Type of the callbacks that report the progress of long work."""

from __future__ import annotations

from collections.abc import Callable

# Called with the work done and the total, in the same unit: stripes, pictures, pauses.
Progress = Callable[[int, int], None]
