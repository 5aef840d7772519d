"""Failed tests, and the base class of yes/no answers that list them."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Reason:
    """Failed test.

    Attributes:
        test: name of the test, for instance "slope".
        value: measured value, in `unit`; NaN if there is none, printed as "impossible".
        limit: allowed value, in `unit`.
        unit: "m", "rad", "cells", "share" ...
        detail: further text, such as the position; may be empty.
    """

    test: str
    value: float
    limit: float
    unit: str
    detail: str = ""

    def __str__(self) -> str:
        """Text with values in millimetres, degrees and per cent."""
        units = {"m": (1e3, "mm"), "rad": (math.degrees(1), "deg"), "share": (1e2, "%")}
        scale, unit = units.get(self.unit, (1.0, self.unit))
        # Three digits, and whole numbers such as 2106 cells rather than 2.11e+03.
        value, limit = (
            f"{each:.3g}" if abs(each) < 1e3 else f"{each:.0f}" for each in (self.value * scale, self.limit * scale)
        )
        found = f"{value} {unit}, allowed {limit} {unit}"
        text = f"{self.test} {'impossible' if math.isnan(self.value) else found}"
        return f"{text} ({self.detail})" if self.detail else text


class Verdict:
    """Base class of answers that are either yes, or no with reasons.

    Attributes:
        ok: True for yes.
        reasons: each failed test with value and limit; empty if ok.
    """

    __slots__ = ()

    ok: bool
    reasons: tuple[Reason, ...]

    def __bool__(self) -> bool:
        return self.ok

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self})"

    def __str__(self) -> str:
        """Text with values in millimetres, degrees and per cent."""
        return self._ok_text() if self.ok else f"refused: {'; '.join(map(str, self.reasons))}"

    def _ok_text(self) -> str:
        return "ok"
