"""Supporting soles as height measurements, which correct the z of odometry and fill ground that no scan saw.

The z of leg odometry is a random walk. A sole on ground that is known in the map measures the error of z, and a scalar
Kalman filter subtracts the error common to the soles. The map's record contains the correction, and names soles outside
the gate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float, Index, Mask
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.map.fuse_heights import GATE_SIGMAS, LOOKED_AT, Heights, MapPause, fuse_heights
from guara_perception.terrain.map.odom_cells import OdomCells
from kinematics import RobotModel
from kinematics.stance_pose import sole_covariances
from kinematics.transforms import transform_points

# Quantile of the heights under a sole that is taken as the height of its support: a level sole rests on the highest
# ground, but noise may raise one cell in ten.
BEARING_QUANTILE = 0.9
# Sigma of the height of unscanned ground under a sole.
UNSEEN_RELIEF_M = 0.003
# Least fraction of the cells under a sole that must be scanned to compare its height with the map.
COMPARED_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class FootMeasurement:
    """Height measurement of a supporting sole.

    Attributes:
        leg: name of the leg.
        centre: (3,) sole centre in odom [m].
        arm: (2,) changes of the sole's height with roll and pitch of the footprint [m].
        variance, aside: variances of the sole's height, and of its horizontal position in the worst direction [m^2].
        slot: slots of the map cells wholly under the sole.
        distance: distance of the sole from the robot, repeated for each of these cells [m].
    """

    leg: str
    centre: Float
    arm: tuple[float, float]
    variance: float
    aside: float
    slot: Index
    distance: Float


def support_feet(
    cells: OdomCells,
    robot: RobotModel,
    terrain: TerrainGrid,
    transform_footprint_to_odom: Float,
    limits: TraversabilityLimits,
) -> list[FootMeasurement]:
    """Supporting soles at a scan; none if the scan's record contains no stance or no pose.

    Raises:
        InvalidInput: the record contains an unreadable stance, pose or list of supporting feet.
        kinematics.KinematicsError: the stance does not fit this robot.
    """
    record = terrain.record
    record.check("stance", "transform_base_to_footprint", "support_feet_used")
    stance, transform_base_to_footprint = record.stance, record.transform_base_to_footprint
    if stance is None or transform_base_to_footprint is None:
        return []
    legs = list(stance.support_feet if record.support_feet_used is None else record.support_feet_used)
    state = robot.state(stance.joint_positions)
    soles = transform_points(transform_base_to_footprint, state.soles_in_base(legs))
    rotation = transform_base_to_footprint[:3, :3]
    covariances = [rotation @ c @ rotation.T for c in sole_covariances(state, legs, robot.noise)]
    transform = transform_footprint_to_odom
    in_odom = transform_points(transform, soles)
    half = np.array([limits.sole_length, limits.sole_width]) / 2
    resolution = cells.resolution
    feet = []
    for leg, sole, centre, covariance in zip(legs, soles, in_odom, covariances, strict=True):
        (x, y), reach = centre[:2], float(np.hypot(*half))
        cy, cx = cells.cells_between((x - reach, y - reach), (x + reach, y + reach))
        offset = np.column_stack(((cx + 0.5) * resolution - x, (cy + 0.5) * resolution - y))
        along = np.abs(offset @ transform[:2, :2])
        cell = 0.5 * resolution * (abs(transform[0, 0]) + abs(transform[1, 0]))
        under = (along <= half - cell + 1e-9).all(axis=-1)
        slot = cells.slots(cy[under], cx[under])
        inside = slot >= 0
        distance = np.full(int(inside.sum()), float(np.hypot(sole[0], sole[1])))
        arm, aside = (float(sole[1]), -float(sole[0])), float(np.linalg.eigvalsh(covariance[:2, :2])[-1])
        feet.append(FootMeasurement(leg, centre, arm, float(covariance[2, 2]), aside, slot[inside], distance))
    return feet


def sole_error(cells: OdomCells, foot: FootMeasurement) -> SoleError | None:
    """Error of a sole relative to the scanned ground under it; None if too little of this ground is known."""
    memory = cells.memory
    slot = foot.slot[_scanned(cells, foot)]
    if not foot.slot.size or slot.size < COMPARED_SHARE * foot.slot.size:
        return None
    bearing = float(np.quantile(memory["height"][slot], BEARING_QUANTILE))
    variance = foot.variance + float(memory["variance"][slot].mean())
    relief = bearing - float(np.quantile(memory["height"][slot], 1 - BEARING_QUANTILE))
    return SoleError(float(foot.centre[2]) - bearing, variance, foot.arm, relief, int(memory["pause"][slot].min()))


def fill_under_foot(cells: OdomCells, foot: FootMeasurement, now: MapPause) -> None:
    """Fuse the height of a sole into cells under it that no scan observed, or whose observations conflict.

    Scanned ground keeps its height, because a sole does not measure the relief under it, and the height anchor corrects
    the error common to all soles.
    """
    memory = cells.memory
    is_free = ~_scanned(cells, foot) & ((memory["cause"][foot.slot] & LOOKED_AT) == 0)
    slot = foot.slot[is_free]
    height, variance = (np.full(slot.size, value) for value in (foot.centre[2], foot.variance + UNSEEN_RELIEF_M**2))
    fuse_heights(cells, Heights(slot, height, variance, variance, foot.distance[is_free]), now, is_scan=False)


def _scanned(cells: OdomCells, foot: FootMeasurement) -> Mask:
    memory = cells.memory
    known = np.isfinite(memory["height"][foot.slot]) & ~memory["conflict"][foot.slot]
    return np.asarray(known & (memory["looks"][foot.slot] > 0))


@dataclass(frozen=True, slots=True)
class SoleError:
    """Error of a sole relative to the map.

    Attributes:
        residual: height of the sole above the map [m].
        variance: variance of the residual, without the errors of odometry and attitude [m^2].
        arm: as in `FootMeasurement`.
        relief: range of the map's heights under the sole between the 10 % and the 90 % quantile, by which the sole may
            stand lower near an edge [m].
        pause: number of the earliest of the pauses at which the cells under the sole were last seen.
    """

    residual: float
    variance: float
    arm: tuple[float, float] = (0.0, 0.0)
    relief: float = 0.0
    pause: int = 0


@dataclass(frozen=True, slots=True)
class HeightAnchor:
    """State of the height filter.

    Attributes:
        offset: correction to be added to the z of leg odometry [m].
        variance: variance of the walk's height relative to the map [m^2].
        rise: increase of a cell's height variance from the start until now if the cell is not seen again [m^2].
        odometry: largest variance of z so far according to leg odometry [m^2].
        rejected: legs whose soles were outside the gate at this pause.
    """

    offset: float = 0.0
    variance: float = 0.0
    rise: float = 0.0
    odometry: float = 0.0
    rejected: tuple[str, ...] = ()

    def prior(self, odometry_variance: float) -> float:
        """Variance of the walk's height at the next pause, before its soles are compared [m^2]."""
        return self.variance + self._growth(odometry_variance)

    def _growth(self, odometry_variance: float) -> float:
        return max(odometry_variance - self.odometry, 0.0)

    def after(self, odometry_variance: float, soles: Mapping[str, SoleError]) -> HeightAnchor:
        """Predict and update the filter at the next pause.

        Args:
            odometry_variance: variance of z since the start according to leg odometry [m^2].
            soles: leg -> error of its sole, after the offset of this anchor was added.
        """
        prior = variance = self.prior(odometry_variance)
        correction = 0.0
        rejected = []
        for leg, sole in soles.items():
            innovation, innovation_variance = sole.residual + correction, variance + sole.variance
            if innovation**2 > GATE_SIGMAS**2 * innovation_variance:
                rejected.append(leg)
                continue
            gain = variance / innovation_variance if innovation_variance > 0 else 0.0
            correction -= gain * innovation
            variance *= 1 - gain
        # The variance of cells increases by the fraction of the growth that the soles did not remove.
        kept = variance / prior if prior > 0 else 1.0
        return HeightAnchor(
            offset=self.offset + correction,
            variance=variance,
            rise=self.rise + self._growth(odometry_variance) * kept,
            odometry=max(odometry_variance, self.odometry),
            rejected=tuple(rejected),
        )
