"""Planner of strides for a robot of four legs that crawls: which leg, where to, and where the body goes meanwhile.

A beam search over the next steps, by what is known of the ground: legs stay within reach with their shanks clear of the
ground, and the centre of mass lies well inside the triangle of the feet that stand. It asks questions that any planner
can ask.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from guara_perception.arrays import Float, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.simulation.footing import AMPLE_M, CELL_M, Footing
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.questions.swing import Swing
from kinematics import RobotModel
from kinematics.transforms import transform_points

STRIDE_M = 0.16
# Window of a foothold around the ideal one, along the way and aside, and how far back it may lie [m].
SHORTER_M, LONGER_M, ASIDE_M, BACK_M = 0.25, 0.20, 0.10, 0.10
# A smaller step on the spot would count as a foot that stayed; width of strips that each give one candidate [m].
PROGRESS, LEAST_WAY_M, STRIP_M = 3.0, 0.04, 0.02
# Of the body over its feet, as shares of its height in the scan posture, and of the centre of mass inside the triangle
# of standing feet [m]; best first.
BODY_HEIGHTS, MARGINS_M = (1.0, 0.92, 0.84), (0.045, 0.035, 0.025)
# To keep from the limits of the joints, standing and in the air [rad].
JOINT_MARGIN, SWING_JOINT_MARGIN = 0.25, 0.10
# Legs also stand on ground that is so much lower, by errors of joints and heights: a straight knee holds the body up
# whatever its torque, and a Guará's is straight 2 mm beyond a margin of 0.25 rad [m].
LOWER_M = 0.005
# Of shanks over the ground, at shares of their length from the foot up [m].
SHANK_CLEARANCE_M = 0.010
SHANK_SHARES = np.array([0.12, 0.25, 0.4, 0.6, 0.8, 1.0])[:, None, None]
# Lengths of plans, and how many are followed at each step.
DEPTHS, WIDTH = (5, 3, 1), 6
DETOURS_M = (0.0, 0.04, -0.04, 0.08, -0.08)
# Footholds tried whose swing the map refuses, and clearances of swings over the map [m].
SWINGS_TRIED, SWING_CLEARANCES = 8, (0.030, 0.020)


@dataclass(frozen=True)
class Stride:
    """Next move, in the frame of the plan: the body shifts on all feet, then a foot swings.

    Attributes:
        leg: the leg that swings.
        target: (3,) where its sole comes down [m].
        body: (4, 4) pose of the body while the foot is in the air.
        margin: of the centre of mass inside the triangle of standing feet [m].
        way: (n, 2) where the foot passes, from its present place to the target [m].
        top: highest ground on its way [m].
        swing: path of the sole that the map accepts; None where no map was asked.
    """

    leg: str
    target: Float
    body: Float
    margin: float
    way: Float
    top: float
    swing: Swing | None = None


class StridePlanner:
    """Planner of a crawl along x that remembers which leg swung last.

    Args:
        robot: the robot; in its scan posture the feet must be below the hips.
        heights: of the body over its feet, best first [m]; None: `BODY_HEIGHTS`.
        lift: clearance of a foot that is lifted straight up, over all of its way, and must reach that high [m]; None:
            feet follow the map's swings, whose reach is not asked.

    Raises:
        InvalidInput: the robot has not four legs.
        kinematics.ArgumentError: its legs are not of hip roll and two or three pitch joints.
    """

    def __init__(self, robot: RobotModel, heights: Sequence[float] | None = None, lift: float | None = None) -> None:
        """Take the robot's legs, its centre of mass, and the places of its feet below the hips."""
        if len(robot.legs) != 4:
            raise InvalidInput(f"robot {robot.name!r} has {len(robot.legs)} legs; allowed: 4, for a planner of strides")
        state = robot.state(robot.posture(robot.config.scan_posture))
        soles = state.soles_in_base()
        self._robot, self._com, self._lanes = robot, state.centre_of_mass_in_base, soles[:, :2]
        self._lift = lift
        self._heights = heights or [-soles[:, 2].mean() * share for share in BODY_HEIGHTS]
        # Hind foot, then fore foot of the same side.
        self._order = sorted(range(4), key=lambda leg: (soles[leg, 1] > 0, soles[leg, 0]))
        self._last = self._order[-1]
        self._limits = []
        for leg in robot.legs:
            columns = [robot.tree.joint_index(joint) for joint in robot.tree.leg(leg).joints]
            robot.shanks(leg, robot.tree.nominal[columns])  # Refuses legs of another build.
            self._limits.append((robot.tree.lower_limits[columns], robot.tree.upper_limits[columns]))

    def next_stride(self, terrain: TerrainGrid) -> Stride | None:
        """Choose the next step on the newest map, in its base_footprint; None if there is no way on.

        Raises:
            InvalidInput: the grid's record has no stance.
        """
        to_footprint, stance = terrain.record.transform_base_to_footprint, terrain.record.stance
        if to_footprint is None or stance is None:
            raise InvalidInput("the grid's record has no stance; give the map of a walk")
        feet = transform_points(to_footprint, self._robot.state(stance.joint_positions).soles_in_base())
        # The body stands aside of the middle of its feet, for balance; their lanes do not follow it.
        aside = np.array([0.0, np.mean(feet[:, 1] - self._lanes[:, 1]), 0.0])
        to_plan = np.eye(4)
        to_plan[:3, 3] = -aside
        footing = Footing.of_map(terrain, to_footprint[:3, 3] - aside, feet - aside, to_plan)
        for _ in range(SWINGS_TRIED):
            stride = self._chosen(footing, feet - aside)
            if stride is None:
                break
            leg, target = self._robot.legs.index(stride.leg), stride.target + aside
            for clearance in SWING_CLEARANCES:
                if swing := terrain.swing(feet[leg], target, clearance):
                    self._last = leg
                    body, way = stride.body.copy(), stride.way + aside[:2]
                    body[:3, 3] += aside
                    return replace(stride, target=target, body=body, way=way, swing=swing)
            footing = footing.without(stride.target, STRIP_M)
        return None

    def next_step(self, footing: Footing, feet: Float) -> Stride | None:
        """Choose the next step from feet (4, 3) in the order of the robot's legs; None if there is no way on."""
        stride = self._chosen(footing, feet)
        if stride is not None:
            self._last = self._robot.legs.index(stride.leg)
        return stride

    def _chosen(self, footing: Footing, feet: Float) -> Stride | None:
        """Best first step; the usual order is tried before others, long plans before short ones."""
        usual = self._order.index(self._last) + 1
        for depth in DEPTHS:
            for first in range(usual, usual + 4):
                legs = [self._order[(first + i) % 4] for i in range(depth)]
                step = self._search(footing, feet, legs)
                way = np.zeros(3) if step is None else step.target - feet[legs[0]]
                # A short plan must get on.
                if step and max(way[0], 0.0 if depth < DEPTHS[0] else np.linalg.norm(way)) > LEAST_WAY_M:
                    return step
        return None

    def _search(self, footing: Footing, feet: Float, legs: list[int]) -> Stride | None:
        nodes: list[tuple[float, Float, Stride | None]] = [(0.0, feet, None)]
        for leg in legs:
            grown: list[tuple[float, Float, Stride | None]] = []
            for cost, at, first in nodes:
                for more, step in self._steps(footing, at, leg):
                    after = at.copy()
                    after[leg] = step.target
                    grown.append((cost + more, after, first or step))
            nodes = sorted(grown, key=lambda node: node[0])[:WIDTH]
        return nodes[0][2] if nodes else None

    def _steps(self, footing: Footing, feet: Float, leg: int) -> Iterator[tuple[float, Stride]]:
        """Possible steps of a leg with their costs: each foothold with the best body that balances and reaches."""
        left = []
        for cost, target in self._footholds(footing, feet, leg):
            way, top = _way(footing, feet[leg], target)
            if np.isfinite(top):
                left.append((cost, target, way, top))
        triangle = np.delete(feet, leg, axis=0)[:, :2]
        for margin in MARGINS_M:
            bodies, numbers = [], []
            for number, (_, target, _, _) in enumerate(left):
                tried = self._bodies(feet, leg, target, triangle, margin)
                bodies += tried
                numbers += [number] * len(tried)
            if not bodies:
                continue
            of_body = np.array(numbers)
            fits = self._fits(footing, feet, leg, [left[number][1:] for number in numbers], np.array(bodies))
            for number in np.unique(of_body[fits]):
                cost, target, way, top = left[number]
                body = bodies[int(np.argmax(fits & (of_body == number)))]  # They come in order of preference.
                lack = (MARGINS_M[0] - margin) / 0.002
                yield cost + lack, Stride(self._robot.legs[leg], target, body, margin, way, top)
            placed = set(of_body[fits].tolist())
            left = [each for number, each in enumerate(left) if number not in placed]

    def _footholds(self, footing: Footing, feet: Float, leg: int) -> Iterator[tuple[float, Float]]:
        """The best foothold in each strip of x around the ideal one, with its cost."""
        x0, lane = self._lanes[leg]
        others = [i for i in range(4) if i != leg]
        ideal = float(np.mean(feet[others, 0] - self._lanes[others, 0])) + x0 + STRIDE_M / 2
        first = np.array([max(ideal - SHORTER_M, feet[leg, 0] - BACK_M), lane - ASIDE_M])
        (i0, i1), (j0, j1) = footing.indices(*np.array([first, (ideal + LONGER_M, lane + ASIDE_M)]).T)
        part = np.s_[i0 : i1 + 1, j0 : j1 + 1]
        x, y = footing.x[i0 : i1 + 1, None], footing.y[None, j0 : j1 + 1]
        lack = np.maximum(AMPLE_M - footing.room[part], 0)
        cost = ((x - ideal) / 0.05) ** 2 + ((y - lane) / 0.05) ** 2 + (lack / 0.012) ** 2
        cost = np.where(footing.safe[part], cost - PROGRESS * (x - feet[leg, 0]) / STRIDE_M, np.inf)
        size = round(STRIP_M / CELL_M)
        for start in range(0, len(x), size):
            rows = cost[start : start + size]
            i, j = np.unravel_index(int(np.argmin(rows)), rows.shape)
            if np.isfinite(rows[i, j]):
                at = i0 + start + i, j0 + j
                yield float(rows[i, j]), np.array([footing.x[at[0]], footing.y[at[1]], footing.heights[at]])

    def _bodies(self, feet: Float, leg: int, target: Float, triangle: Float, margin: float) -> list[Float]:
        """Poses (4, 4) of the body that keep a margin inside the triangle of standing feet, best first."""
        after = feet.copy()
        after[leg] = target
        both = (feet + after) / 2
        body = np.eye(4)
        body[:3, :3] = _along(both)
        offset = (body[:3, :3] @ self._com)[:2]
        # Over the middle of all feet; then so that the way of the foot in the air lies below its hip.
        wishes = np.mean(after[:, :2] - self._lanes, axis=0), both[leg, :2] - self._lanes[leg]
        bodies = []
        for spot in _spots(triangle, wishes, margin):
            for height in self._heights:
                body[:3, 3] = *(spot - offset), both[:, 2].mean() + height
                bodies.append(body.copy())
        return bodies

    def _fits(
        self, footing: Footing, feet: Float, leg: int, ways: list[tuple[Float, Float, float]], bodies: Float
    ) -> Mask:
        """Mask of the bodies (n, 4, 4) under which all feet can stand, before and after, and a lifted foot its way.

        Args:
            footing, feet, leg: where the robot stands.
            ways: target, way and highest ground on it, for each body.
            bodies: poses of the body.
        """
        fits = np.ones(len(bodies), dtype=bool)
        targets = np.array([target for target, _, _ in ways])
        for i in range(4):
            for soles in (feet[i], targets) if i == leg else (feet[i],):
                fits[fits] = self._stands(footing, i, np.broadcast_to(soles, targets.shape)[fits], bodies[fits])
        if self._lift is None:
            return fits
        tops = [max(top, feet[leg, 2], target[2]) + self._lift for target, _, top in ways]
        for k in range(3):
            points = np.array([[*way[k], top] for (_, way, _), top in zip(ways, tops, strict=True)])[fits]
            joints = self._robot.reach_from(self._robot.legs[leg], points, bodies[fits]).joint_positions
            fits[fits] = self._within(leg, joints, SWING_JOINT_MARGIN)
        return fits

    def _stands(self, footing: Footing, leg: int, soles: Float, bodies: Float) -> Mask:
        """Mask of the bodies (n, 4, 4) under which a leg can stand on soles (n, 3), its shank clear of the ground."""
        joints = self._robot.reach_from(self._robot.legs[leg], soles - (0, 0, LOWER_M), bodies).joint_positions
        knees, ends = (
            np.squeeze(bodies[:, :3, :3] @ points[..., None], axis=-1) + bodies[:, :3, 3]
            for points in self._robot.shanks(self._robot.legs[leg], joints)
        )
        points = ends + SHANK_SHARES * (knees - ends)
        highest = footing.shins[footing.indices(*np.moveaxis(np.nan_to_num(points[..., :2]), -1, 0))]
        clear = (points[..., 2] + LOWER_M - highest > SHANK_CLEARANCE_M).all(axis=0)
        return clear & self._within(leg, joints, JOINT_MARGIN)

    def _within(self, leg: int, joints: Float, margin: float) -> Mask:
        """Mask of joint positions (n, joints) with a margin to their limits; NaN is beyond."""
        lower, upper = self._limits[leg]
        return np.asarray(((joints > lower + margin) & (joints < upper - margin)).all(axis=-1))


def _way(footing: Footing, start: Float, target: Float) -> tuple[Float, float]:
    """Path of a foot, straight or around a corner beside what nothing may pass, and the highest ground below it."""
    for aside in DETOURS_M:
        corner = (start + target)[:2] / 2 + (0.0, aside)
        corners = np.array([start[:2], corner, target[:2]])
        points = np.concatenate([np.linspace(*ends, 15) for ends in pairwise(corners)])
        top = float(footing.highest[footing.indices(points[:, 0], points[:, 1])].max())
        if np.isfinite(top):
            return corners, top
    return corners, top


def _along(feet: Float) -> Float:
    """Attitude (3, 3) of a body that lies along its feet; sideways only half as much."""
    flat = np.column_stack((feet[:, :2] - feet[:, :2].mean(0), np.ones(4)))
    slope = np.linalg.lstsq(flat, feet[:, 2])[0]
    (cp, cr), (sp, sr) = (part([-np.arctan(slope[0]), 0.5 * np.arctan(slope[1])]) for part in (np.cos, np.sin))
    return np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]) @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])


def _spots(triangle: Float, wishes: Sequence[Float], margin: float) -> list[Float]:
    """Places of the centre of mass that far inside a triangle: near the first wish, between, and near the others."""
    sides = np.linalg.norm(np.roll(triangle, 1, axis=0) - np.roll(triangle, -1, axis=0), axis=1)
    middle = sides @ triangle / sides.sum()
    (ax, ay), (bx, by) = triangle[1:] - triangle[0]
    inner = abs(ax * by - ay * bx) / sides.sum()  # Radius of the circle inside.
    if inner < margin:
        return []
    corners = middle + (triangle - middle) * (1 - margin / inner)
    first, *others = (_nearest(corners, wish) for wish in wishes)
    return [first, (first + middle) / 2, middle, *others]


def _nearest(corners: Float, wish: Float) -> Float:
    """Place in a triangle that is nearest to a wish."""
    edges = np.roll(corners, -1, axis=0) - corners
    cross = edges[:, 0] * (wish - corners)[:, 1] - edges[:, 1] * (wish - corners)[:, 0]
    if (cross < 0).any() and (cross > 0).any():
        along = np.clip(((wish - corners) * edges).sum(1) / np.maximum((edges**2).sum(1), 1e-12), 0, 1)
        tried = corners + along[:, None] * edges
        return np.asarray(tried[np.argmin(np.linalg.norm(tried - wish, axis=1))])
    return wish
