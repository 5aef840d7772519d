"""Check of the first frames of a scan for clipping and for a stripe that is too dark."""

from __future__ import annotations

import math

import numpy as np

from drivers.arrays import Image
from drivers.sweep.capture import StripeCapture
from drivers.sweep.metering import brightness_of

# Stride of the sampled background pixels, along rows and columns.
INTERVAL = 8
# Fraction of full scale at which a pixel counts as clipped.
CLIPPED = 0.996
# Allowed fraction of clipped background pixels; in a well-exposed image, lamps and reflections clip fewer.
CLIPPED_PICTURE = 0.05
# Allowed fraction of clipped stripe columns. Bright floors clip three quarters of the columns and are still measured
# well.
CLIPPED_STRIPE = 0.85
# Least stripe brightness, as a fraction of full scale. A darker stripe is close to the noise of cheap cameras; metering
# aims at 0.7.
DARK_STRIPE = 0.1
# Largest number of stripes examined until one shows the laser; over holes and black ground, none does.
MOST_STRIPES = 4
WHAT_TO_DO = "(`guara record` meters the exposure and writes it to devices.toml)"


class LightCheck:
    """Light check on the first stripes of a scan.

    Attributes:
        problems: descriptions of problems, each with a remedy.
    """

    def __init__(self) -> None:
        """Start without problems."""
        self.problems: tuple[str, ...] = ()
        self._examined = 0
        self._has_background = False

    def look(self, capture: StripeCapture, rows: tuple[int, int]) -> None:
        """Check a stripe, unless enough stripes have been checked.

        Args:
            capture: next stripe of the scan.
            rows: image rows (first, end) in which the stripe can appear; (0, 0) if the stripe is out of view.
        """
        if self._examined >= MOST_STRIPES or capture.on is None:
            return
        if not self._has_background:
            self._has_background = True
            self._add(_background_problem(capture.on if capture.off is None else capture.off))
        first, end = rows
        if end <= first or capture.off is None or capture.off.shape != capture.on.shape:
            return
        self._examined += 1
        brightness = brightness_of(capture.on[first:end], capture.off[first:end])
        if math.isnan(brightness.ridge):
            return
        self._examined = MOST_STRIPES
        if brightness.clipped > CLIPPED_STRIPE:
            self._add(
                f"light: {100 * brightness.clipped:.0f} % of the stripe is clipped: expose less or close the iris "
                f"{WHAT_TO_DO}"
            )
        elif brightness.ridge < DARK_STRIPE:
            self._add(
                f"light: the stripe is at {100 * brightness.ridge:.0f} % of the full scale, too dark: expose longer, "
                f"open the iris or raise the gain {WHAT_TO_DO}"
            )

    def _add(self, problem: str) -> None:
        if problem:
            self.problems = (*self.problems, problem)


def _background_problem(picture: Image) -> str:
    thin = picture[::INTERVAL, ::INTERVAL]
    limit = CLIPPED * np.iinfo(thin.dtype).max
    clipped = thin >= limit
    share = float(np.mean(clipped.any(axis=2) if clipped.ndim == 3 else clipped))
    if share <= CLIPPED_PICTURE:
        return ""
    return (
        f"light: {100 * share:.0f} % of the picture is clipped without the laser, so no stripe is visible there: shade "
        f"the scene or expose less {WHAT_TO_DO}"
    )
