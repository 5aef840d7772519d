"""Stride planner for a crawling quadruped: next leg, its foothold, and the pose of the body during the swing.

The planner is a beam search over the next steps on the known ground. Every leg stays within reach, with its shank clear
of the ground, and the centre of mass keeps a margin inside the triangle of the standing feet. Only public queries of
the map are used.
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

# Length of an ideal step [m].
STRIDE_M = 0.16
# Window of footholds around the ideal one: backwards, forwards and sideways; and largest step backwards [m].
SHORTER_M, LONGER_M, ASIDE_M, BACK_M = 0.25, 0.20, 0.10, 0.10
# Reward of a step of length STRIDE_M, relative to the costs of `_footholds`; shortest step that counts as progress, and
# width of the strips of ground, each of which gives one candidate foothold [m].
PROGRESS, LEAST_WAY_M, STRIP_M = 3.0, 0.04, 0.02
# Heights of the body above its feet, relative to the scan posture, and margins of the centre of mass inside the
# triangle of standing feet [m]; best first.
BODY_HEIGHTS, MARGINS_M = (1.0, 0.92, 0.84), (0.045, 0.035, 0.025)
# Margins to the joint limits, standing and swinging [rad].
JOINT_MARGIN, SWING_JOINT_MARGIN = 0.25, 0.10
# Depth below a foothold that a leg must still reach, because of errors of joints and heights. A straight knee would
# hold the body up whatever its torque; a Guará's is straight 2 mm beyond a margin of 0.25 rad [m].
LOWER_M = 0.005
# Clearance of shanks above the ground [m], and the points of a shank that are tested, as shares of its length from the
# foot up.
SHANK_CLEARANCE_M = 0.010
SHANK_SHARES = np.array([0.12, 0.25, 0.4, 0.6, 0.8, 1.0])[:, None, None]
# Lengths of plans in steps, in the order of trial, and width of the beam.
DEPTHS, WIDTH = (5, 3, 1), 6
# Sideways offsets of the corner of a foot's path, in the order of trial [m].
DETOURS_M = (0.0, 0.04, -0.04, 0.08, -0.08)
# Largest number of strides tried if the map rejects their swings, and clearances of swings over the map [m].
SWINGS_TRIED, SWING_CLEARANCES = 8, (0.030, 0.020)


@dataclass(frozen=True)
class Stride:
    """Next move, in the frame of the plan: the body shifts on all feet, then one foot swings.

    Attributes:
        leg: leg that swings.
        target: (3,) position at which its sole is set down [m].
        body: (4, 4) pose of the body during the swing.
        margin: distance of the centre of mass from the edges of the triangle of standing feet [m].
        way: (n, 2) corners of the foot's horizontal path, from its present position to the target [m].
        top: highest ground below this path [m].
        swing: path of the sole that the map accepts; None from `next_step`, which queries no map.
    """

    leg: str
    target: Float
    body: Float
    margin: float
    way: Float
    top: float
    swing: Swing | None = None


class StridePlanner:
    """Planner of a crawl along x; it remembers which leg swung last.

    Args:
        robot: the robot; in its scan posture, the feet must be below the hips.
        heights: heights of the body above its feet, best first [m]; None = `BODY_HEIGHTS`.
        lift: height above the ground to which a swinging foot is lifted along its whole path, and which it must be
            able to reach [m]; None = feet follow the swings of the map, whose reach is not checked.

    Raises:
        InvalidInput: the robot does not have four legs.
        kinematics.ArgumentError: the legs do not consist of a hip roll joint and two or three pitch joints.
    """

    def __init__(self, robot: RobotModel, heights: Sequence[float] | None = None, lift: float | None = None) -> None:
        """Read the legs, centre of mass, and positions of the feet from the robot's scan posture."""
        if len(robot.legs) != 4:
            raise InvalidInput(f"robot {robot.name!r} has {len(robot.legs)} legs; allowed: 4, for the stride planner")
        state = robot.state(robot.posture(robot.config.scan_posture))
        soles = state.soles_in_base()
        self._robot, self._com, self._lanes = robot, state.centre_of_mass_in_base, soles[:, :2]
        self._lift = lift
        self._heights = heights or [-soles[:, 2].mean() * share for share in BODY_HEIGHTS]
        # Each hind leg is followed by the fore leg of the same side.
        self._order = sorted(range(4), key=lambda leg: (soles[leg, 1] > 0, soles[leg, 0]))
        self._last = self._order[-1]
        self._limits = []
        for leg in robot.legs:
            columns = [robot.tree.joint_index(joint) for joint in robot.tree.leg(leg).joints]
            robot.shanks(leg, robot.tree.nominal[columns])  # Raises ArgumentError for legs of another structure.
            self._limits.append((robot.tree.lower_limits[columns], robot.tree.upper_limits[columns]))

    def next_stride(self, terrain: TerrainGrid) -> Stride | None:
        """Choose the next step on the newest map, in its base_footprint; None if there is none.

        Raises:
            InvalidInput: the grid's record has no stance.
        """
        to_footprint, stance = terrain.record.transform_base_to_footprint, terrain.record.stance
        if to_footprint is None or stance is None:
            raise InvalidInput("the grid's record has no stance; give the map of a walk")
        feet = transform_points(to_footprint, self._robot.state(stance.joint_positions).soles_in_base())
        # For balance, the body is not centred between its feet. The lanes of the feet do not follow this offset.
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
        """Choose the next step from feet (4, 3), in the order of the robot's legs; None if there is none."""
        stride = self._chosen(footing, feet)
        if stride is not None:
            self._last = self._robot.legs.index(stride.leg)
        return stride

    def _chosen(self, footing: Footing, feet: Float) -> Stride | None:
        """Return the first step of the best plan, from long plans to short ones, each beginning with the usual leg."""
        usual = self._order.index(self._last) + 1
        for depth in DEPTHS:
            for first in range(usual, usual + 4):
                legs = [self._order[(first + i) % 4] for i in range(depth)]
                step = self._search(footing, feet, legs)
                way = np.zeros(3) if step is None else step.target - feet[legs[0]]
                # A short plan must move the foot forwards, a long plan in any direction.
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
        """Yield the possible steps of a leg with their costs: each foothold with the best feasible pose of the body."""
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
                body = bodies[int(np.argmax(fits & (of_body == number)))]  # The poses are in order of preference.
                lack = (MARGINS_M[0] - margin) / 0.002
                yield cost + lack, Stride(self._robot.legs[leg], target, body, margin, way, top)
            placed = set(of_body[fits].tolist())
            left = [each for number, each in enumerate(left) if number not in placed]

    def _footholds(self, footing: Footing, feet: Float, leg: int) -> Iterator[tuple[float, Float]]:
        """Yield the best foothold in each strip along x around the ideal foothold, with its cost."""
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
        """Poses (4, 4) of the body, best first, whose centre of mass keeps a margin inside the triangle of feet."""
        after = feet.copy()
        after[leg] = target
        both = (feet + after) / 2
        body = np.eye(4)
        body[:3, :3] = _along(both)
        offset = (body[:3, :3] @ self._com)[:2]
        # First wish: above the middle of all feet. Second wish: hip of the swinging leg above the middle of its path.
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
        """Mask of the feasible poses: all feet can stand before and after the swing, and the foot can be lifted.

        Args:
            footing, feet, leg: ground, present footholds, and swinging leg.
            ways: target, horizontal path and highest ground below it, for each pose.
            bodies: (n, 4, 4) poses of the body.
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
        """Mask of the poses (n, 4, 4) in which a leg can stand on soles (n, 3) with its shank clear of the ground."""
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
        """Mask of joint positions (n, joints) that keep a margin to their limits; False for NaN."""
        lower, upper = self._limits[leg]
        return np.asarray(((joints > lower + margin) & (joints < upper - margin)).all(axis=-1))


def _way(footing: Footing, start: Float, target: Float) -> tuple[Float, float]:
    """Horizontal path of a foot, straight or around ground that it must not pass, and highest ground below the path."""
    for aside in DETOURS_M:
        corner = (start + target)[:2] / 2 + (0.0, aside)
        corners = np.array([start[:2], corner, target[:2]])
        points = np.concatenate([np.linspace(*ends, 15) for ends in pairwise(corners)])
        top = float(footing.highest[footing.indices(points[:, 0], points[:, 1])].max())
        if np.isfinite(top):
            return corners, top
    return corners, top


def _along(feet: Float) -> Float:
    """Attitude (3, 3) of a body parallel to the plane of its feet in pitch, and inclined by half its slope in roll."""
    flat = np.column_stack((feet[:, :2] - feet[:, :2].mean(0), np.ones(4)))
    slope = np.linalg.lstsq(flat, feet[:, 2])[0]
    (cp, cr), (sp, sr) = (part([-np.arctan(slope[0]), 0.5 * np.arctan(slope[1])]) for part in (np.cos, np.sin))
    return np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]) @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])


def _spots(triangle: Float, wishes: Sequence[Float], margin: float) -> list[Float]:
    """Positions of the centre of mass with a margin inside a triangle, best first.

    They are the one nearest to the first wish, the centre of the inscribed circle, the point halfway between these two,
    and those nearest to the other wishes. Empty if the margin exceeds the radius of the circle.
    """
    sides = np.linalg.norm(np.roll(triangle, 1, axis=0) - np.roll(triangle, -1, axis=0), axis=1)
    middle = sides @ triangle / sides.sum()
    (ax, ay), (bx, by) = triangle[1:] - triangle[0]
    inner = abs(ax * by - ay * bx) / sides.sum()  # Radius of the inscribed circle.
    if inner < margin:
        return []
    corners = middle + (triangle - middle) * (1 - margin / inner)
    first, *others = (_nearest(corners, wish) for wish in wishes)
    return [first, (first + middle) / 2, middle, *others]


def _nearest(corners: Float, wish: Float) -> Float:
    """Point of a triangle that is nearest to a wish."""
    edges = np.roll(corners, -1, axis=0) - corners
    cross = edges[:, 0] * (wish - corners)[:, 1] - edges[:, 1] * (wish - corners)[:, 0]
    if (cross < 0).any() and (cross > 0).any():
        along = np.clip(((wish - corners) * edges).sum(1) / np.maximum((edges**2).sum(1), 1e-12), 0, 1)
        tried = corners + along[:, None] * edges
        return np.asarray(tried[np.argmin(np.linalg.norm(tried - wish, axis=1))])
    return wish
