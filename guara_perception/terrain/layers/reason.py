"""Why something was refused: one failed test with its value and its limit."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Reason:
    """A failed test.

    Attributes:
        test: name of the test, for instance "slope".
        value: what was found, in `unit`.
        limit: what is allowed, in `unit`.
        unit: "m", "rad", "cells", "share" ...
        detail: further text, such as where; may be empty.
    """

    test: str
    value: float
    limit: float
    unit: str
    detail: str = ""

    def __str__(self) -> str:
        """Text for people, in millimetres and degrees."""
        scale, unit = {"m": (1e3, "mm"), "rad": (57.29577951308232, "deg")}.get(self.unit, (1.0, self.unit))
        if math.isnan(self.value):
            return f"{self.test} impossible" + (f" ({self.detail})" if self.detail else "")
        text = f"{self.test} {self.value * scale:.3g} {unit}, allowed {self.limit * scale:.3g} {unit}"
        return f"{text} ({self.detail})" if self.detail else text
