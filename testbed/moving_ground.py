"""Ground with parts that move from pause to pause: boards, carpets, a cart, a dog, a door, ground beside a platform."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import reduce

import numpy as np

import guara_perception as gp
from guara_perception.arrays import Float, Mask
from kinematics import RobotModel
from kinematics.transforms import transform_points
from testbed.analytic_walk import CAMERA_IN_BASE, LASER_IN_BASE, Ground, scan, walk
from testbed.ground_pictures import ground_picture
from testbed.scanned_walk import WalkedPause, footprint_to_world

NO_RAMP = np.zeros((3, 2))


@dataclass(frozen=True)
class Blocks(Ground):
    """Boxes and dark patches on a plane, without the ramp, rough ground and trench of `Ground`."""

    def height_at(self, x: Float, y: Float) -> Float:
        """True height in the world [m]."""
        x, y = np.broadcast_arrays(x, y)
        height = np.zeros(x.shape)
        for bx, by, length, width, top in self.boxes:
            height[(np.abs(x - bx) < length / 2) & (np.abs(y - by) < width / 2)] += top
        return height


@dataclass(frozen=True)
class Part:
    """Moving part of the ground.

    Attributes:
        area: x0, x1, y0, y1 of the part at rest, or of the window in which it is visible [m].
        ground: relief of the part, in coordinates that move with it.
        rise: height of the part above the plane of the world [m].
        speed: motion per pause along x, y and z [m].
        turn: rotation per pause about the corner (x0, y0) [rad].
        first, last: pauses between which the part moves.
        breath: amplitude of an oscillation of the height from pause to pause [m].
        is_window: True = the area is fixed, and the part moves through it.
    """

    area: tuple[float, float, float, float]
    ground: Ground
    rise: float = 0.0
    speed: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: float = 0.0
    first: int = 0
    last: int = 1000
    breath: float = 0.0
    is_window: bool = False

    def moved(self, step: int) -> int:
        """Number of pauses for which the part has moved."""
        return min(max(step - self.first, 0), self.last - self.first)

    def own(self, step: int, x: Float, y: Float) -> tuple[Float, Float, Mask]:
        """Coordinates of points relative to the part, and mask of the points on the part."""
        moved = self.moved(step)
        x0, x1, y0, y1 = self.area
        u, v = x - self.speed[0] * moved - x0, y - self.speed[1] * moved - y0
        cosine, sine = np.cos(self.turn * moved), np.sin(self.turn * moved)
        u, v = cosine * u + sine * v + x0, cosine * v - sine * u + y0
        at_x, at_y = (x, y) if self.is_window else (u, v)
        return u, v, (at_x > x0) & (at_x < x1) & (at_y > y0) & (at_y < y1)

    def height(self, step: int) -> float:
        """Height of the part above the plane of the world at a pause [m]."""
        return self.rise + self.speed[2] * self.moved(step) + self.breath * float(np.sin(1.7 * step))

    def carried(self, step: int, foot: Float) -> Float:
        """Position at pause `step` of a foot that stood at `foot` at the previous pause, moved by this part."""
        x, y = foot[:1], foot[1:2]
        if not self.own(step - 1, x, y)[2][0]:
            return foot
        moved = self.moved(step) - self.moved(step - 1)
        return foot + moved * np.array(self.speed)


@dataclass(frozen=True)
class MovingGround(Ground):
    """Fixed ground with moving parts, at one pause."""

    still: Ground = field(default_factory=lambda: blocks())
    parts: tuple[Part, ...] = ()
    step: int = 0

    def at(self, step: int) -> MovingGround:
        """Return the ground at a pause."""
        return replace(self, step=step)

    def carried(self, step: int, foot: Float) -> Float:
        """See `Ground.carried`."""
        return reduce(lambda place, part: part.carried(step, place), self.parts, foot)

    def height_at(self, x: Float, y: Float) -> Float:
        """True height in the world [m]."""
        x, y = np.broadcast_arrays(x, y)
        height = np.array(self.still.height_at(x, y))
        for part in self.parts:
            u, v, inside = part.own(self.step, x, y)
            height[inside] = part.height(self.step) + part.ground.height_at(u[inside], v[inside])
        return height

    def own(self, x: Float, y: Float) -> tuple[Float, Float]:
        """See `Ground.own`; each part has its own coordinates."""
        own_x, own_y = np.array(x), np.array(y)
        for number, part in enumerate(self.parts, 1):
            u, v, inside = part.own(self.step, x, y)
            own_x[inside], own_y[inside] = u[inside] + 0.37 * number, v[inside] + 0.23 * number
        return own_x, own_y

    def is_dark(self, x: Float, y: Float) -> Mask:
        """Mask of the points where the ground absorbs the laser light."""
        x, y = np.broadcast_arrays(x, y)
        dark = np.array(self.still.is_dark(x, y))
        for part in self.parts:
            u, v, inside = part.own(self.step, x, y)
            dark[inside] = part.ground.is_dark(u[inside], v[inside])
        return dark

    def lowest_at(self, x: Float, y: Float) -> Float:
        """Lowest height of each point up to this pause [m]."""
        steps = range(self.step + 1) if self.parts else (self.step,)
        return np.minimum.reduce([self.at(step).height_at(x, y) for step in steps])


def blocks(boxes: Float | None = None, dark: Float | None = None) -> Blocks:
    """Create boxes (n, 5) and dark patches (n, 3) on a plane, in the form of `Ground`."""
    return Blocks(np.empty((0, 5)) if boxes is None else boxes, np.empty((0, 3)) if dark is None else dark, NO_RAMP)


def scattered(seed: int, x: tuple[float, float], y: tuple[float, float], count: int, dark: int = 0) -> Blocks:
    """Create boxes 10 to 25 mm high, and dark patches, at random positions in an area."""
    rng = np.random.default_rng(7000 + seed)
    boxes = np.column_stack(
        (
            rng.uniform(*x, count),
            rng.uniform(*y, count),
            rng.uniform(0.05, 0.15, count),
            rng.uniform(0.03, 0.08, count),
            rng.choice([0.010, 0.015, 0.025], count),
        )
    )
    spots = np.column_stack((rng.uniform(*x, dark), rng.uniform(*y, dark), rng.uniform(0.012, 0.025, dark)))
    return blocks(boxes, spots)


def ribs(seed: int, length: float = 6.0) -> Blocks:
    """Create dark patches, and unevenly spaced ribs along the path, 8 or 15 mm high, beside the tracks of the feet."""
    rng = np.random.default_rng(8000 + seed)
    aside = np.array([-0.29, -0.24, -0.10, -0.03, 0.07, 0.12, 0.25, 0.31]) + rng.uniform(-0.01, 0.01, 8)
    boxes = np.column_stack(
        (np.zeros(8), aside, np.full(8, 2 * length), np.full(8, 0.02), rng.choice([0.008, 0.015], 8))
    )
    spots = np.column_stack((rng.uniform(0.5, 2.5, 6), rng.uniform(-0.25, 0.25, 6), rng.uniform(0.015, 0.03, 6)))
    return blocks(boxes, spots)


def still_mixed(seed: int) -> MovingGround:
    """Fixed ground with boxes, a ramp, rough ground and a trench."""
    return _world(Ground.random(seed))


def still_ribs(seed: int) -> MovingGround:
    """Fixed ground with ribs along the path."""
    return _world(ribs(seed))


def board(seed: int) -> MovingGround:
    """Level ground with a board beside the tracks of the feet that is pushed by 5 mm per pause."""
    return _world(blocks(), Part((0.4, 3.5, -0.12, -0.06), blocks(), rise=0.018, speed=(0.0, 0.005, 0.0)))


def pulled_carpet(speed: float) -> Callable[[int], MovingGround]:
    """Carpet with objects on it that is pulled sideways from pause 3 to 19."""

    def carpet(seed: int) -> MovingGround:
        relief = scattered(seed, (1.0, 2.4), (-0.7, 0.5), 60, dark=20)
        return _world(
            scattered(seed + 50, (2.4, 3.0), (-0.3, 0.3), 6),
            Part((1.0, 2.4, -1.0, 1.0), relief, speed=(0.0, speed, 0.0), first=3, last=19, is_window=True),
        )

    return carpet


def conveyor(seed: int) -> MovingGround:
    """Belt that runs across the path by 5 mm per pause, also under standing feet."""
    relief = scattered(seed, (0.9, 1.5), (-0.7, 0.5), 40, dark=10)
    return _world(
        scattered(seed + 50, (1.5, 3.0), (-0.3, 0.3), 14),
        Part((0.9, 1.5, -1.0, 1.0), relief, speed=(0.0, 0.005, 0.0), is_window=True),
    )


def two_things(seed: int) -> MovingGround:
    """Level ground with two boards that move at different speeds."""
    one = Part((0.4, 3.5, -0.12, -0.07), blocks(), rise=0.018, speed=(0.0, 0.003, 0.0))
    other = Part((0.4, 3.5, 0.24, 0.28), blocks(), rise=0.025, speed=(0.0, 0.004, 0.0))
    return _world(blocks(), one, other)


def cart(seed: int) -> MovingGround:
    """Ribs, and a cart in the track of the left feet that rolls by 6 mm per pause, with the foot on it."""
    return _world(ribs(seed), Part((1.0, 1.35, 0.10, 0.24), blocks(), rise=0.03, speed=(0.006, 0.002, 0.0), first=8))


def dog(seed: int) -> MovingGround:
    """Ribs, and a breathing dog that lies down between the tracks."""
    lying = Part(
        (1.0, 1.3, -0.11, 0.08),
        scattered(seed, (1.0, 1.3), (-0.11, 0.08), 5),
        rise=0.11,
        speed=(0.0, 0.003, -0.008),
        first=6,
        last=14,
        breath=0.003,
    )
    return _world(ribs(seed), lying)


def door(seed: int) -> MovingGround:
    """Level ground with a door beside the path, whose edge moves by 5 mm per pause."""
    return _world(blocks(), Part((0.7, 1.3, -0.34, -0.31), blocks(), rise=0.10, turn=0.008, last=20))


def all_seen(seed: int) -> MovingGround:
    """All visible ground moves by 5 mm per pause, while the robot stands."""
    relief = scattered(seed, (0.4, 1.2), (-0.7, 0.5), 40, dark=10)
    return _world(blocks(), Part((0.45, 3.0, -2.0, 2.0), relief, speed=(0.0, 0.005, 0.0), is_window=True))


def platform(seed: int) -> MovingGround:
    """Moving platform, which is the world here: the lower ground at its sides moves by 5 mm per pause."""
    beside = [scattered(seed + side, (-0.5, 3.0), (-1.0, 1.0), 150) for side in (0, 1)]
    sides = ((-3.0, 6.0, 0.24, 2.0), (-3.0, 6.0, -2.0, -0.24))
    parts = (
        Part(area, ground, rise=-0.03, speed=(0.0, -0.005, 0.0), is_window=True)
        for area, ground in zip(sides, beside, strict=True)
    )
    return _world(ribs(seed), *parts)


def _world(still: Ground, *parts: Part) -> MovingGround:
    return MovingGround(still.boxes, still.dark, still.phases, still, parts)


WORLDS: dict[str, Callable[[int], MovingGround]] = {
    "still, mixed": still_mixed,
    "still, ribs": still_ribs,
    "board pushed": board,
    "carpet, 7 mm": pulled_carpet(0.007),
    "carpet, 10 mm": pulled_carpet(0.010),
    "conveyor": conveyor,
    "two things": two_things,
    "cart under a foot": cart,
    "dog lies down": dog,
    "door": door,
    "all seen, robot stands": all_seen,
    "platform": platform,
}
STANDING = ("all seen, robot stands",)


@dataclass(frozen=True)
class MovingPause(WalkedPause):
    """Pause on moving ground."""

    ground: MovingGround


def pauses_of(robot: RobotModel, name: str, seed: int, cycles: int, *, pictures: bool = False) -> Iterator[MovingPause]:
    """Yield the pauses of a walk over one of `WORLDS`."""
    ground = WORLDS[name](seed)
    camera = np.eye(4)
    camera[:3, 3] = CAMERA_IN_BASE
    for pause in walk(robot, ground, cycles, seed, stands=name in STANDING):
        terrain = scan(robot, ground, pause, seed)
        to_footprint = terrain.scan_record.transform_base_to_footprint
        assert to_footprint is not None
        laser = transform_points(to_footprint, LASER_IN_BASE)
        record = replace(terrain.scan_record, transform_camera_to_base=camera, laser_origin=laser, stripes_planned=70)
        terrain = gp.TerrainGrid(
            layers=terrain.layers, geometry=terrain.geometry, stamp=terrain.stamp, step=terrain.step, record=record
        )
        to_world = footprint_to_world(pause.transform_base_to_world, terrain)
        picture = ground_picture(robot, ground, pause, seed) if pictures else None
        yield MovingPause(pause.stance, terrain, to_world, ground=ground.at(pause.step), picture=picture)
