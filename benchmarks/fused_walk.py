"""Maps of walks: drift of their poses, and comparison of each map with the oracle."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

import guara_perception as gp
from guara_perception.arrays import Float, Mask
from kinematics import LegOdometry, PoseInOdom, RobotModel
from kinematics.transforms import inverse
from testbed.scanned_walk import ScannedPause, WalkedPause, map_geometry
from testbed.true_ground import TrueGround

# The first step that is judged: at earlier ones the map holds little but the ground that the gait declared.
FIRST_JUDGED_STEP = 4
# From the near edge of the scanned area to the hind feet, to the fore feet, and a place there on either side.
PAUSES_BETWEEN, PAUSES_TO_FORE = 21, 6
# Samples of the bootstrap over walks.
SAMPLES = 300
SEEN_AT = np.array([[0.5, -0.18, 0.0, 1.0], [0.5, 0.18, 0.0, 1.0]])


Pause = TypeVar("Pause", bound=WalkedPause | ScannedPause)


def fused_pauses(
    terrain_map: gp.TerrainMap, robot: RobotModel, pauses: Iterable[Pause], *, registered: bool = True
) -> Iterator[tuple[Pause, gp.TerrainGrid]]:
    """Pauses with their maps; without registration of the scans the map follows odometry alone."""
    odometry = LegOdometry(robot)
    for pause in pauses:
        pose: PoseInOdom = odometry.update(pause.stance)
        if not registered:
            pose = PoseInOdom(pose.transform_footprint_to_odom, pose.covariance)
        picture = pause.picture if registered else None
        yield pause, terrain_map.update(pause.scan, pose, known_ground=pause.known_ground, picture=picture)


def drift_aside(pauses: Sequence[WalkedPause], poses: Sequence[Float], between: int = PAUSES_BETWEEN) -> Float:
    """Drift (n, 3) of a map while ground seen at the near edge comes to the hind feet: x, y [mm] and yaw [mrad]."""
    aside = []
    for before, now in zip(range(len(pauses) - between), range(between, len(pauses)), strict=True):
        found = np.linalg.inv(poses[now]) @ poses[before]
        truly = np.linalg.inv(pauses[now].to_world) @ pauses[before].to_world
        turned = found @ np.linalg.inv(truly)
        aside += [[*((found - truly) @ point)[:2], np.arctan2(turned[1, 0], turned[0, 0])] for point in SEEN_AT]
    return 1e3 * np.array(aside)


def rms(values: Iterable[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square([*values]))))


def bootstrap(walks: Float, statistic: Callable[[Float], Float | float]) -> tuple[Float, Float]:
    """Interval of 95 % of a statistic of walks (n, ...), by bootstrap over the walks."""
    drawn = np.random.default_rng(0).integers(len(walks), size=(SAMPLES, len(walks)))
    low, high = np.quantile([statistic(walks[rows]) for rows in drawn], [0.025, 0.975], axis=0)
    return low, high


@dataclass(frozen=True)
class JudgedPause:
    """One pause of a walk with its map and the truth.

    Attributes:
        item: the pause and its scan.
        fused: the fused map, whose poses come from odometry and pictures, as in the node.
        oracle: the map as it would be if every cell of it were known exactly.
        dark: (ny, nx) cells with ground that absorbs the laser.
        from_world: (4, 4) true transform from the world to base_footprint of the scan.
    """

    item: ScannedPause
    fused: gp.TerrainGrid
    oracle: gp.TerrainGrid
    dark: Mask
    from_world: Float


def judged_walk(robot: RobotModel, truth: TrueGround, pauses: Iterable[ScannedPause]) -> Iterator[JudgedPause]:
    """Fuse the scans and pictures of a walk; yields pauses from FIRST_JUDGED_STEP on with map and truth."""
    for item, fused in fused_pauses(gp.TerrainMap(robot), robot, pauses):
        if item.pause.step >= FIRST_JUDGED_STEP:
            oracle, dark = oracle_of(robot, truth, fused, item.to_world)
            yield JudgedPause(item, fused, oracle, dark, inverse(item.to_world))


def oracle_of(
    robot: RobotModel, truth: TrueGround, fused: gp.TerrainGrid, to_world: Float
) -> tuple[gp.TerrainGrid, Mask]:
    """A map as it would be if every cell were known exactly, and cells (ny, nx) that absorb the laser."""
    stance = {name: fused.metadata[name] for name in ("stance", "transform_base_to_footprint")}
    return truth.grid(to_world, map_geometry(robot), robot, **stance)
