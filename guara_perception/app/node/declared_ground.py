"""Decides whether ground that the gait declares may go into the map."""

from __future__ import annotations

import numpy as np

from guara_perception.exceptions import InvalidInput
from guara_perception.settings import Settings
from guara_perception.terrain.map.known_ground import KnownGround
from transport import StancePause

FRAME = "base_footprint"
# Two patches for each of four feet, twice.
MAXIMUM_PATCHES = 16
MAXIMUM_CORNERS = 16
# [m] Far beyond any step; ground outside of the map is clipped.
FURTHEST = 20.0
# [m] Ground with a larger sigma is of no use as known ground.
LARGEST_SIGMA = 0.1


def declared_ground(announcement: StancePause, settings: Settings) -> tuple[KnownGround, ...]:
    """The patches of an announcement, for the map.

    Raises:
        InvalidInput: they are in another frame, or too many, or one of them has too many corners, reaches too far,
            lies where no terrain can be or is known too poorly; none of them may then be used.
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
        low, high = settings.minimum_height, settings.maximum_height
        for what, value, is_allowed, allowed in (
            (
                "number of corners",
                len(patch.outline),
                len(patch.outline) <= MAXIMUM_CORNERS,
                f"up to {MAXIMUM_CORNERS}",
            ),
            ("height [m]", patch.height, low <= patch.height <= high, f"{low:g} to {high:g}"),
            ("sigma [m]", patch.sigma, patch.sigma <= LARGEST_SIGMA, f"up to {LARGEST_SIGMA:g}"),
            ("reach [m]", reach := float(np.abs(patch.outline).max()), reach <= FURTHEST, f"up to {FURTHEST:g}"),
        ):
            if not is_allowed:
                raise InvalidInput(
                    f"a patch of known ground: its {what} is {value:g}; allowed: {allowed}. No patch is used"
                )
    return tuple(KnownGround(patch.outline, patch.height, patch.sigma) for patch in patches)
