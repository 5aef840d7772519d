"""Foot planner that searches over the next few steps, so that feet can land on stepping stones.

The planner knows the ground only from the layers and queries of the grid, which any planner can use.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.questions.swing import Swing
from kinematics import RobotModel

# Order of the swings: one leg at a time, hind before front on each side.
LIFT_ORDER = ("rh", "rf", "lh", "lf")
# Lengths [m]: nominal landing ahead of the hip; largest lateral distance of a landing from the track of the foot; width
# of the strips across the track, each of which contributes only its best place; and height of the hips above the soles
# in the test of reach.
AHEAD_OF_HIP, ASIDE, STRIP, HIP_HEIGHT = 0.075, 0.08, 0.015, 0.33
# Allowed length of a step [m]. Odometry cannot distinguish a shorter step from a slip; a longer one is too fast.
SHORTEST_STEP, LONGEST_STEP = 0.060, 0.300
# Clearance below which a place costs more [m]; distance from the track or from the nominal landing that costs as much
# as leaving the foot in place [m]; and reward per metre of a step [1/m].
WANTED_CLEARANCE, FAR, WORTH = 0.080, 0.100, 20.0
STEPS_AHEAD, BEAM, SWINGS_TRIED = (6, 4, 2, 1), 12, 8
SWING_CLEARANCES = (0.030, 0.020)


class Place(NamedTuple):
    """Place for a foot in base_footprint [m], its cost, and range of the body's x from which the leg reaches it [m]."""

    x: float
    y: float
    z: float
    cost: float
    rearmost: float
    foremost: float


@dataclass(frozen=True)
class Stride:
    """Next move: advance the body on all feet, then swing a foot.

    Attributes:
        advance: advance of the body before the swing [m].
        start: (3,) current position of the sole in base_footprint [m].
        swing: path of the sole; None if the foot stays in place.
    """

    advance: float
    start: Float
    swing: Swing | None


class Way(NamedTuple):
    """Sequence of steps: cost, places of the feet at the end, place of the first step, body's advance before that step.

    `first` is None before the first step.
    """

    cost: float
    feet: dict[str, Place]
    first: Place | None
    body: float


class StridePlanner:
    """Planner that chooses the next step by a beam search over several steps.

    Args:
        robot: robot with the legs of LIFT_ORDER; in its scan posture, the feet must be below the hips.
    """

    def __init__(self, robot: RobotModel) -> None:
        """Compute the horizontal positions of the hips from the soles in the scan posture."""
        self._robot = robot
        soles = robot.state(robot.posture(robot.config.scan_posture)).soles_in_base()
        self._hips = dict(zip(robot.legs, soles, strict=True))

    def next_stride(self, terrain: TerrainGrid, leg: str) -> Stride:
        """Choose the next stride of a leg on the newest map.

        The foot stays in place if that is the best choice. Foot and body stay in place if no stride is found.

        Raises:
            InvalidInput: the grid's record lacks the stance, the body's pose or the limits.
        """
        to_footprint, stance = terrain.record.transform_base_to_footprint, terrain.record.stance
        if to_footprint is None or stance is None:
            raise InvalidInput("the grid's record has no stance; give the map of a walk")
        in_base = self._robot.state(stance.joint_positions).soles_in_base()
        soles = dict(zip(self._robot.legs, in_base @ to_footprint[:3, :3].T + to_footprint[:3, 3], strict=True))
        feet = {}
        for name, sole in soles.items():
            x, y, z = sole.tolist()
            place = next(iter(self._reached(name, sole[None], np.zeros(1))), Place(x, y, z, 0.0, 0.0, 0.0))
            # All feet are within reach at the current position, even if the test at a single height disagrees.
            feet[name] = place._replace(rearmost=min(place.rearmost, 0.0), foremost=max(place.foremost, 0.0))
        places = {name: self._places(terrain, name) for name in soles}
        for _ in range(SWINGS_TRIED):
            way = self._best_way(feet, leg, places)
            if way is None or way.first is None:
                break
            if way.first is feet[leg]:
                return Stride(way.body, soles[leg], None)
            for clearance in SWING_CLEARANCES:
                if swing := terrain.swing(soles[leg], way.first[:3], clearance):
                    return Stride(way.body, soles[leg], swing)
            places[leg].remove(way.first)
        return Stride(0.0, soles[leg], None)

    def _places(self, terrain: TerrainGrid, leg: str) -> list[Place]:
        """Best safe place in each strip across the track of a leg, if it is within reach."""
        track = self._hips[leg][1]
        x, y = np.meshgrid(*terrain.geometry.centres())
        near = np.abs(y - track) <= ASIDE
        x, y, clearance = x[near], y[near], terrain.clearance[near]
        cost = ((y - track) / FAR) ** 2 + np.maximum(1 - clearance / WANTED_CLEARANCE, 0) ** 2
        cost = np.where(terrain.check_foothold(x, y).ok, cost, np.inf)
        strips = np.floor(x / STRIP)
        order = np.lexsort((cost, strips))
        best = order[np.append(True, np.diff(strips[order]) > 0)]
        best = best[np.isfinite(cost[best])]
        soles = np.column_stack((x, y, terrain.height_at(x, y)))[best]
        return self._reached(leg, soles, cost[best])

    def _reached(self, leg: str, soles: Float, costs: Float) -> list[Place]:
        """Places within reach, each with the range of the body's x from which the leg reaches it."""
        hip, ahead = self._hips[leg], np.arange(-0.3, 0.3, 0.005)
        tried = np.stack(np.broadcast_arrays(hip[0] + ahead, soles[:, 1:2], -HIP_HEIGHT), axis=-1)
        reached = self._robot.reachable(leg, tried)
        return [
            Place(x, y, z, float(cost), x - hip[0] - ahead[row].max(), x - hip[0] - ahead[row].min())
            for (x, y, z), cost, row in zip(soles.tolist(), costs, reached, strict=True)
            if row.any()
        ]

    def _best_way(self, feet: dict[str, Place], leg: str, places: dict[str, list[Place]]) -> Way | None:
        """Best sequence of the largest number of steps for which one is found; None if there is none."""
        for steps in STEPS_AHEAD:
            ways = [Way(0.0, feet, None, 0.0)]
            for number in range(steps):
                turn = LIFT_ORDER[(LIFT_ORDER.index(leg) + number) % len(LIFT_ORDER)]
                grown = [longer for way in ways for longer in self._steps(way, turn, places[turn])]
                ways = sorted(grown, key=lambda way: way.cost)[:BEAM]
            if ways:
                return ways[0]
        return None

    def _steps(self, way: Way, leg: str, places: list[Place]) -> Iterator[Way]:
        """Extend a sequence by a step to each place, or by leaving the foot in place, if all feet stay within reach."""
        here = way.feet[leg]
        centre = np.mean([place.x - self._hips[name][0] for name, place in way.feet.items()])
        rear = max(place.rearmost for place in way.feet.values())
        fore = min(place.foremost for place in way.feet.values())
        for place in (*places, here):
            ahead = place.x - here.x
            if place is not here and not SHORTEST_STEP <= ahead <= LONGEST_STEP:
                continue
            low, high = max(rear, place.rearmost), min(fore, place.foremost)
            if low > high:
                continue
            body = float(np.clip(centre + ahead / len(self._hips), low, high))
            off_wish = (place.x - body - self._hips[leg][0] - AHEAD_OF_HIP) / FAR
            cost = 1.0 if place is here else place.cost + off_wish**2 - WORTH * ahead
            first = way.first or place
            yield Way(way.cost + cost, {**way.feet, leg: place}, first, way.body if way.first else body)
