"""How work that takes long says how far it has come: one kind of callback everywhere."""

from __future__ import annotations

from collections.abc import Callable

# Called with what is done and with all there is to do, in the same unit: stripes, pictures, pauses.
Progress = Callable[[int, int], None]
