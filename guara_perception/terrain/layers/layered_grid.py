"""Immutable layers of a terrain (`LayeredGrid`), and look-up of cells by position (`Gridded`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast, overload

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Array, Codes, Flags, Float, Float32, Mask
from guara_perception.exceptions import InvalidInput, refuse_stale
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import Hazard, check_invariant, occupancy_values
from guara_perception.terrain.layers.layers import LAYER_NAMES
from guara_perception.terrain.layers.record import RECORDS, MapRecord, ScanRecord
from kinematics.arrays import read_only

A = TypeVar("A")
G = TypeVar("G", bound="LayeredGrid")
EXTENTS = tuple(RECORDS)


class Gridded:
    """Base class of grids with at least the layers `elevation`, `hazard` and `traversability`.

    Queries of a stale grid raise `transport.StaleTerrain` unless `allow_stale` is set.
    """

    __slots__ = ()

    if TYPE_CHECKING:

        @property
        def geometry(self) -> GridGeometry:
            """Origin, resolution and shape."""

        @property
        def stale_because(self) -> tuple[str, ...]:
            """Reasons why a client returns the grid only with `allow_stale`; empty otherwise."""

    @property
    def resolution(self) -> float:
        """Edge of a cell [m]."""
        return self.geometry.resolution

    @property
    def origin(self) -> tuple[float, float]:
        """Position (x, y) of the corner of cell (0, 0) [m]."""
        return self.geometry.origin

    @property
    def shape(self) -> tuple[int, int]:
        """Number of cells (ny, nx) along y and x."""
        return self.geometry.shape

    @overload
    def height_at(self, x: float, y: float, *, allow_stale: bool = False) -> float: ...

    @overload
    def height_at(self, x: npt.ArrayLike, y: npt.ArrayLike, *, allow_stale: bool = False) -> Float32: ...

    def height_at(self, x: npt.ArrayLike, y: npt.ArrayLike, *, allow_stale: bool = False) -> Any:
        """Elevation of the cell under each point [m]; NaN where unknown or outside. Scalars give a float."""
        refuse_stale(self.stale_because, allow_stale)
        height = look_up(self, "elevation", x, y, np.float32(np.nan))
        return height if height.ndim else float(height[()])

    @overload
    def hazard_at(self, x: float, y: float, *, allow_stale: bool = False) -> Hazard: ...

    @overload
    def hazard_at(self, x: npt.ArrayLike, y: npt.ArrayLike, *, allow_stale: bool = False) -> Flags: ...

    def hazard_at(self, x: npt.ArrayLike, y: npt.ArrayLike, *, allow_stale: bool = False) -> Any:
        """Hazard flags of the cell under each point; UNSCANNED outside. Scalars give a Hazard, arrays uint16."""
        refuse_stale(self.stale_because, allow_stale)
        flags = look_up(self, "hazard", x, y, np.uint16(Hazard.UNSCANNED))
        return flags if flags.ndim else Hazard(int(flags[()]))

    @overload
    def is_traversable(self, x: float, y: float, *, allow_stale: bool = False) -> bool: ...

    @overload
    def is_traversable(self, x: npt.ArrayLike, y: npt.ArrayLike, *, allow_stale: bool = False) -> Mask: ...

    def is_traversable(self, x: npt.ArrayLike, y: npt.ArrayLike, *, allow_stale: bool = False) -> Any:
        """Test whether a sole may be centred on the cell under each point. Scalars give a bool; False outside."""
        refuse_stale(self.stale_because, allow_stale)
        score = look_up(self, "traversability", x, y, np.float32(0))
        return score > 0 if score.ndim else bool(score > 0)


class LayerAttribute(Generic[A]):
    """Layer of a grid as a read-only attribute."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, grid: LayeredGrid, owner: type) -> A:
        return cast(A, self if grid is None else grid.layers[self._name])


@dataclass(frozen=True, slots=True, eq=False)
class LayeredGrid(Gridded):
    """Immutable layers of a terrain, from which all queries are answered.

    The layers satisfy the safety invariant. They are read-only arrays (ny, nx), a[iy, ix]; each is also an attribute.

    Attributes:
        layers: every layer of `LAYERS` by name.
        geometry: origin, resolution and shape.
        record: record of the scan or the map; a record of the other kind is converted.
        frame: frame of positions and heights, "base_footprint".
        stamp: end of the scan, or of the newest scan of a map [ns since the Unix epoch].
        step: number of the stance pause.
        extent: "footprint" (one scan alone) or "map" (fused scans).
        pictures: range images (512, 640) float32 by name [mm], if the scan was processed with them.
        stale_because: reasons why a client returns the grid only with `allow_stale`; empty otherwise.
    """

    layers: Mapping[str, Array]
    geometry: GridGeometry
    record: ScanRecord | MapRecord = field(default_factory=ScanRecord)
    frame: str = "base_footprint"
    stamp: int = 0
    step: int = 0
    extent: str = "footprint"
    pictures: Mapping[str, Float32] = field(default_factory=dict)
    stale_because: tuple[str, ...] = ()

    elevation = LayerAttribute[Float32]()
    variance = LayerAttribute[Float32]()
    variance_local = LayerAttribute[Float32]()
    elevation_min = LayerAttribute[Float32]()
    elevation_max = LayerAttribute[Float32]()
    slope = LayerAttribute[Float32]()
    step_height = LayerAttribute[Float32]()
    roughness = LayerAttribute[Float32]()
    clearance = LayerAttribute[Float32]()
    traversability = LayerAttribute[Float32]()
    hazard = LayerAttribute[Flags]()
    age = LayerAttribute[Codes]()
    looks = LayerAttribute[Codes]()
    ceiling = LayerAttribute[Float32]()

    def __post_init__(self) -> None:
        check_invariant(self.layers)
        shape = self.layers["elevation"].shape
        if shape != self.geometry.shape:
            raise InvalidInput(f"layers have shape {shape}, but the geometry has {self.geometry.shape}")
        if self.extent not in EXTENTS:
            raise InvalidInput(f"extent is {self.extent!r}, allowed: {', '.join(EXTENTS)}")
        frozen = {name: read_only(self.layers[name]) for name in LAYER_NAMES}
        pictures = {name: read_only(picture) for name, picture in self.pictures.items()}
        object.__setattr__(self, "layers", MappingProxyType(frozen))
        object.__setattr__(self, "pictures", MappingProxyType(pictures))
        if not isinstance(self.record, kind := RECORDS[self.extent]):
            object.__setattr__(self, "record", kind.from_json(self.record.to_json()))

    if not TYPE_CHECKING:
        # Hidden from type checkers, which would accept any attribute name.
        def __getattr__(self, name: str) -> Array:
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}; layers: {', '.join(LAYER_NAMES)}")

    # __reduce__ instead of __getstate__, which dataclasses with slots overwrite before Python 3.11.4.
    def __reduce__(self) -> tuple[object, ...]:
        """Support pickling and copying, with dicts instead of mapping proxies, which cannot be pickled."""
        state = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        for name in ("layers", "pictures"):
            state[name] = dict(state[name])
        return partial(type(self), **state), ()

    @property
    def metadata(self) -> Mapping[str, Any]:
        """Record as plain JSON values, read-only."""
        return self.record.to_json()

    @property
    def scan_record(self) -> ScanRecord:
        """Record of a scan.

        Raises:
            InvalidInput: the grid is a map.
        """
        if isinstance(self.record, ScanRecord):
            return self.record
        raise InvalidInput(f"extent of the grid is {self.extent!r}; allowed: 'footprint' (a scan)")

    @property
    def is_provisional(self) -> bool:
        """True until the pause confirms that the robot stood still; until then, the grid may be withdrawn."""
        return bool(self.record.provisional)

    def restated(self: G, **changes: Any) -> G:
        """Copy of the grid with some fields of its record replaced."""
        return replace(self, record=replace(self.record, **changes))

    def layer(self, name: str) -> Array:
        """Return a layer by name.

        Raises:
            InvalidInput: there is no such layer.
        """
        if name not in LAYER_NAMES:
            raise InvalidInput(f"layer is {name!r}, allowed: {', '.join(LAYER_NAMES)}")
        return self.layers[name]

    def to_occupancy(self, unknown: int = 100, *, allow_stale: bool = False) -> npt.NDArray[np.int8]:
        """Occupancy (ny, nx) int8 as in nav_msgs/OccupancyGrid; `.ravel()` gives the `data` of that message.

        Args:
            unknown: value of unknown cells, 100 (as a hazard) or -1.
            allow_stale: also answer from a stale grid.

        Raises:
            InvalidInput: any other value for `unknown`.
            transport.StaleTerrain: the grid is stale and `allow_stale` is not set.
        """
        refuse_stale(self.stale_because, allow_stale)
        if unknown not in (100, -1):
            raise InvalidInput(f"unknown is {unknown!r}, allowed: 100 (unknown is a hazard), -1 (unknown is marked)")
        return occupancy_values(self.layers["traversability"], self.layers["hazard"], unknown)


def asked(terrain: G, allow_stale: bool) -> G:
    """Return the grid for a query, with `stale_because` cleared if `allow_stale` is set.

    Raises:
        transport.StaleTerrain: the grid is stale and `allow_stale` is not set.
    """
    if not terrain.stale_because:
        return terrain
    refuse_stale(terrain.stale_because, allow_stale)
    return replace(terrain, stale_because=())


def coordinates(x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[Float, Float]:
    """Convert coordinates to arrays broadcast to one shape [m].

    Raises:
        InvalidInput: x and y are not numbers, or their shapes cannot be broadcast together.
    """
    try:
        px, py = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    except (ValueError, TypeError):
        raise InvalidInput("x and y must be numbers or arrays that broadcast to one shape [m]") from None
    return px, py


def look_up(grid: Gridded, layer: str, x: npt.ArrayLike, y: npt.ArrayLike, outside: np.generic) -> Array:
    """Values of a layer in the cells under points, in the shape of the points.

    Args:
        grid: grid with the layer.
        layer: name of the layer.
        x, y: points in base_footprint [m].
        outside: value for points off the grid, of the layer's type.

    Raises:
        InvalidInput: see `coordinates`.
    """
    px, py = coordinates(x, y)
    iy, ix = grid.geometry.indices(px, py)
    inside = grid.geometry.contains(iy, ix)
    values = np.full(px.shape, outside)
    values[inside] = getattr(grid, layer)[iy[inside], ix[inside]]
    return values


def numbers(values: npt.ArrayLike, name: str) -> Float:
    """Copy an argument to an array of float64; masked elements become NaN.

    Raises:
        InvalidInput: the argument is not an array of real numbers.
    """
    try:
        if np.iscomplexobj(values):
            raise TypeError
        copy = np.array(values, dtype=np.float64)
        if isinstance(values, np.ma.MaskedArray):
            copy[np.ma.getmaskarray(values)] = np.nan
        return copy
    except (ValueError, TypeError):
        raise InvalidInput(f"{name}: an array of numbers is needed") from None
