"""Intersection of the laser plane with the floor at a mirror angle, and the mirror angles that sweep an area.

The mirror's axis is parallel to y. At angle 0 the laser plane points along -z; a mirror angle a turns the plane by 2 a
towards +x. With the mirror at x_0 and height h above the floor, the plane meets the floor at x = x_0 + h tan(2 a).
"""

from __future__ import annotations

import math
from typing import Final

from kinematics.findings import Findings
from kinematics.toml_table import Table

# Tolerance at both ends of the area [m]: one cell.
END_TOLERANCE_M: Final = 0.005


def plane_on_floor(mirror_x: float, mirror_height: float, mirror_angle: float) -> float:
    """Position x at which the laser plane meets the floor [m]; `mirror_height` is the height above the floor."""
    return mirror_x + mirror_height * math.tan(2.0 * mirror_angle)


def mirror_angle_for(mirror_x: float, mirror_height: float, floor_x: float) -> float:
    """Mirror angle [rad] at which the laser plane meets the floor at `floor_x` [m]."""
    return math.atan2(floor_x - mirror_x, mirror_height) / 2.0


def pattern_misses(root: Table, mirror_x: float, mirror_height: float) -> str | None:
    """Describe by how much the scan pattern of robot.toml misses the area; None if it covers all of the area.

    Args:
        root: content of robot.toml. The result is None if the table [scan] or [grid.footprint] is missing or invalid,
            which is reported by the packages that use these tables.
        mirror_x: x of the mirror's axis in `base_footprint`, in the scan posture [m].
        mirror_height: height of the mirror's axis above the floor, in the scan posture [m].
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
    # The suggested angles sweep from just before the area to just past it, as in the stock robot guara.
    wanted = [mirror_angle_for(mirror_x, mirror_height, x) for x in (near - END_TOLERANCE_M, far + END_TOLERANCE_M)]
    return (
        f"the pattern sweeps x = {first:.3f} to {last:.3f} m of the floor, but [grid.footprint] extends from "
        f"{near:g} to {far:g} m: set mirror_angle_first = {wanted[0]:.3f} and mirror_angle_last = {wanted[1]:.3f} "
        "(atan((x - mirror x) / mirror height) / 2 for both ends)"
    )
