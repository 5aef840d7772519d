"""Feet on the ground measure it: each supporting sole corrects, confirms or disputes the cells under it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.fuse_heights import Drift, Heights, fuse_heights
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.look import LOOKED_AT
from guara_perception.terrain.odom_cells import Index, OdomCells

if TYPE_CHECKING:
    from kinematics import RobotModel

Float = npt.NDArray[np.float64]

# A sole stands on the highest ground under it; what lies deeper than this below the top does not carry it.
BEARING_M = 0.004
# Ground under a sole that no scan saw may lie lower than the sole by so much (a sigma).
UNSEEN_RELIEF_M = 0.003
# From this share of the sole known on, its height can be compared with the map's.
COMPARED_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class FootMeasurement:
    """A supporting sole.

    Attributes:
        leg: its name.
        centre: (3,) sole centre in odom [m].
        variance: of its height [m^2].
        place, distance: cells of the map that lie wholly under it, and their distance from the robot [m].
    """

    leg: str
    centre: Float
    variance: float
    place: Index
    distance: Float


def support_feet(
    cells: OdomCells,
    robot: RobotModel,
    terrain: TerrainGrid,
    transform_footprint_to_odom: Float,
    limits: TraversabilityLimits,
) -> list[FootMeasurement]:
    """The supporting soles of the stance at which a scan was taken; none where its metadata holds no stance."""
    from kinematics import Stance
    from kinematics.stance_pose import sole_covariances

    stance_fields, to_footprint = (terrain.metadata.get(n) for n in ("stance", "transform_base_to_footprint"))
    if stance_fields is None or to_footprint is None:
        return []
    stance = Stance.from_dict(stance_fields)
    legs = list(terrain.metadata.get("support_feet_used", stance.support_feet))
    state = robot.state(stance.joint_positions)
    base_to_footprint = np.asarray(to_footprint, dtype=np.float64)
    soles = state.soles_in_base(legs) @ base_to_footprint[:3, :3].T + base_to_footprint[:3, 3]
    up = base_to_footprint[2, :3]
    variances = [float(up @ c @ up) for c in sole_covariances(state, legs, robot.noise)]
    transform = transform_footprint_to_odom
    in_odom = soles @ transform[:3, :3].T + transform[:3, 3]
    half = np.array([limits.sole_length, limits.sole_width]) / 2
    resolution = cells.resolution
    feet = []
    for leg, sole, centre, variance in zip(legs, soles, in_odom, variances, strict=True):
        (x, y), reach = centre[:2], float(np.hypot(*half))
        cy, cx = cells.cells_between((x - reach, y - reach), (x + reach, y + reach))
        offset = np.column_stack(((cx + 0.5) * resolution - x, (cy + 0.5) * resolution - y))
        along = np.abs(offset @ transform[:2, :2])
        cell = 0.5 * resolution * (abs(transform[0, 0]) + abs(transform[1, 0]))
        under = (along <= half - cell + 1e-9).all(axis=-1)
        place = cells.places(cy[under], cx[under])
        inside = place >= 0
        distance = np.full(int(inside.sum()), float(np.hypot(sole[0], sole[1])))
        feet.append(FootMeasurement(leg, centre, variance, place[inside], distance))
    return feet


def apply_foot(cells: OdomCells, foot: FootMeasurement, drift: Drift, pause: int, stamp: int) -> float | None:
    """Bring one sole into the map.

    Where the map knows most of the ground under the sole, the top of that ground is compared with the sole: all cells
    are moved by what a Kalman filter makes of the difference, so their relief stays; beyond the gate they are in
    conflict. Cells that no scan saw, and that were not found empty, get the sole's height.

    Returns:
        Height of the sole over the map's top under it [m], None where the map does not know enough.
    """
    memory = cells.memory
    height = memory["height"][foot.place]
    known = np.isfinite(height)
    scanned = known & (memory["looks"][foot.place] > 0)
    residual = None
    if foot.place.size and scanned.mean() >= COMPARED_SHARE:
        bearing = scanned & (height > height[scanned].max() - BEARING_M)
        residual = float(foot.centre[2] - height[bearing].mean())
        _correct(cells, foot, foot.place[scanned], foot.distance[scanned], residual, drift, pause, stamp)
    unseen = ~scanned & ((memory["cause"][foot.place] & LOOKED_AT) == 0)
    place = foot.place[unseen]
    nothing = np.zeros(place.size)
    heights = Heights(
        place=place,
        height=np.full(place.size, foot.centre[2]),
        variance=np.full(place.size, foot.variance + UNSEEN_RELIEF_M**2),
        below=nothing,
        above=nothing,
        steepness=nothing,
    )
    fuse_heights(cells, heights, drift, foot.distance[unseen], pause, stamp, is_look=False)
    return residual


def _correct(
    cells: OdomCells,
    foot: FootMeasurement,
    place: Index,
    distance: Float,
    residual: float,
    drift: Drift,
    pause: int,
    stamp: int,
) -> None:
    memory = cells.memory
    heights = Heights(
        place=place,
        height=memory["height"][place] + residual,
        variance=np.full(place.size, foot.variance),
        below=memory["below"][place],
        above=memory["above"][place],
        steepness=memory["steepness"][place],
    )
    fuse_heights(cells, heights, drift, distance, pause, stamp, is_look=False)
