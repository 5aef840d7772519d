"""Walk over analytic ground with joint and contact noise, and synthetic scans of it for the fused map."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

import guara_perception as gp
from guara_perception.arrays import Float, Mask
from guara_perception.ranging.scan_geometry import variance_by_motion
from guara_perception.settings import Settings
from guara_perception.terrain.assessment.assess import assess_layers
from guara_perception.terrain.assessment.raster import Raster
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.record import ScanRecord, limits_to_dict
from guara_perception.terrain.map.soft_ground import REACH_M
from kinematics import GravityEstimate, RobotModel, Stance
from kinematics.urdf import rotation_from_rpy

LIFT_ORDER = ("rh", "rf", "lh", "lf")
CYCLE_M = 0.140
ADVANCE_M = CYCLE_M / len(LIFT_ORDER)
HIP_HEIGHT_M = 0.360
# Largest height of the body above the lowest foot, so that its leg still reaches half a swing ahead.
LONGEST_LEG_M = 0.375
PAUSE_NS = 4_675_000_000
# Nominal positions of camera and laser in base_link, for occlusion.
CAMERA_IN_BASE = np.array([0.400, 0.0, 0.140])
LASER_IN_BASE = np.array([0.600, 0.0, 0.110])
SENSOR_SIGMA_M = (0.0001, 0.0002)
# Half the width of the camera's view on the ground, at the near and the far end of the scanned area.
SEEN_ASIDE_M = (0.26, 0.38)
# Shares of cells without a return, measured in 18 coarse scans of simulated frames over random worlds: cells whose
# height differs by more than EDGE_M from a neighbour, cells beside them, and cells within two cells of dark ground.
EDGE_M = 0.008
DROPPED_AT_EDGES, DROPPED_BESIDE_EDGES, DROPPED_BESIDE_DARK = 0.21, 0.08, 0.09
# Largest error of the map's position that is allowed for near a foothold [m].
AROUND_M = 0.02
# Approximate half width of clusters of cells without a return [cells].
CLUSTER_CELLS = 1.5


@dataclass(frozen=True)
class Ground:
    """Mixed terrain: boxes, a ramp up and down, a rough stretch, a trench, and dark patches that return nothing."""

    boxes: Float
    dark: Float
    phases: Float

    @staticmethod
    def random(seed: int) -> Ground:
        """Create random ground; the first 0.45 m, on which the robot stands, are flat."""
        rng = np.random.default_rng(seed)
        boxes = np.column_stack(
            (
                rng.uniform(0.5, 2.8, 14),
                rng.uniform(-0.30, 0.30, 14),
                rng.uniform(0.04, 0.12, 14),
                rng.uniform(0.04, 0.12, 14),
                rng.choice([0.010, 0.020, 0.030, 0.040], 14),
            )
        )
        dark = np.column_stack((rng.uniform(0.5, 2.8, 6), rng.uniform(-0.25, 0.25, 6), rng.uniform(0.015, 0.035, 6)))
        return Ground(boxes, dark, rng.uniform(0, 2 * np.pi, (3, 2)))

    def height_at(self, x: Float, y: Float) -> Float:
        """True height in the world [m]."""
        ramp = 0.030 * np.clip((x - 0.8) / 0.4, 0, 1) - 0.030 * np.clip((x - 1.7) / 0.4, 0, 1)
        height = np.asarray(ramp + np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y))), dtype=np.float64)
        x, y = np.broadcast_arrays(x, y)
        rough = (x > 1.25) & (x < 1.65)
        if rough.any():
            for (px, py), length, amplitude in zip(
                self.phases, (0.05, 0.08, 0.13), (0.0006, 0.001, 0.0015), strict=True
            ):
                phase_x, phase_y = 2 * np.pi * x[rough] / length, 2 * np.pi * y[rough] / length
                height[rough] += amplitude * np.sin(phase_x + px) * np.sin(phase_y + py)
        for bx, by, length, width, top in self.boxes:
            height[(np.abs(x - bx) < length / 2) & (np.abs(y - by) < width / 2)] += top
        return np.where((x > 2.2) & (x < 2.26) & (np.abs(y) < 0.12), height - 0.05, height)

    def at(self, step: int) -> Ground:
        """Ground at a pause; this ground never changes."""
        return self

    def sink(self, x: float, y: float) -> float:
        """Depth by which the ground gives way under a foot [m]."""
        return 0.0

    def carried(self, step: int, foot: Float) -> Float:
        """Position at pause `step` of a foot that stood at `foot` at the previous pause; moving ground moves it."""
        return foot

    def own(self, x: Float, y: Float) -> tuple[Float, Float]:
        """Coordinates of points relative to the ground itself, which stay the same when the ground moves."""
        return x, y

    def is_dark(self, x: Float, y: Float) -> npt.NDArray[np.bool_]:
        """Mask of the points where the ground absorbs the laser light."""
        dark = np.zeros(np.shape(x), dtype=bool)
        for dx, dy, radius in self.dark:
            dark |= np.hypot(x - dx, y - dy) < radius
        return dark


@dataclass(frozen=True)
class LevelGround(Ground):
    """Level plane."""

    def height_at(self, x: Float, y: Float) -> Float:
        """0 everywhere."""
        return np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))


@dataclass(frozen=True)
class CompliantGround(Ground):
    """Ground with a strip across the path that yields under a foot, like foam or snow, or is slippery, like ice.

    Attributes:
        soft: first and last x of the strip [m].
        depth: depth to which a foot sinks in [m].
        thickness: height of the strip above the ground around it [m].
        slide: outward slide of a standing left foot, once per cycle [m].
    """

    soft: tuple[float, float] = (1.0, 1.5)
    depth: float = 0.020
    thickness: float = 0.0
    slide: float = 0.0

    def is_soft(self, x: Float, y: Float) -> Mask:
        """Mask of the points on the soft strip."""
        return np.asarray((x >= self.soft[0]) & (x <= self.soft[1]))

    def height_at(self, x: Float, y: Float) -> Float:
        """True height in the world before a foot has stepped on it [m]."""
        return super().height_at(x, y) + np.where(self.is_soft(x, y), self.thickness, 0.0)

    def sink(self, x: float, y: float) -> float:
        """Depth by which the ground gives way under a foot [m]."""
        return self.depth if self.soft[0] <= x <= self.soft[1] else 0.0

    def carried(self, step: int, foot: Float) -> Float:
        """See `Ground.carried`; a left foot slides outwards once per cycle."""
        if step % len(LIFT_ORDER) != 1 or not (self.slide and foot[1] > 0 and self.is_soft(*foot[:2])):
            return foot
        y = foot[1] + self.slide
        return np.array([foot[0], y, float(self.height_at(foot[0], y)) - self.sink(foot[0], y)])


@dataclass(frozen=True)
class Pause:
    """Stance pause of a walk.

    Attributes:
        step: number of the pause.
        stance: measured stance, with noise.
        transform_base_to_world: (4, 4) true pose of the body.
        soles_in_world: (3,) true position of each sole [m], by leg.
        next_footholds: (3,) true position at which the next swing of each leg ends [m], by leg.
        next_leg: leg that swings next.
    """

    step: int
    stance: Stance
    transform_base_to_world: Float
    soles_in_world: dict[str, Float]
    next_footholds: dict[str, Float]
    next_leg: str


def walk(
    robot: RobotModel, ground: Ground, cycles: int, seed: int, *, has_gravity: bool = True, stands: bool = False
) -> Iterator[Pause]:
    """Yield the pauses of a walk of four swings per cycle, with the noise of the robot's [stance] table.

    The body tilts by about a degree at random. With `stands`, it sways from pause to pause, and no foot is lifted.
    """
    rng = np.random.default_rng(1000 + seed)
    noise = robot.noise
    hips = {leg: robot.state(robot.posture("scan")).position_in_base(robot.tree.leg(leg).hip) for leg in robot.legs}
    feet = {}
    for turn, leg in enumerate(LIFT_ORDER):
        feet[leg] = _foothold(ground, hips[leg][0] + (turn - 1.5) * ADVANCE_M, hips[leg][1])
    for step in range(4 * cycles + 1):
        if step:
            ground = ground.at(step)
            feet = {leg: ground.carried(step, foot) for leg, foot in feet.items()}
        body_x = 0.0 if stands else step * ADVANCE_M
        roll, pitch, yaw = rng.normal(0, np.radians(1.0), 3) * (1, 1, 0.5)
        soles = {leg: foot + rng.normal(0, noise.contact_sigma, 3) for leg, foot in feet.items()}
        transform = np.eye(4)
        transform[:3, :3] = rotation_from_rpy(roll, pitch, yaw)
        heights = [foot[2] for foot in feet.values()]
        transform[:3, 3] = (body_x, 0.0, min(np.mean(heights) + HIP_HEIGHT_M, min(heights) + LONGEST_LEG_M))
        stance = _measured(robot, transform, soles, rng, has_gravity)
        upcoming = {
            leg: _foothold(ground, hips[leg][0] + body_x + ADVANCE_M * (1.5 + (turn - step) % 4 + 1), hips[leg][1])
            for turn, leg in enumerate(LIFT_ORDER)
        }
        next_leg = LIFT_ORDER[step % 4]
        yield Pause(step, stance, transform, soles, upcoming, next_leg)
        if not stands:
            feet[next_leg] = upcoming[next_leg]


def scan(
    robot: RobotModel, ground: Ground, pause: Pause, seed: int, gravity: GravityEstimate | None = None
) -> gp.TerrainGrid:
    """Wide grid of a synthetic scan at a pause: true heights with noise; hidden and dark cells are unknown.

    `gravity` is the estimate carried by odometry, for a robot without an IMU.
    """
    settings, ground = Settings.of(robot), ground.at(pause.step)
    grid = GridGeometry.over(settings.footprint_x, settings.map_y, settings.resolution)
    pose = robot.stance_pose(pause.stance, odometry=gravity)
    rng = np.random.default_rng(5000 + 100 * seed + pause.step)
    x, y = (a.ravel() for a in np.meshgrid(*grid.centres()))
    to_world = pause.transform_base_to_world @ np.linalg.inv(pose.transform_base_to_footprint)
    samples = []
    for dx, dy in ((0, 0), (-0.45, -0.45), (-0.45, 0.45), (0.45, -0.45), (0.45, 0.45)):
        samples.append(seen_height(ground, to_world, x + dx * grid.resolution, y + dy * grid.resolution))
    heights = np.array([height for height, _ in samples])
    world = samples[0][1]
    hidden = np.zeros(x.size, dtype=bool)
    for origin in (CAMERA_IN_BASE, LASER_IN_BASE):
        origin_in_world = pause.transform_base_to_world[:3, :3] @ origin + pause.transform_base_to_world[:3, 3]
        hidden |= _hidden(ground, world, origin_in_world)
    sigma = np.interp(x, settings.footprint_x, SENSOR_SIGMA_M)
    top = heights.max(axis=0)
    on_top = heights > top - 0.004
    mean = np.where(on_top, heights, 0).sum(axis=0) / on_top.sum(axis=0) + rng.normal(0, sigma)
    dark = ground.is_dark(world[:, 0], world[:, 1])
    dropped = dark | _clusters(rng, np.ptp(heights, axis=0).reshape(grid.shape), top, dark).ravel()
    beside = np.abs(y) > np.interp(x, settings.footprint_x, SEEN_ASIDE_M)
    unknown = hidden | dropped | beside
    causes = [gp.Hazard.UNSCANNED, gp.Hazard.OCCLUDED, gp.Hazard.DROPOUT]
    flags = np.select([beside, hidden, dropped], causes, 0).astype(np.uint16)

    def layer(values: Float) -> Float:
        return np.where(unknown, np.nan, values).reshape(grid.shape)

    low, high = np.minimum(heights.min(axis=0), mean), np.maximum(top, mean)
    raster = Raster(layer(mean), layer(sigma**2), layer(low), layer(high))
    shared = variance_by_motion(np.stack((x, y)), np.zeros(2), pose.covariance[2:5, 2:5]).reshape(grid.shape)
    layers = assess_layers(
        raster,
        flags.reshape(grid.shape),
        grid.resolution,
        settings.limits,
        shared=shared,
        slope_sigma=pose.attitude_sigma,
    )
    layers["age"] = np.where(unknown, 255, 0).astype(np.uint8).reshape(grid.shape)
    layers["looks"] = (~unknown).astype(np.uint8).reshape(grid.shape)
    metadata = {
        "robot": robot.name,
        "stance": pause.stance.to_dict(),
        "attitude_source": pose.attitude_source,
        "attitude_sigma": pose.attitude_sigma,
        "support_feet_used": list(pose.support_feet_used),
        "transform_base_to_footprint": pose.transform_base_to_footprint.tolist(),
        "pose_covariance": pose.covariance.tolist(),
        "limits": limits_to_dict(settings.limits),
    }
    return gp.TerrainGrid(
        layers=layers,
        geometry=grid,
        stamp=(pause.step + 1) * PAUSE_NS,
        step=pause.step,
        record=ScanRecord.from_json(metadata),
    )


def _clusters(rng: np.random.Generator, relief: Float, top: Float, dark: npt.NDArray[np.bool_]) -> Mask:
    """Mask (ny, nx) of cells without a return, in clusters at edges and beside dark ground, as in real scans.

    Args:
        rng: random numbers.
        relief: range of heights within each cell [m], (ny, nx).
        top: highest point of each cell [m], (ny nx,).
        dark: mask of the cells whose ground absorbs the laser light, (ny nx,).
    """
    high, around = top.reshape(relief.shape), np.ones((3, 3), np.uint8)
    edges = cv2.dilate(high, around) - cv2.erode(high - relief, around) > EDGE_M
    beside = cv2.dilate(edges.astype(np.uint8), around) > 0
    near_dark = cv2.dilate(dark.reshape(relief.shape).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    share = np.select([edges, near_dark, beside], [DROPPED_AT_EDGES, DROPPED_BESIDE_DARK, DROPPED_BESIDE_EDGES], 0.0)
    noise = cv2.GaussianBlur(rng.normal(0, 1, relief.shape), (0, 0), CLUSTER_CELLS)
    rank = np.empty(noise.size)
    rank[np.argsort(noise, axis=None)] = np.arange(noise.size) / noise.size
    return np.asarray(rank.reshape(relief.shape) < share)


def _measured(
    robot: RobotModel, transform: Float, soles: dict[str, Float], rng: np.random.Generator, has_gravity: bool
) -> Stance:
    rotation = transform[:3, :3]
    joints: dict[str, float] = {}
    for leg in robot.legs:
        in_base = rotation.T @ (soles[leg] - transform[:3, 3])
        reach = robot.reach(leg, in_base)
        if not reach.is_reachable:
            raise SystemExit(f"the walk is out of reach of {leg}: {in_base}")
        joints.update(zip(robot.tree.leg(leg).joints, reach.joint_positions.tolist(), strict=True))
    joints = {name: angle + rng.normal(0, robot.noise.encoder_sigma) for name, angle in joints.items()}
    down = rotation.T @ np.array([0.0, 0.0, -1.0]) + rng.normal(0, robot.noise.imu_sigma, 3)
    gravity = (float(down[0]), float(down[1]), float(down[2])) if has_gravity else None
    return Stance(joints, robot.legs, gravity)


def _foothold(ground: Ground, x: float, y: float) -> Float:
    """Position (3,) of the flattest foothold for a sole near a nominal position."""
    best = None
    for dx in np.arange(-0.03, 0.031, 0.01):
        for dy in np.arange(-0.02, 0.021, 0.01):
            sx, sy = np.meshgrid(np.linspace(-0.045, 0.045, 10), np.linspace(-0.035, 0.035, 8))
            heights = ground.height_at(x + dx + sx, y + dy + sy)
            cost = (round(float(np.ptp(heights)), 4), float(np.hypot(dx, dy)))
            if best is None or cost < best[0]:
                best = (cost, np.array([x + dx, y + dy, float(heights.max()) - ground.sink(x + dx, y + dy)]))
    assert best is not None
    return best[1]


def free_soft_cells(
    ground: Ground, transform_base_to_world: Float, fused: gp.TerrainGrid, sank: Sequence[Float]
) -> int:
    """Count the free cells on soft ground near positions at which feet sank in, so that they should not be free."""
    if not sank:
        return 0
    to_world = transform_base_to_world @ np.linalg.inv(fused.metadata["transform_base_to_footprint"])
    x, y = np.meshgrid(*fused.geometry.centres())
    points = np.stack((x, y, fused.elevation), axis=-1)[fused.hazard == 0] @ to_world[:3, :3].T + to_world[:3, 3]
    away = np.hypot(*(points[:, None, :2] - np.array(sank)[:, :2]).transpose(2, 0, 1)).min(axis=1)
    return sum(ground.sink(px, py) > 0 for px, py, _ in points[away < REACH_M - AROUND_M].tolist())


def seen_height(ground: Ground, to_world: Float, x: Float, y: Float) -> tuple[Float, Float]:
    """Heights at which vertical lines of the measured footprint meet the true ground, and these points in the world."""
    z = np.zeros(x.size)
    for _ in range(4):
        world = np.column_stack((x, y, z)) @ to_world[:3, :3].T + to_world[:3, 3]
        z = z + (ground.height_at(world[:, 0], world[:, 1]) - world[:, 2]) / to_world[2, 2]
    world = np.column_stack((x, y, z)) @ to_world[:3, :3].T + to_world[:3, 3]
    return z, world


def _hidden(ground: Ground, points: Float, origin: Float) -> npt.NDArray[np.bool_]:
    """Mask of the points (n, 3) that the true ground hides from a sensor's origin."""
    hidden = np.zeros(len(points), dtype=bool)
    for share in np.linspace(0.005, 0.35, 60):
        at = points + share * (origin - points)
        hidden |= ground.height_at(at[:, 0], at[:, 1]) > at[:, 2] + 0.001
    return hidden
