"""Replay of a recorded scan as a camera: laser and mirror of an emulated board select the frame."""

from __future__ import annotations

import bisect
from typing import TYPE_CHECKING

import numpy as np

from guara_perception.arrays import Image
from guara_perception.exceptions import InvalidInput
from guara_perception.scan import Scan

if TYPE_CHECKING:
    from drivers.emulator import ExposureView


# Share of an exposure during which the laser must be on for a usable stripe.
LIT_FRACTION = 0.5


class RecordedView:
    """Renderer of an emulated camera that returns the frames of a recorded scan."""

    def __init__(self, scan: Scan) -> None:
        """Read all frames of the scan.

        Raises:
            InvalidInput: the scan has no frame with the laser off.
        """
        frames = sorted(scan.frames(), key=lambda item: item[0].mirror_angle)
        offs = [off for _, _, off in frames if off is not None]
        if not offs:
            raise InvalidInput(f"{scan.source}: the scan has no laser-off frame, which a replay as a camera needs")
        self._angles = [stripe.mirror_angle for stripe, _, _ in frames]
        self._on = [on for _, on, _ in frames]
        self._off = offs[0]
        # Largest distance to a recorded mirror angle; beyond it, the laser plane is outside the recorded stripes.
        self._reach = 0.6 * float(np.diff(self._angles).max()) if len(frames) > 1 else np.inf

    def render(self, view: ExposureView, settings: object) -> Image:
        """Return the recorded frame nearest to the mirror angle, or the laser-off frame."""
        above = bisect.bisect_left(self._angles, view.mirror_angle)
        nearest = min(
            (k for k in (above - 1, above) if 0 <= k < len(self._angles)),
            key=lambda k: abs(self._angles[k] - view.mirror_angle),
        )
        is_near = abs(self._angles[nearest] - view.mirror_angle) <= self._reach
        if view.laser_fraction < LIT_FRACTION or not is_near:
            return self._off
        return self._on[nearest]
