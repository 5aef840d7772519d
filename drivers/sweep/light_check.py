"""Check of a scan's first frames for light that is clipped or too dark."""

from __future__ import annotations

import math

import numpy as np

from drivers.arrays import Image
from drivers.sweep.capture import StripeCapture
from drivers.sweep.metering import brightness_of

# Stride, in rows and in columns, between the pixels of the background that are examined.
INTERVAL = 8
# From this share of the scale on a pixel counts as clipped.
CLIPPED = 0.996
# Lamps and their reflections clip less than this share of a picture that is otherwise well exposed.
CLIPPED_PICTURE = 0.05
# Share of the columns that show the stripe. Bright floors clip three quarters of them and are still measured well.
CLIPPED_STRIPE = 0.85
# Share of the full scale; a stripe below it is hardly brighter than the noise of cheap cameras. Metering aims at 0.7.
DARK_STRIPE = 0.1
# Stripes to examine until one shows the laser; holes and black ground show none.
MOST_STRIPES = 4
WHAT_TO_DO = "(`guara record` meters it and writes it as exposure in devices.toml)"


class LightCheck:
    """Judges the light of one scan by its first stripes; later ones cost nothing.

    Attributes:
        problems: what is wrong with the light, each in one sentence with what to do.
    """

    def __init__(self) -> None:
        """Start without stripes."""
        self.problems: tuple[str, ...] = ()
        self._examined = 0
        self._has_background = False

    def look(self, capture: StripeCapture, rows: tuple[int, int]) -> None:
        """Check a stripe, unless enough have been checked.

        Args:
            capture: the next stripe of the scan.
            rows: (first, end) between which the stripe can lie; (0, 0) when it cannot be in view.
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
        f"light: {100 * share:.0f} % of the picture is clipped without the laser, where no stripe can be seen: shade "
        f"the scene or expose less {WHAT_TO_DO}"
    )
