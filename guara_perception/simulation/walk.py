"""Simulated walk from stance pause to stance pause, on footholds chosen by a planner."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from guara_perception.simulation.gait import WaveGait, stand_on
from guara_perception.simulation.world import World
from guara_perception.terrain.map.known_ground import KnownGround
from kinematics import RobotModel, Stance
from kinematics.stance_pose import ENCODER_NOISE


class Landing(NamedTuple):
    """Chosen foothold, in base_footprint of the pause.

    Attributes:
        x, y: position [m].
        leg: leg that swings; None = `next_leg` of the pause.
        body: x and y to which the body moves before the swing [m]; None = the advance of the gait.
    """

    x: float
    y: float
    leg: str | None = None
    body: tuple[float, float] | None = None


# Result of a foothold planner; None = no safe foothold.
Choice = tuple[float, float] | Landing | None

# Margin of the declared ground around the first stance. Behind, it allows for slip; ahead, it reaches the scanned area.
KNOWN_GROUND_MARGIN_M = 0.17
# Largest slide of standing soles as a share of the advance. On real robots and with MuJoCo's position servos, the slide
# is 2 to 8 %, always in the same direction.
MOST_SLIDE = 0.08


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkNoise:
    """Errors of footsteps and of reported stances.

    Attributes:
        joint: standard deviation of the bias of a joint, which is constant during a pause [rad]; `fresh_reading` adds
            the noise of single readings.
        contact: standard deviation of the height of a sole in contact [m].
        slip: standard deviation of a sole's position at touch-down, per horizontal axis [m].
        imu: standard deviation of the reported direction of gravity, per axis [rad]; None = without an IMU, so that
            gravity is not reported.
        creep: standard deviation of the motion of a standing sole between two pauses, per horizontal axis [m].
        slide: distance by which all standing soles slide back together between two pauses, as a share of the body's
            advance. Joint positions do not reveal it. Negative = slide forwards; None = drawn for each walk, up to
            `MOST_SLIDE` in either direction.
    """

    joint: float = 0.0035
    contact: float = 0.0005
    slip: float = 0.001
    imu: float | None = 0.00175
    creep: float = 0.0
    slide: float | None = None

    def __post_init__(self) -> None:
        for name in ("joint", "contact", "slip", "imu", "creep"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value >= 0):
                raise InvalidInput(f"walk noise: {name} is {value}, allowed: finite values of 0 or more")
        if self.slide is not None and not abs(self.slide) <= 0.5:
            raise InvalidInput(f"walk noise: slide is {self.slide}, allowed: -0.5 ... 0.5 of the advance")


@dataclass(frozen=True, slots=True, eq=False)
class Footstep:
    """Step of one foot: chosen foothold and true landing.

    Attributes:
        leg: name of the leg.
        target_in_footprint: x and y of the chosen foothold in base_footprint of the previous pause [m].
        sole_in_world: (3,) position of the sole on the ground [m].
    """

    leg: str
    target_in_footprint: tuple[float, float]
    sole_in_world: tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class WalkPause:
    """Stance pause: the stance as reported by the gait controller, and the truth.

    Attributes:
        step: number of the pause.
        stance: stance as reported, with biased joint positions, support feet, and noisy direction of gravity or None.
        known_ground: ground declared safe by the gait, in base_footprint; empty except at the first pause.
        next_leg: leg that swings after this pause in the order of the gait.
        nominal: nominal foothold of `next_leg`, x and y in base_footprint of this pause [m].
        last_footstep: last footstep before this pause; None at the first pause.
        joint_positions: true joint positions, by joint [rad].
        transform_base_to_world: true pose (4, 4) of the body.
        transform_footprint_to_world: true pose (4, 4) of base_footprint.
        soles_in_world: true position (3,) of each sole [m], by leg.
    """

    step: int
    stance: Stance
    known_ground: tuple[KnownGround, ...]
    next_leg: str
    nominal: tuple[float, float]
    last_footstep: Footstep | None
    joint_positions: Mapping[str, float]
    transform_base_to_world: Float
    transform_footprint_to_world: Float
    soles_in_world: Mapping[str, Float]

    def to_world(self, x: float, y: float) -> tuple[float, float]:
        """Transform a point on the ground from base_footprint of this pause to x and y in the world."""
        point = self.transform_footprint_to_world @ (x, y, 0.0, 1.0)
        return float(point[0]), float(point[1])


class WalkEnded(InvalidInput):
    """The walk cannot continue; the message gives the reason."""


def simulate_walk(
    world: World,
    robot: RobotModel,
    choose: Callable[[WalkPause], Choice] | None = None,
    *,
    cycles: float = 10,
    seed: int = 0,
    noise: WalkNoise | None = None,
) -> Iterator[WalkPause]:
    """Simulate the kinematics of a walk along the world's x axis from the origin.

    Between two pauses, the body moves forward on all feet, then one foot swings. The caller can scan at each pause.
    When the caller asks for the next pause, `choose` is called with the current one to choose the foothold of
    `next_leg`.

    Args:
        world: the terrain; it must be level around the origin, because the gait declares that ground as level.
        robot: the robot.
        choose: returns the foothold in base_footprint of the pause, a pair or a `Landing`, or None if there is no safe
            one; None = every foot lands at its nominal foothold.
        cycles: length of the walk in cycles of all legs.
        seed: seed of the noise.
        noise: errors of footsteps and reports; None = the defaults of `WalkNoise`.

    Yields:
        The pauses, one before the first swing and one after each.

    Raises:
        WalkEnded: the planner found no foothold.
        OutOfReach: a leg cannot reach its foothold.
    """
    gait = WaveGait.of(robot)
    noise = noise or WalkNoise()
    rng = np.random.default_rng(seed)
    slide = np.random.default_rng([seed, 1]).uniform(-MOST_SLIDE, MOST_SLIDE) if noise.slide is None else noise.slide
    length, width = robot.sole
    feet = tuple(robot.legs)
    declared = (KnownGround(gait.support_polygon(KNOWN_GROUND_MARGIN_M), height=0.0, sigma=0.001),)

    def set_down(x: float, y: float) -> Float:
        x, y = x + noise.slip * rng.standard_normal(), y + noise.slip * rng.standard_normal()
        return np.array([x, y, world.sole_height(x, y, length, width) + noise.contact * rng.standard_normal()])

    soles = {leg: set_down(*xy) for leg, xy in gait.first_stance().items()}
    footstep: Footstep | None = None
    farther = aside = 0.0
    for step in range(round(cycles * len(gait.lift_order)) + 1):
        position = (step * gait.advance + farther, aside)
        transform, joints = stand_on(robot, soles, position, gait.hip_height)
        footprint = true_footprint(robot, joints, feet, transform)
        leg = gait.leg_of_swing(step)
        landing = gait.landing(leg)
        # Landing after the body has advanced along x of the world, in base_footprint of this pause.
        target = np.linalg.inv(footprint) @ ((step + 1) * gait.advance + farther + landing[0], landing[1], 0.0, 1.0)
        pause = WalkPause(
            step=step,
            stance=reported_stance(joints, feet, transform, noise, rng),
            known_ground=declared if step == 0 else (),
            next_leg=leg,
            nominal=(float(target[0]), float(target[1])),
            last_footstep=footstep,
            joint_positions=joints,
            transform_base_to_world=transform,
            transform_footprint_to_world=footprint,
            soles_in_world=soles,
        )
        yield pause
        x, y, other, body = chosen_foothold(pause, choose)
        leg = other or leg
        way = gait.advance
        if body is not None:
            ahead, aside = pause.to_world(*body)
            way = ahead - position[0]
            farther += way - gait.advance
        if noise.creep:
            soles = {each: sole + noise.creep * np.append(rng.standard_normal(2), 0.0) for each, sole in soles.items()}
        if slide:
            soles = {each: sole - (slide * way, 0.0, 0.0) for each, sole in soles.items()}
        sole = set_down(*pause.to_world(x, y))
        soles = {**soles, leg: sole}
        footstep = Footstep(leg, (x, y), (float(sole[0]), float(sole[1]), float(sole[2])))


def chosen_foothold(pause: WalkPause, choose: Callable[[WalkPause], Choice] | None) -> Landing:
    """Foothold that the planner chose at a pause.

    Raises:
        WalkEnded: the planner found no foothold.
    """
    choice = pause.nominal if choose is None else choose(pause)
    if choice is None:
        wish = f"x {pause.nominal[0]:.3f}, y {pause.nominal[1]:.3f}"
        raise WalkEnded(f"step {pause.step}: the planner found no safe foothold for leg {pause.next_leg!r} near {wish}")
    return Landing(*choice)


def true_footprint(
    robot: RobotModel, joints: Mapping[str, float], feet: tuple[str, ...], transform_base_to_world: Float
) -> Float:
    """True transform_footprint_to_world (4, 4), from the true joint positions and pose of the body."""
    down = -transform_base_to_world[2, :3]
    pose = robot.stance_pose(Stance(joints, feet, (down[0], down[1], down[2])), find_unloaded=False)
    return np.asarray(transform_base_to_world @ pose.transform_footprint_to_base)


def reported_stance(
    joints: Mapping[str, float],
    feet: tuple[str, ...],
    transform_base_to_world: Float,
    noise: WalkNoise,
    rng: np.random.Generator,
) -> Stance:
    """Stance as reported by encoders and IMU, with their errors."""
    reported = {name: value + noise.joint * rng.standard_normal() for name, value in joints.items()}
    gravity = None
    if noise.imu is not None:
        down = -transform_base_to_world[2, :3] + noise.imu * rng.standard_normal(3)
        down /= np.linalg.norm(down)
        gravity = (float(down[0]), float(down[1]), float(down[2]))
    return Stance(reported, feet, gravity)


def fresh_reading(stance: Stance, rng: np.random.Generator, noise: float = ENCODER_NOISE) -> Stance:
    """Stance with a new reading of the joints, which adds white noise [rad] to the biased positions."""
    joints = {name: value + noise * rng.standard_normal() for name, value in stance.joint_positions.items()}
    return dataclasses.replace(stance, joint_positions=joints)
