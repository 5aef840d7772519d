"""Check of ground declared by the gait, before it is entered into the map."""

from __future__ import annotations

import numpy as np

from guara_perception.exceptions import InvalidInput
from guara_perception.settings import Settings
from guara_perception.terrain.map.known_ground import KnownGround
from transport import StancePause

FRAME = "base_footprint"
# Largest number of patches: four for each of four feet.
MAXIMUM_PATCHES = 16
MAXIMUM_CORNERS = 16
# [m] Largest absolute coordinate of a corner, far beyond any stride. Ground outside the map is clipped.
FURTHEST = 20.0
# [m] Largest sigma of known ground.
LARGEST_SIGMA = 0.1


def declared_ground(announcement: StancePause, settings: Settings) -> tuple[KnownGround, ...]:
    """Convert the declared ground of an announcement to known ground for the map.

    Raises:
        InvalidInput: the patches are in another frame or too many, or a patch has too many corners, is too far away, is
            outside the height limits, or has too large a sigma. If one patch is invalid, none is used.
    """
    patches = announcement.known_ground
    if not patches:
        return ()
    if announcement.frame_id != FRAME:
        raise InvalidInput(
            f"known ground is declared in frame {announcement.frame_id!r}; allowed: {FRAME!r}. It is not used"
        )
    if len(patches) > MAXIMUM_PATCHES:
        raise InvalidInput(
            f"known ground has {len(patches)} patches; allowed: up to {MAXIMUM_PATCHES}. None of them is used"
        )
    for patch in patches:
        for name, value, low, high in (
            ("number of corners", len(patch.outline), 3, MAXIMUM_CORNERS),
            ("height [m]", patch.height, settings.minimum_height, settings.maximum_height),
            ("sigma [m]", patch.sigma, 0.0, LARGEST_SIGMA),
            ("largest absolute coordinate [m]", float(np.abs(patch.outline).max()), 0.0, FURTHEST),
        ):
            if not low <= value <= high:
                raise InvalidInput(
                    f"a patch of known ground: its {name} is {value:g}; allowed: {low:g} to {high:g}. No patch is used"
                )
    return tuple(KnownGround(patch.outline, patch.height, patch.sigma) for patch in patches)
