"""The walk with real contacts: the wave gait in MuJoCo, each swing planned from where the feet really are."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from guara_perception.arrays import Float
from guara_perception.simulation.gait import (
    CROUCH_STEP_M,
    DEEPEST_CROUCH_M,
    OutOfReach,
    WaveGait,
    body_pose,
    stand_on,
)
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
from kinematics.reach import level_sole_pitch
from testbed.physics.physics_robot import PhysicsRobot

if TYPE_CHECKING:
    from kinematics import RobotModel


TICK_S = 0.010
# The body sways away from the leg that lifts: without it the centre of mass is only 6 mm inside the three other feet.
SWAY_M = 0.040
CLEARANCE_M = 0.060
# Mean speed without pauses: that of the paper's robot is 0.45 ... 0.80 m/min.
SPEED_M_S = 0.60 / 60
# Share of the time between two pauses for the body, with four feet down; the rest is the swing.
BODY_SHARE = 0.4
SETTLE_S = 1.0
# The lanes are kept by turning the body back, by this much per swing at most [rad].
LARGEST_TURN = 0.03
FALLEN_HEIGHT_M, FALLEN_TILT = 0.2, 0.35


def physics_walk(
    world: World,
    robot: RobotModel,
    choose: Callable[[WalkPause], Choice] | None = None,
    *,
    cycles: float = 6,
    seed: int = 0,
    noise: WalkNoise | None = None,
    is_stiff: bool = False,
) -> Iterator[WalkPause]:
    """Walk as `simulate_walk` does, in MuJoCo: feet slip, the body sags and tips, contacts decide.

    Of `noise` only that of the reports is added (joints, gravity): contacts and slip come from the physics here. A foot
    is lowered to the true height of the ground, as one with a contact switch would be.

    Args:
        world: level ground with boxes.
        robot, choose, cycles, seed, noise: as in `simulate_walk`.
        is_stiff: True for servos that know positions alone: they push the feet against each other, which creep, always
            the same way. Otherwise they are told the torques that carry the body.

    Yields:
        The pauses, each a second after the foot was set down.

    Raises:
        MissingExtra: MuJoCo is not installed.
        WalkEnded: the planner found no foothold, or the robot fell.
    """
    gait, noise = WaveGait.of(robot), noise or WalkNoise()
    rng = np.random.default_rng(seed)
    soles = {leg: np.array([*xy, 0.0]) for leg, xy in gait.first_stance().items()}
    transform, joints = stand_on(robot, soles, (0.0, 0.0), gait.hip_height)
    body = PhysicsRobot(world, robot, transform, joints)
    body.run(joints, SETTLE_S, _shares(robot, is_stiff=is_stiff))
    footstep: Footstep | None = None
    for step in range(round(cycles * len(gait.lift_order)) + 1):
        pause = _pause(robot, gait, body, step, footstep, noise, rng)
        yield pause
        x, y, *_ = chosen_foothold(pause, choose)
        length, width = robot.sole
        xy = pause.to_world(x, y)
        target = np.array([*xy, world.sole_height(*xy, length, width)])
        _swing(robot, gait, body, pause.next_leg, target, is_stiff=is_stiff)
        sole = _soles_in_world(robot, body)[pause.next_leg]
        footstep = Footstep(pause.next_leg, (x, y), (float(sole[0]), float(sole[1]), float(sole[2])))


def _pause(
    robot: RobotModel,
    gait: WaveGait,
    body: PhysicsRobot,
    step: int,
    footstep: Footstep | None,
    noise: WalkNoise,
    rng: np.random.Generator,
) -> WalkPause:
    transform, joints, feet = body.transform_base_to_world, body.joint_positions, tuple(robot.legs)
    if transform[2, 3] < FALLEN_HEIGHT_M or np.hypot(*transform[2, :2]) > FALLEN_TILT:
        raise WalkEnded(f"step {step}: the robot fell: its body is {transform[2, 3]:.2f} m above z = 0")
    footprint = true_footprint(robot, joints, feet, transform)
    soles = _soles_in_world(robot, body)
    leg = gait.leg_of_swing(step)
    landing = gait.landing(leg)
    # Ahead of where the body will be; sideways back into the leg's lane.
    ahead = float(np.mean([soles[name][0] - gait.hips[name][0] for name in feet])) + _mean_lag(gait)
    target = np.linalg.inv(footprint) @ (ahead + landing[0], landing[1], 0.0, 1.0)
    ground: tuple[KnownGround, ...] = ()
    if step == 0:
        inverse = np.linalg.inv(footprint)
        corners = gait.support_polygon(KNOWN_GROUND_MARGIN_M)
        outline = np.column_stack((corners, np.zeros(4), np.ones(4))) @ inverse.T
        ground = (KnownGround(outline[:, :2], height=float(outline[:, 2].mean()), sigma=0.001),)
    return WalkPause(
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
    )


def _shares(robot: RobotModel, leg: str = "", share: float = 1.0, *, is_stiff: bool) -> dict[str, float] | None:
    """Weights of the legs that carry the body, `share` for one of them; None for servos that know positions alone."""
    return None if is_stiff else {each: share if each == leg else 1.0 for each in robot.legs}


def _swing(
    robot: RobotModel, gait: WaveGait, body: PhysicsRobot, leg: str, target_in_world: Float, *, is_stiff: bool
) -> None:
    """Move the body forward and aside, then one foot to its target; wait until all is still."""
    base = body.transform_base_to_world
    soles = _soles_in_base(robot, body.joint_positions)
    target = base[:3, :3].T @ (target_in_world - base[:3, 3])
    moved = _body_motion(robot, gait, leg, soles, target, base)
    to_moved = np.linalg.inv(moved)
    goal = {name: to_moved[:3, :3] @ sole + to_moved[:3, 3] for name, sole in soles.items()}
    up = to_moved[:3, :3] @ base[2, :3]
    swing_time = gait.advance / SPEED_M_S
    body_time = BODY_SHARE * swing_time
    for share in _ticks(body_time):
        between = {name: soles[name] + share * (goal[name] - soles[name]) for name in soles}
        joints = _joints(robot, between, base[2, :3] + share * (up - base[2, :3]))
        body.run(joints, TICK_S, _shares(robot, leg, 1 - share, is_stiff=is_stiff))
    start, end = goal[leg], to_moved[:3, :3] @ target + to_moved[:3, 3]
    for share in _ticks(swing_time - body_time):
        joints = _joints(robot, {**goal, leg: _arc(start, end, share)}, up)
        body.run(joints, TICK_S, _shares(robot, leg, 0.0, is_stiff=is_stiff))
    body.run(joints, SETTLE_S, _shares(robot, is_stiff=is_stiff))


def _body_motion(
    robot: RobotModel, gait: WaveGait, leg: str, soles: Mapping[str, Float], target: Float, base: Float
) -> Float:
    """Transform (4, 4) from the body's next pose to the present one; as high as the legs can reach feet and target."""
    offsets = np.array([soles[name][:2] - gait.hips[name] for name in soles])
    sway = -SWAY_M if gait.hips[leg][1] > 0 else SWAY_M
    position = (float(offsets[:, 0].mean()) + _mean_lag(gait), float(offsets[:, 1].mean()) + sway)
    yaw = float(np.clip(-np.arctan2(base[1, 0], base[0, 0]), -LARGEST_TURN, LARGEST_TURN))
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    moved = np.eye(4)
    for crouch in np.arange(0.0, DEEPEST_CROUCH_M + 1e-9, CROUCH_STEP_M):
        moved = body_pose(np.array(list(soles.values())), position, gait.hip_height - float(crouch)) @ turn
        targets = [*soles.items(), (leg, target)]
        if all(
            np.isfinite(robot.reach(name, moved[:3, :3].T @ (target_in_world - moved[:3, 3])).joint_positions).all()
            for name, target_in_world in targets
        ):
            break
    return moved


def _mean_lag(gait: WaveGait) -> float:
    """How far the feet are behind their hips on average when one is about to lift [m]."""
    legs = len(gait.lift_order)
    return gait.cycle_length / 2 - gait.advance * (legs - 1) / 2


def _arc(start: Float, end: Float, share: float) -> Float:
    """A swing: up for the first third, across, down for the last third."""
    across = float(np.clip((share - 0.3) / 0.4, 0, 1))
    across = across**2 * (3 - 2 * across)
    point = start + across * (end - start)
    top = max(start[2], end[2]) + CLEARANCE_M
    if share < 0.3:
        point[2] = start[2] + (top - start[2]) * np.sin(share / 0.3 * np.pi / 2)
    elif share > 0.7:
        point[2] = end[2] + (top - end[2]) * np.sin((1 - share) / 0.3 * np.pi / 2)
    else:
        point[2] = top
    return np.asarray(point)


def _ticks(seconds: float) -> Float:
    """Shares of a motion at the ends of its ticks, with a soft start and end."""
    count = max(round(seconds / TICK_S), 1)
    linear = (np.arange(count) + 1) / count
    return np.asarray(linear**2 * (3 - 2 * linear))


def _joints(robot: RobotModel, soles_in_base: Mapping[str, Float], up_in_base: Float) -> dict[str, float]:
    joints: dict[str, float] = {}
    for leg, sole in soles_in_base.items():
        reached = robot.reach(leg, sole, level_sole_pitch(robot.tree, leg, sole, up_in_base))
        if not np.isfinite(reached.joint_positions).all():
            position = np.round(sole, 3).tolist()
            raise OutOfReach(f"leg {leg!r} cannot reach {position} in base_link: choose a foothold nearer to its hip")
        # The servos take what is beyond a limit as the limit.
        config = robot.tree.leg(leg).joints
        for name, value in zip(config, reached.joint_positions.tolist(), strict=True):
            index = robot.tree.joint_index(name)
            joints[name] = float(np.clip(value, robot.tree.lower_limits[index], robot.tree.upper_limits[index]))
    return joints


def _soles_in_base(robot: RobotModel, joints: Mapping[str, float]) -> dict[str, Float]:
    import warnings

    with warnings.catch_warnings():
        # Contacts push joints slightly beyond their limits, which is expected here.
        warnings.simplefilter("ignore")
        soles = robot.state(joints).soles_in_base()
    return {leg: np.array(sole) for leg, sole in zip(robot.legs, soles, strict=True)}


def _soles_in_world(robot: RobotModel, body: PhysicsRobot) -> dict[str, Float]:
    transform = body.transform_base_to_world
    soles = _soles_in_base(robot, body.joint_positions)
    return {leg: transform[:3, :3] @ sole + transform[:3, 3] for leg, sole in soles.items()}
