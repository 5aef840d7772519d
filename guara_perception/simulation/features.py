"""Features of the simulated ground (boxes, rocks, ramps, steps, stairs, pits, patches) and their materials.

Each feature computes the exact height at any point from the height of the ground without the feature.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from guara_perception.arrays import Float, Mask
from guara_perception.exceptions import InvalidInput

DIRECTIONS = ("up", "down")


@dataclass(frozen=True, slots=True, kw_only=True)
class Feature:
    """Base class of features with a rectangular outline.

    Attributes:
        x, y: centre [m].
        size: length and width along the feature's own x and y [m].
        yaw: rotation about z [rad].
        material: name of the material.
    """

    x: float
    y: float
    size: tuple[float, float]
    yaw: float = 0.0
    material: str = "wood"

    def __post_init__(self) -> None:
        _finite(self, "x", "y", "yaw")
        if len(self.size) != 2 or not all(np.isfinite(s) and s > 0 for s in self.size):
            raise InvalidInput(f"size is {tuple(self.size)}, allowed: (length, width), both finite and above 0 m")
        material_index(self.material)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Smallest and largest x, smallest and largest y of the feature [m]."""
        c, s = abs(np.cos(self.yaw)), abs(np.sin(self.yaw))
        half_x, half_y = (c * self.size[0] + s * self.size[1]) / 2, (s * self.size[0] + c * self.size[1]) / 2
        return self.x - half_x, self.x + half_x, self.y - half_y, self.y + half_y

    def local(self, x: Float, y: Float) -> tuple[Float, Float]:
        """Coordinates along the feature's own axes, relative to its centre [m]."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        dx, dy = x - self.x, y - self.y
        return c * dx + s * dy, c * dy - s * dx

    def covers(self, x: Float, y: Float) -> Mask:
        """Mask of the points within the feature's rectangle."""
        u, v = self.local(x, y)
        return (np.abs(u) <= self.size[0] / 2) & (np.abs(v) <= self.size[1] / 2)

    def shape(self, x: Float, y: Float, ground: Float, base: float) -> tuple[Float, Mask]:
        """Heights with this feature, and mask of the points with its material.

        Args:
            x, y: points of any shape [m].
            ground: heights of the points without the feature [m].
            base: height of the ground at the centre of the feature [m].
        """
        return ground, self.covers(x, y)


@dataclass(frozen=True, slots=True, kw_only=True)
class Patch(Feature):
    """Area of the ground with another material and unchanged height."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Raised(Feature):
    """Base class of features that rise up to `height` [m] above the ground at their centre."""

    height: float

    def __post_init__(self) -> None:
        Feature.__post_init__(self)
        _positive(self, "height")

    def rise(self, x: Float, y: Float) -> Float | float:
        """Height of the top above the ground at the feature's centre [m]; -inf where there is no top."""
        return self.height

    def shape(self, x: Float, y: Float, ground: Float, base: float) -> tuple[Float, Mask]:
        """See `Feature.shape`."""
        top = base + self.rise(x, y)
        mask = self.covers(x, y) & (ground < top)
        return np.where(mask, top, ground), mask


@dataclass(frozen=True, slots=True, kw_only=True)
class Box(Raised):
    """Box with a level top."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ramp(Raised):
    """Wedge that rises along its own x from the ground to `height` and ends in a vertical wall."""

    material: str = "concrete"

    def rise(self, x: Float, y: Float) -> Float:
        """See `Raised.rise`."""
        return self.height * (self.local(x, y)[0] / self.size[0] + 0.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rock(Raised):
    """Half an ellipsoid of roughly the given size and height, with bumps determined by `seed`."""

    seed: int = 0
    material: str = "concrete"

    def __post_init__(self) -> None:
        Raised.__post_init__(self)
        check_seed(self.seed)

    def rise(self, x: Float, y: Float) -> Float:
        """See `Raised.rise`."""
        u, v = self.local(x, y)
        u, v = 2 * u / self.size[0], 2 * v / self.size[1]
        rng = np.random.default_rng(self.seed)
        bumps = np.zeros_like(u)
        for _ in range(4):
            a, b, phase = rng.uniform(-4, 4), rng.uniform(-4, 4), rng.uniform(0, 2 * np.pi)
            bumps = bumps + 0.05 * np.sin(a * u + b * v + phase)
        inside = np.clip(1 - u**2 - v**2, 0, None)
        return np.where(inside > 0, self.height * np.sqrt(inside) * (0.8 + bumps), -np.inf)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pit(Feature):
    """Hole with a level bottom at `depth` below the ground at the hole's centre [m]."""

    depth: float
    material: str = "soil"

    def __post_init__(self) -> None:
        Feature.__post_init__(self)
        _positive(self, "depth")

    def shape(self, x: Float, y: Float, ground: Float, base: float) -> tuple[Float, Mask]:
        """See `Feature.shape`."""
        mask = self.covers(x, y)
        return np.where(mask, np.minimum(ground, base - self.depth), ground), mask


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """Step across the whole world: the ground beyond `x` is `height` [m] higher (direction "up") or lower ("down")."""

    x: float
    height: float
    direction: str = "up"
    material: str = "soil"
    count: int = field(default=1, init=False)
    run: float = field(default=1.0, init=False)

    def __post_init__(self) -> None:
        _finite(self, "x")
        _positive(self, "height", "run")
        if isinstance(self.count, bool) or not isinstance(self.count, int) or not 1 <= self.count <= 100:
            raise InvalidInput(f"count is {self.count!r}, allowed: an integer 1 ... 100")
        if self.direction not in DIRECTIONS:
            raise InvalidInput(f"direction is {self.direction!r}, allowed: {', '.join(DIRECTIONS)}")
        material_index(self.material)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Coordinates x of the first and last edge [m], then zeros for y, because steps cross the whole world."""
        return self.x, self.x + (self.count - 1) * self.run, 0.0, 0.0

    def shape(self, x: Float, y: Float, ground: Float, base: float) -> tuple[Float, Mask]:
        """See `Feature.shape`."""
        steps = np.clip(np.floor((x - self.x) / self.run + 1), 0, self.count)
        sign = 1.0 if self.direction == "up" else -1.0
        return ground + sign * self.height * steps, steps > 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Stairs(Step):
    """Flight of `count` steps, each of height `height`, at intervals of `run` [m]; the first is at `x`."""

    count: int
    run: float


AnyFeature = Feature | Step

# Features by their names in world files.
KINDS = {kind.__name__.lower(): kind for kind in (Box, Ramp, Rock, Pit, Patch, Step, Stairs)}


def _finite(owner: object, *names: str) -> None:
    for name in names:
        value = getattr(owner, name)
        if not np.isfinite(value):
            raise InvalidInput(f"{name} is {value}, allowed: finite numbers")


def check_seed(seed: int) -> None:
    """Check that a random generator accepts a seed.

    Raises:
        InvalidInput: the seed is negative.
    """
    if seed < 0:
        raise InvalidInput(f"seed is {seed}, allowed: 0 or more")


def _positive(owner: object, *names: str) -> None:
    for name in names:
        value = getattr(owner, name)
        if not (np.isfinite(value) and value > 0):
            raise InvalidInput(f"{name} is {value}, allowed: finite values above 0 m")


@dataclass(frozen=True, slots=True)
class Material:
    """Optical properties of a surface.

    Attributes:
        name: name in world files.
        albedo: share of red, green and blue light scattered back, 0 ... 1.
        shine: strength of the specular reflection of the laser, 0 ... 1.
        texture: standard deviation of the albedo over the surface, relative to the albedo.
    """

    name: str
    albedo: tuple[float, float, float]
    shine: float = 0.0
    texture: float = 0.08


MATERIALS = (
    Material("soil", (0.28, 0.19, 0.13), texture=0.10),
    Material("wood", (0.38, 0.27, 0.17), texture=0.15),
    Material("concrete", (0.42, 0.42, 0.40), texture=0.08),
    Material("brick", (0.40, 0.13, 0.09), texture=0.12),
    Material("blue", (0.07, 0.12, 0.30), texture=0.10),
    Material("gravel", (0.33, 0.31, 0.28), texture=0.35),
    # Coal, rubber or black cloth. The stripe on it is lost in noise.
    Material("dark", (0.006, 0.006, 0.006), texture=0.10),
    Material("metal", (0.10, 0.10, 0.11), shine=0.7, texture=0.05),
    Material("wet", (0.14, 0.10, 0.07), shine=0.35, texture=0.10),
)

INDEX = {material.name: index for index, material in enumerate(MATERIALS)}


def material_index(name: str) -> int:
    """Index of a material in MATERIALS.

    Raises:
        InvalidInput: there is no such material; the message lists all materials.
    """
    if name not in INDEX:
        raise InvalidInput(f"material is {name!r}, allowed: {', '.join(INDEX)}")
    return INDEX[name]
