"""Choice of the next step: beam search over the next ones, on ground that is known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from guara_perception.arrays import Float, Mask
from testbed.crossing.crawl import CLEARANCE_M, turned
from testbed.crossing.ground import AMPLE_M, CELL_M, KnownGround
from testbed.crossing.robot import FOOT_RADIUS_M, SIDE, Legs

# Hind foot, then fore foot of the same side.
ORDER = (3, 1, 2, 0)
STRIDE_M = 0.16
# Window of a foothold around the ideal one, along the way and aside, and how far back it may lie [m].
SHORTER_M, LONGER_M, ASIDE_M, BACK_M = 0.16, 0.13, 0.06, 0.10
PROGRESS, LEAST_WAY_M, BIN_M = 3.0, 0.04, 0.02
# Of the body over its feet, and of the centre of mass inside the triangle of standing feet, best first [m].
BODY_HEIGHTS_M, MARGINS_M = (0.295, 0.27, 0.245), (0.045, 0.035, 0.025)
# From thigh to foot in the plane of the leg, standing and in the air [m].
LEG_M, SWING_LEG_M = (0.16, 0.36), (0.11, 0.37)
CALF_CLEARANCE_M, LARGEST_ROLL = 0.010, 0.8
CALF_SHARES = np.array([0.12, 0.25, 0.4, 0.6, 0.8, 1.0])
DEPTHS, WIDTH = (5, 3, 1), 6
DETOURS_M = (0.0, 0.04, -0.04, 0.08, -0.08)


@dataclass(frozen=True)
class Step:
    """A step and the body's pose during it, in the frame of the ground.

    Attributes:
        leg: index of the leg.
        target: place (3,) of the foot [m].
        base: position (3,) of the body while the foot is in the air [m].
        rotation: its attitude.
        margin: of the centre of mass inside the triangle of standing feet [m].
        way: (n, 2) where the foot passes, from its present place to the target [m].
        top: highest ground on its way [m].
    """

    leg: int
    target: Float
    base: Float
    rotation: Float
    margin: float
    way: Float
    top: float


class Planner:
    """Chooses steps for a robot that goes along x."""

    def __init__(self, legs: Legs, com_in_base: Float) -> None:
        """Take the robot's legs and its centre of mass."""
        self._legs, self._com, self._last = legs, com_in_base, ORDER[-1]

    def next_step(self, ground: KnownGround, feet: Float) -> Step | None:
        """The next step from feet (4, 3), or None if there is no way on.

        The usual order is tried before others, long plans before short ones.
        """
        usual = ORDER.index(self._last) + 1
        for depth in DEPTHS:
            for first in range(usual, usual + 4):
                step = self._search(ground, feet, [ORDER[(first + i) % 4] for i in range(depth)])
                # A small step on the spot would count as a foot that stayed; a short plan must get on.
                way = np.zeros(3) if step is None else step.target - feet[step.leg]
                if step and max(way[0], 0.0 if depth < DEPTHS[0] else np.linalg.norm(way)) > LEAST_WAY_M:
                    self._last = step.leg
                    return step
        return None

    def _search(self, ground: KnownGround, feet: Float, legs: list[int]) -> Step | None:
        nodes: list[tuple[float, Float, Step | None]] = [(0.0, feet, None)]
        for leg in legs:
            grown: list[tuple[float, Float, Step | None]] = []
            for cost, at, first in nodes:
                for more, step in self._steps(ground, at, leg):
                    after = at.copy()
                    after[leg] = step.target
                    grown.append((cost + more, after, first or step))
            nodes = sorted(grown, key=lambda node: node[0])[:WIDTH]
        return nodes[0][2] if nodes else None

    def _steps(self, ground: KnownGround, feet: Float, leg: int) -> Iterator[tuple[float, Step]]:
        """Possible steps of a leg with their costs."""
        for cost, target in self._footholds(ground, feet, leg):
            step = self._with_body(ground, feet, leg, target)
            if step is not None:
                yield cost + (MARGINS_M[0] - step.margin) / 0.002, step

    def _footholds(self, ground: KnownGround, feet: Float, leg: int) -> Iterator[tuple[float, Float]]:
        """The best foothold in each bin of x around the ideal one, with its cost."""
        hips, lane = self._legs.hips[:, 0], self._legs.lanes[leg]
        others = [i for i in range(4) if i != leg]
        ideal = float(np.mean(feet[others, 0] - hips[others])) + hips[leg] + STRIDE_M / 2
        first = np.array([max(ideal - SHORTER_M, feet[leg, 0] - BACK_M), lane - ASIDE_M])
        (i0, i1), (j0, j1) = ground.indices(*np.array([first, (ideal + LONGER_M, lane + ASIDE_M)]).T)
        part = np.s_[i0 : i1 + 1, j0 : j1 + 1]
        x, y = ground.x[i0 : i1 + 1, None], ground.y[None, j0 : j1 + 1]
        lack = np.maximum(AMPLE_M - ground.room[part], 0)
        cost = ((x - ideal) / 0.05) ** 2 + ((y - lane) / 0.05) ** 2 + (lack / 0.012) ** 2
        cost = np.where(ground.safe[part], cost - PROGRESS * (x - feet[leg, 0]) / STRIDE_M, np.inf)
        size = round(BIN_M / CELL_M)
        for start in range(0, len(x), size):
            rows = cost[start : start + size]
            i, j = np.unravel_index(int(np.argmin(rows)), rows.shape)
            if np.isfinite(rows[i, j]):
                at = i0 + start + i, j0 + j
                yield float(rows[i, j]), np.array([ground.x[at[0]], ground.y[at[1]], ground.heights[at]])

    def _with_body(self, ground: KnownGround, feet: Float, leg: int, target: Float) -> Step | None:
        """The step with a body that balances on the other feet and reaches all four, or None."""
        way, top = _way(ground, feet[leg], target)
        if not np.isfinite(top):
            return None
        after = feet.copy()
        after[leg] = target
        both = (feet + after) / 2
        rotation = _along(both)
        sides = np.column_stack((np.zeros(4), SIDE * self._legs.width, np.zeros(4)))
        wish = np.mean(after - self._legs.hips - sides, axis=0)[:2]
        triangle = np.delete(feet, leg, axis=0)[:, :2]
        places = [(s, m) for m in MARGINS_M for s in _spots(triangle, wish, m)]
        if not places:
            return None
        offset = (rotation @ self._com)[:2]
        bodies = np.array([[*(s - offset), both[:, 2].mean() + h] for s, _ in places for h in BODY_HEIGHTS_M])
        fits = self._reaches(ground, feet, bodies, rotation) & self._reaches(ground, after, bodies, rotation)
        fits &= self._swings(
            leg, np.column_stack((way, np.full(3, max(top, feet[leg, 2], target[2])))), bodies, rotation
        )
        if not fits.any():
            return None
        best = int(np.argmax(fits))  # They come in order of preference.
        return Step(leg, target, bodies[best], rotation, places[best // len(BODY_HEIGHTS_M)][1], way, top)

    def _reaches(self, ground: KnownGround, feet: Float, bodies: Float, rotation: Float) -> Mask:
        """Mask of the bodies (n,) under which all feet can stand there, calves clear of the ground."""
        legs, balls = self._legs, feet + (0, 0, FOOT_RADIUS_M)
        in_base = (balls - bodies[:, None]) @ rotation
        angles, knees = legs.joints(in_base)
        length = np.sqrt(np.maximum(((in_base - legs.hips) ** 2).sum(-1) - legs.width**2, 0))
        fits = (length > LEG_M[0]) & (length < LEG_M[1]) & (np.abs(angles[..., 0]) < LARGEST_ROLL)
        fits &= np.isfinite(angles).all(-1)
        knees = np.nan_to_num(knees) @ rotation.T + bodies[:, None]
        points = balls + CALF_SHARES[:, None, None, None] * (knees - balls)
        highest = ground.shins[ground.indices(points[..., 0], points[..., 1])]
        fits &= (points[..., 2] - highest > CALF_CLEARANCE_M).all(0)
        return np.asarray(fits.all(-1))

    def _swings(self, leg: int, way: Float, bodies: Float, rotation: Float) -> Mask:
        """Mask of the bodies under which the foot reaches its way (n, 3) at the height of a swing."""
        in_base = (way + (0, 0, CLEARANCE_M + FOOT_RADIUS_M) - bodies[:, None]) @ rotation - self._legs.hips[leg]
        length = np.sqrt(np.maximum((in_base**2).sum(-1) - self._legs.width**2, 0))
        return np.asarray(((length > SWING_LEG_M[0]) & (length < SWING_LEG_M[1])).all(-1))


def _way(ground: KnownGround, start: Float, target: Float) -> tuple[Float, float]:
    """Path of a foot, straight or around a corner beside what nothing may pass, and the highest ground below it."""
    for aside in DETOURS_M:
        corner = (start + target)[:2] / 2 + (0.0, aside)
        corners = np.array([start[:2], corner, target[:2]])
        points = np.concatenate([np.linspace(*ends, 15) for ends in pairwise(corners)])
        top = float(ground.highest[ground.indices(points[:, 0], points[:, 1])].max())
        if np.isfinite(top):
            return corners, top
    return corners, top


def _along(feet: Float) -> Float:
    """Attitude of a body that lies along its feet; sideways only half as much."""
    flat = np.column_stack((feet[:, :2] - feet[:, :2].mean(0), np.ones(4)))
    slope = np.linalg.lstsq(flat, feet[:, 2])[0]
    return turned(-np.arctan(slope[0]), 0.5 * np.arctan(slope[1]))


def _spots(triangle: Float, wish: Float, margin: float) -> list[Float]:
    """Places of the centre of mass that far inside a triangle, the nearest to the wish first."""
    sides = np.linalg.norm(np.roll(triangle, 1, axis=0) - np.roll(triangle, -1, axis=0), axis=1)
    middle = sides @ triangle / sides.sum()
    (ax, ay), (bx, by) = triangle[1:] - triangle[0]
    inner = abs(ax * by - ay * bx) / sides.sum()  # Radius of the circle inside.
    if inner < margin:
        return []
    corners = middle + (triangle - middle) * (1 - margin / inner)
    edges = np.roll(corners, -1, axis=0) - corners
    cross = edges[:, 0] * (wish - corners)[:, 1] - edges[:, 1] * (wish - corners)[:, 0]
    nearest = wish
    if (cross < 0).any() and (cross > 0).any():
        along = np.clip(((wish - corners) * edges).sum(1) / np.maximum((edges**2).sum(1), 1e-12), 0, 1)
        tried = corners + along[:, None] * edges
        nearest = tried[np.argmin(np.linalg.norm(tried - wish, axis=1))]
    return [nearest, (nearest + middle) / 2, middle]
