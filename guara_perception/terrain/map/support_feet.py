"""Feet on the ground measure its height: soles check the map, fill ground that no scan saw, correct odometry's z.

Leg odometry's z is a random walk. A sole that stands on ground which the map knows measures its error against that
ground; a scalar Kalman filter subtracts the error that the soles agree on. Nothing is shifted silently: the correction
of each pause and the sum of all are in the map's record, and soles beyond the gate are not used but named.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from guara_perception.arrays import Float, Index, Mask
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.map.fuse_heights import GATE_SIGMAS, LOOKED_AT, Heights, OdometryDrift, fuse_heights
from guara_perception.terrain.map.odom_cells import OdomCells
from kinematics import RobotModel
from kinematics.stance_pose import sole_covariances
from kinematics.transforms import transform_points

# A level sole stands on the highest ground under it; one cell in ten may be higher by noise.
BEARING_QUANTILE = 0.9
# Sigma of how much lower than the sole the ground under it may lie, where no scan saw it.
UNSEEN_RELIEF_M = 0.003
# Least share of the cells under a sole that scans must have seen for its height to be compared with the map's.
COMPARED_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class FootMeasurement:
    """A supporting sole.

    Attributes:
        leg: name of the leg.
        centre: (3,) sole centre in odom [m].
        variance: variance of its height [m^2].
        slot, distance: cells of the map that lie wholly under it, and their distance from the robot [m].
    """

    leg: str
    centre: Float
    variance: float
    slot: Index
    distance: Float

    def raised(self, rise: float) -> FootMeasurement:
        """The same foot, `rise` higher [m]."""
        return replace(self, centre=self.centre + (0.0, 0.0, rise))


def support_feet(
    cells: OdomCells,
    robot: RobotModel,
    terrain: TerrainGrid,
    transform_footprint_to_odom: Float,
    limits: TraversabilityLimits,
) -> list[FootMeasurement]:
    """The supporting soles of the stance at which a scan was taken; none where its record holds no stance."""
    record = terrain.record
    record.check("stance", "transform_base_to_footprint", "support_feet_used")
    stance, transform_base_to_footprint = record.stance, record.transform_base_to_footprint
    if stance is None or transform_base_to_footprint is None:
        return []
    legs = list(stance.support_feet if record.support_feet_used is None else record.support_feet_used)
    state = robot.state(stance.joint_positions)
    soles = transform_points(transform_base_to_footprint, state.soles_in_base(legs))
    up = transform_base_to_footprint[2, :3]
    variances = [float(up @ c @ up) for c in sole_covariances(state, legs, robot.noise)]
    transform = transform_footprint_to_odom
    in_odom = transform_points(transform, soles)
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
        slot = cells.slots(cy[under], cx[under])
        inside = slot >= 0
        distance = np.full(int(inside.sum()), float(np.hypot(sole[0], sole[1])))
        feet.append(FootMeasurement(leg, centre, variance, slot[inside], distance))
    return feet


def sole_error(cells: OdomCells, foot: FootMeasurement) -> SoleError | None:
    """Height of a sole over the ground that scans saw under it; None where the map knows too little of that ground."""
    memory = cells.memory
    slot = foot.slot[_scanned(cells, foot)]
    if not foot.slot.size or slot.size < COMPARED_SHARE * foot.slot.size:
        return None
    bearing = float(np.quantile(memory["height"][slot], BEARING_QUANTILE))
    return SoleError(float(foot.centre[2]) - bearing, foot.variance + float(memory["variance"][slot].mean()))


def fill_under_foot(cells: OdomCells, foot: FootMeasurement, drift: OdometryDrift, pause: int, stamp: int) -> None:
    """Give cells under a sole the sole's height, where no scan saw ground and none looked without a return.

    Ground that scans saw keeps its height: one sole says nothing about the relief under it, and the height anchor
    corrects the error that all soles have in common.
    """
    memory = cells.memory
    is_free = ~_scanned(cells, foot) & ((memory["cause"][foot.slot] & LOOKED_AT) == 0)
    if not is_free.any():
        return
    slot = foot.slot[is_free]
    nothing = np.zeros(slot.size)
    heights = Heights(
        slot=slot,
        height=np.full(slot.size, foot.centre[2]),
        variance=np.full(slot.size, foot.variance + UNSEEN_RELIEF_M**2),
        below=nothing,
        above=nothing,
        steepness=nothing,
    )
    fuse_heights(cells, heights, drift, foot.distance[is_free], pause, stamp, is_look=False)


def _scanned(cells: OdomCells, foot: FootMeasurement) -> Mask:
    memory = cells.memory
    known = np.isfinite(memory["height"][foot.slot]) & ~memory["conflict"][foot.slot]
    return np.asarray(known & (memory["looks"][foot.slot] > 0))


@dataclass(frozen=True, slots=True)
class SoleError:
    """Height of a sole over the map's ground under it [m], and its variance without the error of odometry [m^2]."""

    residual: float
    variance: float


@dataclass(frozen=True, slots=True)
class HeightAnchor:
    """State of the filter.

    Attributes:
        offset: correction to be added to the z of leg odometry [m].
        variance: variance of the walk's height against the map [m^2].
        rise: variance that cells gain while they are not seen, summed since the start [m^2].
        odometry: variance of z that leg odometry gave last [m^2].
        rejected: legs whose soles stood too far off at this pause.
    """

    offset: float = 0.0
    variance: float = 0.0
    rise: float = 0.0
    odometry: float = 0.0
    rejected: tuple[str, ...] = ()

    def after(self, odometry_variance: float, soles: Mapping[str, SoleError]) -> HeightAnchor:
        """The state one pause later.

        Args:
            odometry_variance: variance of z that leg odometry has gathered since the start [m^2].
            soles: leg -> its error with this anchor's offset already in it.
        """
        growth = max(odometry_variance - self.odometry, 0.0)
        prior = variance = self.variance + growth
        correction = 0.0
        rejected = []
        for leg, sole in soles.items():
            innovation_variance = variance + sole.variance
            if (sole.residual + correction) ** 2 > GATE_SIGMAS**2 * innovation_variance:
                rejected.append(leg)
                continue
            gain = variance / innovation_variance if innovation_variance > 0 else 0.0
            correction -= gain * (sole.residual + correction)
            variance *= 1 - gain
        # Cells keep the share of the growth that the soles did not remove again.
        kept = variance / prior if prior > 0 else 1.0
        return HeightAnchor(
            offset=self.offset + correction,
            variance=variance,
            rise=self.rise + growth * kept,
            odometry=max(odometry_variance, self.odometry),
            rejected=tuple(rejected),
        )
