"""How good a calibration is: figures with limits, a verdict and the reasons for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

GOOD, USABLE, REFUSED = "good", "usable", "refused"


@dataclass(frozen=True, slots=True)
class Check:
    """One figure of merit.

    Attributes:
        name: short text, key of the figure in the file.
        value: what was found, in `unit`; NaN where it could not be computed.
        unit: unit of `value`, as text for people.
        usable_from: limit between good and usable.
        refused_from: limit between usable and refused.
        meaning: one sentence for somebody who never calibrated a camera.
        advice: what to do when it is not good.
        higher_is_better: which way the limits are read.
    """

    name: str
    value: float
    unit: str
    usable_from: float
    refused_from: float
    meaning: str
    advice: str
    higher_is_better: bool = False

    @property
    def verdict(self) -> str:
        """The verdict of this figure alone; one that could not be computed makes the calibration usable, not good."""
        if np.isnan(self.value):
            return USABLE
        sign = -1.0 if self.higher_is_better else 1.0
        if sign * self.value > sign * self.refused_from:
            return REFUSED
        return USABLE if sign * self.value > sign * self.usable_from else GOOD

    @property
    def reason(self) -> str:
        """Why the verdict is not good."""
        if np.isnan(self.value):
            return f"{self.name} could not be computed: {self.advice}"
        limit = self.refused_from if self.verdict == REFUSED else self.usable_from
        side = "below" if self.higher_is_better else "above"
        return f"{self.name} is {self.value:.3g} {self.unit}, {side} {limit:.3g}: {self.advice}"


def verdict_of(checks: Sequence[Check], warnings: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """Verdict and reasons of all figures together: the worst decides.

    Args:
        checks: all figures.
        warnings: faults that were mended (an outlier view left out, a stripe filled in); they leave it usable.
    """
    verdicts = [check.verdict for check in checks]
    reasons = [check.reason for check in checks if check.verdict == REFUSED]
    reasons += [check.reason for check in checks if check.verdict == USABLE]
    reasons += list(warnings)
    if REFUSED in verdicts:
        return REFUSED, tuple(reasons)
    return (USABLE if USABLE in verdicts or warnings else GOOD), tuple(reasons)


def quality_record(checks: Sequence[Check], verdict: str, reasons: Sequence[str]) -> dict[str, Any]:
    """The `quality` object of calibration.json."""
    return {
        "verdict": verdict,
        "reasons": list(reasons),
        "figures": [
            {
                "name": check.name,
                "value": None if np.isnan(check.value) else round(float(check.value), 6),
                "unit": check.unit,
                "usable_from": check.usable_from,
                "refused_from": check.refused_from,
                "verdict": check.verdict,
            }
            for check in checks
        ],
    }
