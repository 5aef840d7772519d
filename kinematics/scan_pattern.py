"""Line in which the laser plane meets the floor, by mirror angle, and the angles that sweep an area.

The mirror's axis is parallel to y; at angle 0 the laser plane points along -z, a positive angle turns it towards +x, by
twice the mirror's angle. From a mirror at x_0, h over the floor, it meets the floor at x = x_0 + h tan(2 a).
"""

from __future__ import annotations

import math
from typing import Final

from kinematics.findings import Findings
from kinematics.toml_table import Table

# The scan may miss the area's ends by this much [m]: a cell.
END_TOLERANCE_M: Final = 0.005


def plane_on_floor(mirror_x: float, mirror_height: float, mirror_angle: float) -> float:
    """The x at which the laser plane meets the floor, for a mirror at `mirror_x`, `mirror_height` over it [m]."""
    return mirror_x + mirror_height * math.tan(2.0 * mirror_angle)


def mirror_angle_for(mirror_x: float, mirror_height: float, floor_x: float) -> float:
    """The mirror angle [rad] at which the laser plane meets the floor at `floor_x` [m]."""
    return math.atan2(floor_x - mirror_x, mirror_height) / 2.0


def pattern_misses(root: Table, mirror_x: float, mirror_height: float) -> str | None:
    """Text on the part of the area that the scan pattern of robot.toml misses; None if it sweeps all of it.

    Args:
        root: robot.toml; where table [scan] or [grid.footprint] is absent or malformed, the result is None: the
            packages that use these tables report it.
        mirror_x: x of the mirror's axis in `base_footprint`, in the scan posture [m].
        mirror_height: height of that axis over the floor [m].
    """
    findings = Findings(root.path)
    tables = root.gathering(findings)
    near, far = tables.table("grid").table("footprint").pair("x")
    scan = tables.table("scan")
    angles = (scan.number("mirror_angle_first"), scan.number("mirror_angle_last"))
    if findings.is_wrong:
        return None
    first, last = sorted(plane_on_floor(mirror_x, mirror_height, angle) for angle in angles)
    if first <= near + END_TOLERANCE_M and last >= far - END_TOLERANCE_M:
        return None
    # From just before the area to just past it, as the folder of guara has it.
    wanted = [mirror_angle_for(mirror_x, mirror_height, x) for x in (near - END_TOLERANCE_M, far + END_TOLERANCE_M)]
    return (
        f"the pattern sweeps the floor from x {first:.3f} to {last:.3f} m, the area of [grid.footprint] from "
        f"{near:g} to {far:g}: set mirror_angle_first = {wanted[0]:.3f} and mirror_angle_last = {wanted[1]:.3f} "
        "(atan((x - mirror x) / mirror height) / 2 for both ends)"
    )
