"""Walk with simulated contacts: the wave gait in MuJoCo, in which each swing starts from the true foot positions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from guara_perception.arrays import Float
from guara_perception.simulation.gait import CROUCH_STEP_M, DEEPEST_CROUCH_M, OutOfReach, WaveGait, body_pose
from guara_perception.simulation.walk import (
    KNOWN_GROUND_MARGIN_M,
    Choice,
    Footstep,
    WalkEnded,
    WalkNoise,
    WalkPause,
    chosen_foothold,
    reported_stance,
    true_footprint,
)
from guara_perception.simulation.world import World
from guara_perception.terrain.map.known_ground import KnownGround
from kinematics.transforms import inverse, transform_points
from testbed.physics.crawl import Crawl, Fell, NoGround
from testbed.physics.guara import ROBOTS
from testbed.physics.robot import LEGS, Robot
from testbed.physics.stiff_crawl import StiffCrawl

if TYPE_CHECKING:
    from kinematics import RobotModel


# Lateral shift of the body away from the swinging leg. Without it, the centre of mass is only 6 mm inside the triangle
# of the other feet.
SWAY_M = 0.040
# Number of points on the path of a swing at which the height of the ground is evaluated.
ON_THE_WAY = 20
# Largest correction of the heading per swing, which keeps the feet in their lanes [rad].
LARGEST_TURN = 0.03


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PhysicsPause(WalkPause):
    """Pause of a walk in MuJoCo.

    Attributes:
        slips: slide of each standing foot over the ground since the last pause, without rolling [m], by leg.
    """

    slips: Mapping[str, float] = field(default_factory=dict)


def physics_walk(
    world: World,
    robot: RobotModel,
    choose: Callable[[WalkPause], Choice] | None = None,
    *,
    cycles: float = 6,
    seed: int = 0,
    noise: WalkNoise | None = None,
    is_stiff: bool = False,
) -> Iterator[PhysicsPause]:
    """Simulate a walk as `simulate_walk` does, but with the contacts and dynamics of MuJoCo.

    Of `noise`, only the errors of reported joints and gravity are used; slip results from the physics.

    Args:
        world: level ground with boxes.
        robot: a Guará or a Go2.
        choose, cycles, seed, noise: as in `simulate_walk`.
        is_stiff: True = control by position servos, which push the feet against each other, so that they creep, always
            in the same direction. False = force control, which minimises the contact forces.

    Yields:
        The pauses, each when the robot stands still.

    Raises:
        MissingExtra: MuJoCo is not installed.
        WalkEnded: the planner found no foothold, a foot found no ground, or the robot fell.
        OutOfReach: a leg cannot reach its foothold.
    """
    gait, noise = WaveGait.of(robot), noise or WalkNoise()
    rng, stance = np.random.default_rng(seed), gait.first_stance()
    body = ROBOTS[robot.name](world, feet=np.array([stance[leg] for leg in LEGS]))
    crawl = (StiffCrawl if is_stiff else Crawl)(body)
    footstep, slid = None, body.slid.copy()
    for step in range(round(cycles * len(gait.lift_order)) + 1):
        crawl.freeze()
        ways = np.hypot(*(body.slid - slid).T)
        slips = {leg: float(way) for leg, way in zip(LEGS, ways, strict=True) if footstep and leg != footstep.leg}
        slid = body.slid.copy()
        pause = _pause(robot, gait, body, step, footstep, noise, rng, slips)
        yield pause
        x, y, *_ = chosen_foothold(pause, choose)
        xy = pause.to_world(x, y)
        leg, target = LEGS.index(pause.next_leg), np.array([*xy, world.sole_height(*xy, *robot.sole)])
        moved = _body_motion(gait, body, leg, target)
        com, way = transform_points(moved, body.com_in_base), np.linspace(body.feet[leg], target, ON_THE_WAY)
        top = max(world.sole_height(x, y, *robot.sole) for x, y, _ in way.tolist())
        try:
            crawl.step(leg, way[[0, -1]], com, moved[:3, :3], top)
        except (Fell, NoGround) as error:
            raise WalkEnded(f"step {step}: {error}") from None
        sole = _soles_in_world(robot, body)[pause.next_leg]
        footstep = Footstep(pause.next_leg, (x, y), (float(sole[0]), float(sole[1]), float(sole[2])))


def _pause(
    robot: RobotModel,
    gait: WaveGait,
    body: Robot,
    step: int,
    footstep: Footstep | None,
    noise: WalkNoise,
    rng: np.random.Generator,
    slips: Mapping[str, float],
) -> PhysicsPause:
    transform, joints, feet = body.transform_base_to_world, body.joints, tuple(robot.legs)
    footprint = true_footprint(robot, joints, feet, transform)
    soles = _soles_in_world(robot, body)
    leg = gait.leg_of_swing(step)
    landing = gait.landing(leg)
    # Ahead of the future position of the body, and sideways in the lane of the leg.
    ahead = float(np.mean([soles[name][0] - gait.hips[name][0] for name in feet])) + _mean_lag(gait)
    target = inverse(footprint) @ (ahead + landing[0], landing[1], 0.0, 1.0)
    ground: tuple[KnownGround, ...] = ()
    if step == 0:
        corners = gait.support_polygon(KNOWN_GROUND_MARGIN_M)
        outline = transform_points(inverse(footprint), np.column_stack((corners, np.zeros(4))))
        ground = (KnownGround(outline[:, :2], height=float(outline[:, 2].mean()), sigma=0.001),)
    return PhysicsPause(
        step=step,
        stance=reported_stance(joints, feet, transform, noise, rng),
        known_ground=ground,
        next_leg=leg,
        nominal=(float(target[0]), float(target[1])),
        last_footstep=footstep,
        joint_positions=joints,
        transform_base_to_world=transform,
        transform_footprint_to_world=footprint,
        soles_in_world=soles,
        slips=slips,
    )


def _body_motion(gait: WaveGait, body: Robot, leg: int, target: Float) -> Float:
    """Pose (4, 4) of the body during a swing: the highest from which the legs reach all footholds and the target.

    Raises:
        OutOfReach: the legs do not reach them from any height.
    """
    feet, turned = body.feet, body.rotation
    offset = (feet[:, :2] - np.array([gait.hips[name] for name in LEGS])).mean(axis=0)
    sway = -SWAY_M if gait.hips[LEGS[leg]][1] > 0 else SWAY_M
    position = (float(offset[0]) + _mean_lag(gait), float(offset[1]) + sway)
    turn, yaw = np.eye(4), float(np.arctan2(turned[1, 0], turned[0, 0]))
    yaw -= float(np.clip(yaw, -LARGEST_TURN, LARGEST_TURN))
    turn[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    after = feet.copy()
    after[leg] = target
    for crouch in np.arange(0.0, DEEPEST_CROUCH_M + 1e-9, CROUCH_STEP_M):
        moved = body_pose(feet, position, body.heights[0] - float(crouch)) @ turn
        if all(np.isfinite(body.joints_at(each, moved[:3, 3], moved[:3, :3])).all() for each in (feet, after)):
            return np.asarray(moved)
    raise OutOfReach(
        f"leg {LEGS[leg]!r} cannot reach {np.round(target, 3).tolist()}: choose a foothold nearer to its hip"
    )


def _mean_lag(gait: WaveGait) -> float:
    """Mean distance of the feet behind their hips just before a swing [m]."""
    legs = len(gait.lift_order)
    return gait.cycle_length / 2 - gait.advance * (legs - 1) / 2


def _soles_in_world(robot: RobotModel, body: Robot) -> dict[str, Float]:
    soles = transform_points(body.transform_base_to_world, robot.state(body.joints).soles_in_base())
    return dict(zip(robot.legs, soles, strict=True))
