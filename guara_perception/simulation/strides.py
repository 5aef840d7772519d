"""A planner that fits its strides to the ground: a small search over the next steps, so that feet land on stones.

It asks the grid nothing that a user's planner could not ask, and has no other source.
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

# One leg swings at a time, hind before front on the same side.
LIFT_ORDER = ("rh", "rf", "lh", "lf")
# All in metres. Where a foot wishes to land, as seen from its hip, and how far aside of its track it may; a strip
# across the track has one candidate, its best place; the height of the hips at which legs must reach their feet.
AHEAD_OF_HIP, ASIDE, STRIP, HIP_HEIGHT = 0.075, 0.08, 0.015, 0.33
# Odometry cannot tell a shorter step from a foot that slipped: such a foot stays. Longer ones are too quick.
SHORTEST_STEP, LONGEST_STEP = 0.060, 0.300
# Costs: none from this clearance on, 1 for a foot that stays or lands this far from its wish; worth of a metre ahead.
WANTED_CLEARANCE, FAR, WORTH = 0.080, 0.100, 20.0
STEPS_AHEAD, BEAM, SWINGS_TRIED = (6, 4, 2, 1), 12, 8
SWING_CLEARANCES = (0.030, 0.020)


class Place(NamedTuple):
    """Place for a foot in base_footprint, its cost, and the bodies (their x) from which the leg reaches it [m]."""

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
        advance: of the body [m].
        start: (3,) where the sole stands, in base_footprint [m].
        swing: path of the sole; None: the foot stays.
    """

    advance: float
    start: Float
    swing: Swing | None


class Way(NamedTuple):
    """Steps that follow one another: their cost, where the feet are then, and the first step."""

    cost: float
    feet: dict[str, Place]
    first: Place | None
    body: float


class StridePlanner:
    """Chooses the next step with those after it in mind.

    Args:
        robot: the robot, whose legs stand below their hips in its scan posture.
    """

    def __init__(self, robot: RobotModel) -> None:
        """Take the robot."""
        self._robot = robot
        soles = robot.state(robot.posture(robot.config.scan_posture)).soles_in_base()
        self._hips = dict(zip(robot.legs, soles, strict=True))

    def next_stride(self, terrain: TerrainGrid, leg: str) -> Stride:
        """The next step of a leg by the newest map.

        Raises:
            InvalidInput: the grid's record has no stance.
        """
        to_footprint, stance = terrain.record.transform_base_to_footprint, terrain.record.stance
        if to_footprint is None or stance is None:
            raise InvalidInput("the grid's record has no stance; allowed: the map of a walk")
        in_base = self._robot.state(stance.joint_positions).soles_in_base()
        soles = dict(zip(self._robot.legs, in_base @ to_footprint[:3, :3].T + to_footprint[:3, 3], strict=True))
        feet = {}
        for name, sole in soles.items():
            x, y, z = sole.tolist()
            place = next(iter(self._reached(name, sole[None], np.zeros(1))), Place(x, y, z, 0.0, 0.0, 0.0))
            # The body stands where it does, whatever the reach at one height says.
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
        """The best place of each strip across the track of a leg."""
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
        """Places with the bodies that reach them."""
        hip, ahead = self._hips[leg], np.arange(-0.3, 0.3, 0.005)
        tried = np.stack(np.broadcast_arrays(hip[0] + ahead, soles[:, 1:2], -HIP_HEIGHT), axis=-1)
        reached = self._robot.reachable(leg, tried)
        return [
            Place(x, y, z, float(cost), x - hip[0] - ahead[row].max(), x - hip[0] - ahead[row].min())
            for (x, y, z), cost, row in zip(soles.tolist(), costs, reached, strict=True)
            if row.any()
        ]

    def _best_way(self, feet: dict[str, Place], leg: str, places: dict[str, list[Place]]) -> Way | None:
        """The best way that was found, many steps rather than few; None: there is none."""
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
        """A way and one more step, to every place that the leg reaches from a body that reaches all feet."""
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
