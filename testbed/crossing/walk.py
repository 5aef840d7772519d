"""Crossing of a course: steps planned on the robot's knowledge of the ground, and their comparison with the truth."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from guara_perception.arrays import Float
from guara_perception.simulation.strides import Stride, StridePlanner
from guara_perception.simulation.world import World
from kinematics import OdometryLost, RobotModel
from kinematics.transforms import transform_points
from testbed.crossing.courses import SIZES, Course, course
from testbed.crossing.eyes import AllKnowing, Blind, DepthCamera, Eye, Sight
from testbed.crossing.laser import Laser
from testbed.physics.crawl import Crawl, Fell, NoGround
from testbed.physics.guara import ROBOTS
from testbed.physics.robot import LEGS, Robot
from testbed.physics.stiff_crawl import StiffCrawl

MOST_STEPS = 140
# A robot is stopped if it moves by less than STUCK_M in STUCK_STEPS steps.
STUCK_STEPS, STUCK_M = 12, 0.03
# Distance of all feet beyond the goal at which the course is crossed; number of tries for a foot that finds no ground,
# and distance between the tries.
BEYOND_M, MOST_TRIES, ELSEWHERE_M = 0.02, 3, 0.04
# Height difference that counts as an edge, radius of the search for edges, and its resolution.
EDGE_RELIEF_M, EDGE_REACH_M, EDGE_CELL_M = 0.010, 0.08, 0.001
# Height of a target above the ground above which it counts as over a gap.
GAP_M = 0.025
# Share of a sole on the ground below which the sole is badly supported. A fall is caused by the ground if one of the
# last SWINGS_BEFORE soles was badly supported or nearer to an edge than AT_EDGE_M.
SUPPORT, AT_EDGE_M, SWINGS_BEFORE = 0.8, 0.010, 6


@dataclass
class Crossing:
    """Result of a crossing; lengths in metres.

    Attributes:
        course, seed, robot, arm: arguments of `cross`.
        result: "crossed", "stopped" or "fell".
        why: reason for the end of the walk; empty if the course was crossed.
        worst_edge_m: smallest true distance of a target from an edge, negative over a gap.
        targets_over_gap: number of targets without ground below them.
        soles_badly_supported: number of soles with less than `SUPPORT` of their area on the ground.
        standing_s: time for which the robot stood still to observe the ground.
        fell_by_ground: True if, in a fall, one of the last soles was at an edge or badly supported.
        steps, way_m: number of swings, and distance covered by the body.
        trace: leg, target x and y, distance from an edge, and support of the last swings.
        cpu_s: processor time.
    """

    course: str
    seed: int
    robot: str
    arm: str
    result: str = "stopped"
    why: str = ""
    worst_edge_m: float = EDGE_REACH_M
    targets_over_gap: int = 0
    soles_badly_supported: int = 0
    standing_s: float = 0.0
    fell_by_ground: bool = False
    steps: int = 0
    way_m: float = 0.0
    trace: list[tuple[str, float, float, float, float]] = field(default_factory=list)
    cpu_s: float = 0.0

    def to_json(self) -> dict[str, Any]:
        """Convert to plain values; the trace is included only for falls."""
        values = asdict(self)
        if self.result != "fell":
            del values["trace"]
        return {name: round(value, 4) if isinstance(value, float) else value for name, value in values.items()}


def cross(
    kind: str,
    seed: int,
    arm: str,
    report: Callable[[Crossing, Robot, Sight], None] | None = None,
    *,
    robot: str = "go2",
    is_stiff: bool = False,
) -> Crossing:
    """Simulate a walk over a course.

    Args:
        kind, seed: arguments of `course`.
        arm: knowledge of the robot, one of `ARMS`.
        report: called after each swing with the result so far, the robot, and its knowledge before the step.
        robot: one of the `ROBOTS`.
        is_stiff: True = position servos move the robot instead of forces.

    Raises:
        MissingExtra: MuJoCo is not installed.
        StockRobotsMissing: the Go2 is not installed.
    """
    began, way = time.process_time(), course(kind, seed, SIZES[robot])
    walker = ROBOTS[robot](way.world, ROBOTS[robot].start)
    crawl, eye = (StiffCrawl if is_stiff else Crawl)(walker), ARMS[arm](way, walker.product)
    planner = StridePlanner(walker.product, walker.heights, walker.clearance)
    done = Crossing(kind, seed, f"{robot} stiff" if is_stiff else robot, arm)
    start, xs = walker.base[0], [-np.inf] * STUCK_STEPS
    try:
        while done.steps < MOST_STEPS:
            if walker.feet[:, 0].min() > way.goal + BEYOND_M:
                done.result = "crossed"
                break
            xs.append(walker.feet[:, 0].mean())
            if xs[-1] - xs[-1 - STUCK_STEPS] < STUCK_M:
                done.why = "no progress"
                break
            crawl.freeze()
            sight = eye.look(walker)
            done.standing_s += eye.standing_s
            _step(done, walker, crawl, planner, sight, way.world)
            if report:
                report(done, walker, sight)
        else:
            done.why = "steps ran out"
    except (NoGround, OdometryLost) as error:
        done.why = str(error)
    except Fell as error:
        done.result, done.why = "fell", str(error)
        done.fell_by_ground = any(edge < AT_EDGE_M or support < SUPPORT for *_, edge, support in done.trace)
    done.way_m, done.cpu_s = float(walker.base[0] - start), time.process_time() - began
    return done


def _step(done: Crossing, robot: Robot, crawl: Crawl, planner: StridePlanner, sight: Sight, world: World) -> None:
    """Plan and execute one step; if the foot finds no ground, try other footholds.

    Raises:
        NoGround: the planner finds no step, or the foot finds no ground.
        Fell: the robot has fallen.
    """
    known, turn, shift = sight.ground, sight.to_world[:3, :3], sight.to_world[:3, 3]
    for tried in range(MOST_TRIES):
        step = planner.next_step(known, sight.feet)
        if step is None:
            raise NoGround("no step was found")
        leg = LEGS.index(step.leg)
        target = turn @ step.target + shift + sight.foot_errors[leg]
        com = turn @ transform_points(step.body, robot.com_in_base) + shift
        edge, gap = edge_distance(world, target)
        done.worst_edge_m, done.targets_over_gap = min(done.worst_edge_m, edge), done.targets_over_gap + gap
        done.trace = done.trace[1 - SWINGS_BEFORE :]
        done.trace.append((step.leg, *target[:2].round(3).tolist(), edge, 1.0))
        try:
            crawl.step(
                leg, _in_world(step, target, turn, shift), com, turn @ step.body[:3, :3], _top(step, turn, shift)
            )
            break
        except NoGround:
            if tried == MOST_TRIES - 1:
                raise
            known = known.without(step.target, ELSEWHERE_M)
    assert step is not None
    foot = robot.feet[leg]
    share, distance = support(world, foot, robot.product.config.sole), edge_distance(world, foot)[0]
    done.trace[-1] = (step.leg, *target[:2].round(3).tolist(), distance, share)
    done.steps += 1
    done.soles_badly_supported += int(share < SUPPORT)


def _in_world(step: Stride, target: Float, turn: Float, shift: Float) -> Float:
    """Points (n, 3) of the foot's path in the world, above the highest ground; the last is the target."""
    return np.array([*(turn @ np.array([*place, step.top]) + shift for place in step.way[:-1]), target])


def _top(step: Stride, turn: Float, shift: Float) -> float:
    return float((turn @ np.array([*step.target[:2], step.top]) + shift)[2])


def edge_distance(world: World, place: Float) -> tuple[float, bool]:
    """Distance of a foothold from the nearest edge [m], negative over a gap, and True if it is over a gap."""
    d = np.arange(-EDGE_REACH_M, EDGE_REACH_M + EDGE_CELL_M / 2, EDGE_CELL_M)
    dx, dy = np.meshgrid(d, d)
    here = float(world.height(place[0], place[1]))
    other = np.abs(world.height(place[0] + dx, place[1] + dy) - here) > EDGE_RELIEF_M
    distance = float(np.hypot(dx, dy)[other].min(initial=EDGE_REACH_M))
    over = bool(here < place[2] - GAP_M)
    return (-distance if over else distance), over


def support(world: World, foot: Float, sole: tuple[float, float]) -> float:
    """Share of a sole of given length and width [m] that is in contact with the ground, 0 ... 1."""
    dx, dy = np.meshgrid(*(np.linspace(-size / 2, size / 2, 13) for size in sole))
    heights = world.height(foot[0] + dx, foot[1] + dy)
    return float((np.abs(heights - foot[2]) < EDGE_RELIEF_M).mean())


ARMS: dict[str, Callable[[Course, RobotModel], Eye]] = {
    "blind": Blind,
    "depth": DepthCamera,
    "laser": Laser,
    "all_knowing": AllKnowing,
}
