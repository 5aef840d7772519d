"""`TerrainGrid`: one immutable grid of all layers, and the questions planners ask it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import numpy.typing as npt

from guara_perception.exceptions import InvalidInput
from guara_perception.readonly import readonly
from guara_perception.terrain.geometry import GridGeometry
from guara_perception.terrain.hazard import Hazard
from guara_perception.terrain.invariant import check_invariant, occupancy_values
from guara_perception.terrain.layers import LAYER_NAMES, LAYERS

if TYPE_CHECKING:
    from guara_perception.terrain.best_foothold import Foothold
    from guara_perception.terrain.foothold import FootholdVerdict, FootholdVerdicts
    from guara_perception.terrain.obstacles import Obstacle
    from guara_perception.terrain.path import PathVerdict
    from kinematics import RobotModel

EXTENTS = ("footprint", "map")


@dataclass(frozen=True, slots=True, eq=False)
class TerrainGrid:
    """Terrain under and before the robot at one stance pause (contract, section 2).

    Made only from layers that satisfy the safety invariant. All arrays are (ny, nx), a[iy, ix], read-only.

    Attributes:
        layers: every layer of `LAYERS` by name.
        geometry: origin, resolution and shape.
        frame: "base_footprint".
        stamp: time of the scan [ns since the epoch].
        step: number of the stance pause.
        extent: "footprint" (this scan alone) or "map" (fused).
        metadata: mode, method, calibration hash, stance, transforms, coverage, health ... ; plain JSON values.
        pictures: range images by name, (512, 640) float32 [mm], where the scan was processed with them.
    """

    layers: Mapping[str, npt.NDArray[Any]]
    geometry: GridGeometry
    frame: str = "base_footprint"
    stamp: int = 0
    step: int = 0
    extent: str = "footprint"
    metadata: Mapping[str, Any] = field(default_factory=dict)
    pictures: Mapping[str, npt.NDArray[np.float32]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the invariant and freeze."""
        check_invariant(self.layers)
        shape = self.layers["elevation"].shape
        if shape != self.geometry.shape:
            raise InvalidInput(f"layers have shape {shape}, the geometry says {self.geometry.shape}")
        if self.extent not in EXTENTS:
            raise InvalidInput(f"extent is {self.extent!r}, allowed: {', '.join(EXTENTS)}")
        frozen = {name: readonly(self.layers[name]) for name in LAYER_NAMES}
        pictures = {name: readonly(picture) for name, picture in self.pictures.items()}
        object.__setattr__(self, "layers", MappingProxyType(frozen))
        object.__setattr__(self, "pictures", MappingProxyType(pictures))
        object.__setattr__(self, "metadata", MappingProxyType(dict(self.metadata)))

    def __getattr__(self, name: str) -> npt.NDArray[Any]:
        """Layers as attributes: `terrain.elevation`, `terrain.hazard` ..."""
        if name in LAYER_NAMES:
            return self.layers[name]
        raise AttributeError(f"TerrainGrid has no attribute {name!r}; layers: {', '.join(LAYER_NAMES)}")

    def __getstate__(self) -> dict[str, Any]:
        """Plain containers, for pickling and copying."""
        state = {name: getattr(self, name) for name in self.__slots__}
        for name in ("layers", "metadata", "pictures"):
            state[name] = dict(state[name])
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore and freeze again."""
        for name, value in state.items():
            object.__setattr__(self, name, value)
        self.__post_init__()

    @property
    def resolution(self) -> float:
        """Edge of a cell [m]."""
        return self.geometry.resolution

    @property
    def origin(self) -> tuple[float, float]:
        """Corner of cell (0, 0) [m]."""
        return self.geometry.origin

    @property
    def shape(self) -> tuple[int, int]:
        """(ny, nx)."""
        return self.geometry.shape

    def layer(self, name: str) -> npt.NDArray[Any]:
        """A layer by name.

        Raises:
            InvalidInput: no such layer.
        """
        if name not in LAYER_NAMES:
            raise InvalidInput(f"layer is {name!r}, allowed: {', '.join(LAYER_NAMES)}")
        return self.layers[name]

    def height_at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Any:
        """Elevation of the cell under each point [m]; NaN where unknown or outside. Scalars give a float."""
        return self._look_up("elevation", x, y, np.float32(np.nan), float)

    def hazard_at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Any:
        """Hazard flags of the cell under each point; UNSCANNED outside. Scalars give a Hazard, arrays uint16."""
        return self._look_up("hazard", x, y, np.uint16(Hazard.UNSCANNED), lambda flags: Hazard(int(flags)))

    def is_traversable(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Any:
        """Whether a sole may be centred on the cell under each point. Scalars give a bool; False outside."""
        score = self._look_up("traversability", x, y, np.float32(0), float)
        return score > 0

    def normal_at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Unit normals (..., 3) of the plane fitted around the cell under each point; NaN where no slope is known."""
        from guara_perception.terrain.normal import normals_at

        px, py = self._points(x, y)
        return normals_at(self, px.ravel(), py.ravel()).reshape(*px.shape, 3)

    @overload
    def check_foothold(
        self, x: float, y: float, leg: str | None = None, robot: RobotModel | None = None
    ) -> FootholdVerdict: ...

    @overload
    def check_foothold(
        self, x: npt.ArrayLike, y: npt.ArrayLike, leg: str | None = None, robot: RobotModel | None = None
    ) -> FootholdVerdicts: ...

    def check_foothold(
        self, x: npt.ArrayLike, y: npt.ArrayLike, leg: str | None = None, robot: RobotModel | None = None
    ) -> FootholdVerdict | FootholdVerdicts:
        """Whether a sole, aligned with x, may be set down centred on each point, and if not, why.

        Args:
            x, y: places in base_footprint [m].
            leg: also ask whether this leg reaches the place with the body where it stood at the scan.
            robot: model for `leg`; None = the one of the grid's robot name.

        Returns:
            For numbers a FootholdVerdict; for arrays FootholdVerdicts with `ok` and `score` as arrays and each
            place's verdict by index.

        Raises:
            InvalidInput: x and y do not fit together, or the grid's metadata lacks limits, or stance where a leg is
                given.
            kinematics.KinematicsError: no such leg or robot.
        """
        from guara_perception.terrain.foothold import check_foothold

        return check_foothold(self, x, y, leg, robot)

    def best_foothold(
        self,
        x: float,
        y: float,
        radius: float,
        leg: str | None = None,
        previous: Foothold | tuple[float, float] | None = None,
        robot: RobotModel | None = None,
    ) -> Foothold | None:
        """The best place for a sole near a wish; None where there is none.

        Every candidate passes `check_foothold`. The value is score times nearness to the wish times clearance; ties go
        to the nearer place, then the smaller x, then the smaller y.

        Args:
            x, y: the wish in base_footprint [m].
            radius: of the search [m].
            leg, robot: as in `check_foothold`.
            previous: the last choice, in base_footprint of this grid: kept while it is allowed, within the radius,
                and no other place is worth a third more.

        Raises:
            InvalidInput: a value that is not finite, a radius above 1 m; as `check_foothold`.
        """
        from guara_perception.terrain.best_foothold import best_foothold

        return best_foothold(self, x, y, radius, leg, previous, robot)

    def check_path(self, points: npt.ArrayLike, clearance: float) -> PathVerdict:
        """Whether a foot may swing, or a part of the body pass, along a path over this terrain.

        Every cell within `clearance` of the path, seen from above, must be known, and its height to be relied on (not
        CONFLICT, not STALE). Points with z: the path must stay `clearance` away from the ground (highest samples plus
        confidence), but for its ends: within `clearance` of its first and last point it may touch the ground. Points
        without z: a track on the ground, where no cell may be hazardous.

        Args:
            points: (n, 3) or (n, 2) corners of the path in base_footprint [m].
            clearance: [m].

        Raises:
            InvalidInput: points that are none, or reach further than 20 m; a clearance outside 0 ... 1 m.
        """
        from guara_perception.terrain.path import check_path

        return check_path(self, points, clearance)

    def check_polygon(self, corners: npt.ArrayLike) -> PathVerdict:
        """Whether every cell that a polygon (n, 2) [m] touches is known and free of hazards (EDGE does not count).

        Raises:
            InvalidInput: fewer than three corners, values that are not finite, or an area beyond 20 m.
        """
        from guara_perception.terrain.path import check_polygon

        return check_polygon(self, corners)

    def explain(self, x: float, y: float) -> str:
        """What is known of a place and why a foot may or may not go there, in one sentence."""
        from guara_perception.terrain.explain import explain

        return explain(self, x, y)

    def coarser(self, factor: int) -> TerrainGrid:
        """The same terrain in cells `factor` times as long, the worst of the fine cells counting.

        One unknown fine cell makes a coarse one unknown; flags are joined, slope, step, roughness, variance and age
        are the largest, score, clearance and looks the smallest.

        Raises:
            InvalidInput: a factor that does not divide the grid; the message lists those that do.
        """
        from guara_perception.terrain.coarser import coarser

        return coarser(self, factor)

    def obstacles(self) -> list[Obstacle]:
        """Each connected thing that stands 6 mm or more above the floor, or lies as far below, sorted by x, then y.

        The floor is the plane that most of the known heights agree with; what is unknown is no obstacle, but is never
        traversable either.
        """
        from guara_perception.terrain.obstacles import obstacles

        return obstacles(self)

    def to_occupancy(self, unknown: int = 100) -> npt.NDArray[np.int8]:
        """Occupancy (ny, nx) int8 as nav_msgs/OccupancyGrid counts it; its data are `.ravel()` of this.

        Args:
            unknown: value of cells that were not seen, 100 (as a hazard) or -1.

        Raises:
            InvalidInput: any other value for `unknown`.
        """
        if unknown not in (100, -1):
            raise InvalidInput(f"unknown is {unknown!r}, allowed: 100 (unknown is a hazard), -1 (unknown is marked)")
        return occupancy_values(self.layers["traversability"], self.layers["hazard"], unknown)

    def save(self, path: str | Path) -> None:
        """Write the grid to an .npz file; `load_terrain` reads it back.

        Raises:
            MissingFile: the folder does not exist.
        """
        from guara_perception.terrain.file import save_terrain

        save_terrain(self, path)

    def _points(self, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        try:
            px, py = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        except (ValueError, TypeError):
            raise InvalidInput("x and y must be numbers or arrays of one shape [m]") from None
        return px, py

    def _look_up(self, layer: str, x: npt.ArrayLike, y: npt.ArrayLike, outside: Any, scalar: Any) -> Any:
        px, py = self._points(x, y)
        iy, ix = self.geometry.indices(px, py)
        inside = self.geometry.contains(iy, ix)
        values = np.full(px.shape, outside)
        values[inside] = self.layers[layer][iy[inside], ix[inside]]
        return scalar(values[()]) if values.ndim == 0 else values


def layer_types() -> dict[str, np.dtype[Any]]:
    """Type of each layer by name."""
    return {layer.name: np.dtype(layer.dtype) for layer in LAYERS}
