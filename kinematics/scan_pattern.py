"""Where the laser's sheet falls on the floor for a mirror angle, and the angles that sweep an area.

The mirror's axis is parallel to y; at angle 0 the sheet falls along -z, a positive angle turns it towards +x, by twice
the mirror's angle. From a mirror at x_0, h over the floor, it falls at x = x_0 + h tan(2 a).
"""

from __future__ import annotations

import math


def sheet_on_floor(mirror_x: float, mirror_height: float, mirror_angle: float) -> float:
    """The x [m] at which the sheet meets the floor, for a mirror at `mirror_x`, `mirror_height` over the floor [m]."""
    return mirror_x + mirror_height * math.tan(2.0 * mirror_angle)


def mirror_angle_for(mirror_x: float, mirror_height: float, floor_x: float) -> float:
    """The mirror angle [rad] at which the sheet meets the floor at `floor_x` [m]."""
    return math.atan2(floor_x - mirror_x, mirror_height) / 2.0
