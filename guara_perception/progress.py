"""Type of callbacks that report the progress of a long computation."""

from __future__ import annotations

from collections.abc import Callable

# Called with the amount of work done and the total, in the same unit, such as stripes, images or pauses.
Progress = Callable[[int, int], None]
