"""`World`: the simulated terrain, its exact height and material at any point."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Codes, Float
from guara_perception.exceptions import InvalidInput
from guara_perception.simulation.features import AnyFeature, Step
from guara_perception.simulation.light import Light
from guara_perception.simulation.materials import material_index

UNDULATION_WAVES = 6
SHORTEST_WAVE_M = 0.25
LONGEST_WAVE_M = 1.0


@dataclass(frozen=True, slots=True)
class World:
    """A piece of ground with what stands on it; z = 0 is the ground without undulation.

    Beyond its area the ground goes on as it is at the border.

    Attributes:
        x: smallest and largest x of the area [m].
        y: smallest and largest y [m].
        features: what stands on the ground, in the order in which it is put down; each feature stands on those before.
        material: material of the bare ground.
        undulation: standard deviation of the bare ground about z = 0 [m].
        seed: seed of undulation and texture.
        flat_until: no undulation before this x [m]; it sets in smoothly over 0.2 m.
        light: light in which the world is seen.
    """

    x: tuple[float, float] = (-1.0, 3.0)
    y: tuple[float, float] = (-1.0, 1.0)
    features: tuple[AnyFeature, ...] = ()
    material: str = "soil"
    undulation: float = 0.0
    seed: int = 0
    flat_until: float = -np.inf
    light: Light = field(default_factory=Light)
    _bases: tuple[float, ...] = field(default=(), init=False, repr=False)
    _waves: Float = field(default_factory=lambda: np.zeros((0, 3)), init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check, and find out what each feature stands on.

        Raises:
            InvalidInput: an empty area, a feature outside it, a negative undulation.
        """
        for name, (low, high) in (("x", self.x), ("y", self.y)):
            if not (np.isfinite([low, high]).all() and low < high):
                raise InvalidInput(f"{name} is ({low}, {high}), it must be (low, high) with low below high")
        if not (np.isfinite(self.undulation) and 0 <= self.undulation <= 0.1):
            raise InvalidInput(f"undulation is {self.undulation}, it must be 0 ... 0.1 m")
        material_index(self.material)
        for feature in self.features:
            self.check_inside(feature)
        object.__setattr__(self, "features", tuple(self.features))
        object.__setattr__(self, "_waves", _waves(self.seed))
        for i, feature in enumerate(self.features):
            x, y = np.array([feature.x]), np.array([0.0 if isinstance(feature, Step) else feature.y])
            base = float(self._evaluate(x, y, self.features[:i])[0][0])
            object.__setattr__(self, "_bases", (*self._bases, base))

    def check_inside(self, feature: AnyFeature) -> None:
        """Refuse a feature that leaves the area.

        Raises:
            InvalidInput: saying where it is and where it may be.
        """
        x0, x1, y0, y1 = feature.bounds
        if x0 < self.x[0] or x1 > self.x[1] or y0 < self.y[0] or y1 > self.y[1]:
            raise InvalidInput(
                f"{type(feature).__name__.lower()} covers x {x0:.3f} ... {x1:.3f}, y {y0:.3f} ... {y1:.3f}: outside "
                f"the world, x {self.x[0]} ... {self.x[1]}, y {self.y[0]} ... {self.y[1]}"
            )

    def height(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Float:
        """Exact height of the top surface at points of any (broadcast) shape [m]."""
        px, py = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        return self._evaluate(px, py, self.features)[0]

    def material_at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Codes:
        """Index into MATERIALS of the top surface at points."""
        px, py = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        return self._evaluate(px, py, self.features)[1]

    def raster(self, x: tuple[float, float], y: tuple[float, float], cell: float) -> tuple[Float, Codes]:
        """Heights and materials at the centres of a fine grid a[iy, ix] over an area; quick for many features."""
        cx = np.arange(x[0] + cell / 2, x[1], cell)
        cy = np.arange(y[0] + cell / 2, y[1], cell)
        heights = self._undulated(cx, cy)
        materials = np.full(heights.shape, material_index(self.material), dtype=np.uint8)
        for feature, base in zip(self.features, self._bases, strict=True):
            x0, x1, y0, y1 = feature.bounds
            if isinstance(feature, Step):
                x1, y0, y1 = np.inf, -np.inf, np.inf
            columns, rows = slice(*np.searchsorted(cx, (x0, x1))), slice(*np.searchsorted(cy, (y0, y1)))
            part = heights[rows, columns]
            if not part.size:
                continue
            near_x, near_y = np.meshgrid(cx[columns], cy[rows])
            top, mask = feature.shape(near_x, near_y, part, base)
            heights[rows, columns] = top
            materials[rows, columns][mask] = material_index(feature.material)
        return heights, materials

    def sole_height(self, x: float, y: float, length: float, width: float, yaw: float = 0.0) -> float:
        """Height at which a level, stiff sole of length x width centred at a point comes to rest [m]."""
        u, v = np.meshgrid(np.linspace(-0.5, 0.5, 17) * length, np.linspace(-0.5, 0.5, 13) * width)
        c, s = np.cos(yaw), np.sin(yaw)
        return float(self.height(x + c * u - s * v, y + s * u + c * v).max())

    def _undulated(self, cx: Float, cy: Float) -> Float:
        """Heights (ny, nx) of the bare ground; by the sine of a sum, thousands of sines instead of millions."""
        if self.undulation <= 0:
            return np.zeros((cy.size, cx.size))
        cx, cy = np.clip(cx, *self.x), np.clip(cy, *self.y)
        kx, ky, phase = self._waves.T
        row, column = cx[:, None] * kx + phase, cy[:, None] * ky
        waves = np.cos(column) @ np.sin(row).T + np.sin(column) @ np.cos(row).T
        return np.asarray(waves * self._amplitude(cx))

    def _amplitude(self, x: Float) -> Float:
        """What each wave is multiplied by: nothing where the ground is flat."""
        rise = np.clip((x - self.flat_until) / 0.2, 0, 1)
        return np.asarray(self.undulation * np.sqrt(2 / len(self._waves)) * rise**2 * (3 - 2 * rise))

    def _evaluate(self, x: Float, y: Float, features: tuple[AnyFeature, ...]) -> tuple[Float, Codes]:
        x, y = np.clip(x, *self.x), np.clip(y, *self.y)
        heights = np.zeros(x.shape)
        if self.undulation > 0:
            for kx, ky, phase in self._waves:
                heights += np.sin(kx * x + ky * y + phase)
            heights *= self._amplitude(x)
        materials = np.full(x.shape, material_index(self.material), dtype=np.uint8)
        for feature, base in zip(features, self._bases, strict=False):
            heights, mask = feature.shape(x, y, heights, base)
            materials[mask] = material_index(feature.material)
        return heights, materials


def _waves(seed: int) -> Float:
    """Wave numbers and phases (n, 3) of the undulation."""
    rng = np.random.default_rng(seed)
    lengths = np.exp(rng.uniform(np.log(SHORTEST_WAVE_M), np.log(LONGEST_WAVE_M), UNDULATION_WAVES))
    angles, phases = rng.uniform(0, 2 * np.pi, (2, UNDULATION_WAVES))
    return np.column_stack((2 * np.pi / lengths * np.cos(angles), 2 * np.pi / lengths * np.sin(angles), phases))
