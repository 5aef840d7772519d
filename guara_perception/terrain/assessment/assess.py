"""Assessment of heights: slope, step, roughness, clearance, traversability and hazards of every cell."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Array, Flags, Float, Float32, Index, Mask
from guara_perception.settings import TraversabilityLimits
from guara_perception.stripes.kernel.library import address, addresses, kernel
from guara_perception.terrain.assessment.disc import clearance, edge_cells
from guara_perception.terrain.assessment.raster import Raster
from guara_perception.terrain.layers.geometry import KNOWN_SHARE, disc_kernel, half_cells
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard

# Layers taken from the raster, in its order, and layers computed by the kernel.
FROM_RASTER = "elevation", "variance_local", "elevation_min", "elevation_max"
JUDGED = "slope", "step_height", "roughness", "traversability"
# Limits in the order in which the kernel takes them.
TESTED = "slope", "step", "drop", "roughness", "sigma", "confidence"


def assess_layers(
    raster: Raster,
    hazard: Flags,
    resolution: float,
    limits: TraversabilityLimits,
    drift: Index | None = None,
    *,
    shared: Float | float = 0.0,
    slope_sigma: Float | float = 0.0,
    beyond: int = 0,
    discs: DiscTests | None = None,
) -> dict[str, Array]:
    """Compute all layers of a grid from its heights.

    Every test reads a fixed window. A cell gets EDGE if a sole centred on it would cover a hazard, or if the window of
    any cell under this sole contains an unknown cell or extends off the grid. The loss of an observation therefore
    never makes another cell safe.

    Args:
        raster: heights, local variances (the part that neighbouring cells do not share), lowest and highest samples.
        hazard: (ny, nx) uint16 initial flags: causes of unknown cells, and flags such as SOFT, CONFLICT and STALE.
        resolution: cell edge [m].
        limits: traversability limits.
        drift: (ny, nx, 2) possible drift of each cell of the fused map along y and x [cells]; None for a single scan.
        shared: (ny, nx) variance shared by neighbouring cells [m^2]. It is added to the layer `variance`; no test uses
            it.
        slope_sigma: standard deviation of slopes due to errors that the cells of a disc share, such as the frame's tilt
            relative to gravity: one value, or (ny, nx) [rad].
        beyond: width of a margin on each side that the tests read but the returned layers do not contain [cells].
        discs: cache of the disc tests, updated by this call; only columns that changes since the last call can
            affect are computed again. Valid only while `resolution`, `limits` and `slope_sigma` stay the same. None =
            no cache.

    Returns:
        All layers by name, read-only, in the types of `LAYERS`, with age and looks of a single scan.

    Raises:
        InvalidInput: the radius of the disc is too large for these cells, see `disc_kernel`.
    """
    known = np.isfinite(raster.elevation)
    # Known cells have no cause, and unknown cells without a cause get UNSCANNED.
    unknown = ~known
    flags = np.where(known, hazard & ~UNKNOWN_MASK, hazard).astype(np.uint16, copy=False)
    flags[unknown & ((flags & UNKNOWN_MASK) == 0)] |= np.uint16(Hazard.UNSCANNED)
    discs = DiscTests() if discs is None else discs
    judged, flags = discs.of(raster, flags, resolution, limits, slope_sigma)
    # Cells outside the range of known cells are unknown, which is equivalent to being off the grid.
    window = _extent(known, axis=0), _extent(known, axis=1)
    disc, drift = disc_kernel(limits.disc_radius / resolution), None if drift is None else drift[window]
    edge = np.zeros(known.shape, dtype=bool)
    edge[window] = edge_cells(flags[window], disc, resolution, limits, drift)
    edge &= known
    # The arrays in the cache are not modified.
    layers: dict[str, Array] = dict(zip(JUDGED, judged, strict=True))
    layers["hazard"] = flags = np.where(edge, flags | np.uint16(Hazard.EDGE), flags)
    layers["traversability"] = np.where(edge, np.float32(0), layers["traversability"])
    for name, layer in zip(FROM_RASTER, raster.layers, strict=True):
        layers[name] = values = layer.astype(np.float32, order="C")
        np.putmask(values, unknown, np.nan)
    layers["variance"] = (layers["variance_local"] + shared).astype(np.float32)
    if beyond:
        inner = np.s_[beyond:-beyond, beyond:-beyond]
        layers = {name: np.ascontiguousarray(layer[inner]) for name, layer in layers.items()}
        flags = layers["hazard"]
        off_grid = _sole_off_grid(flags.shape, resolution, limits) & ((flags & UNKNOWN_MASK) == 0)
        flags[off_grid] |= np.uint16(Hazard.EDGE)
        layers["traversability"][off_grid] = 0.0
    known = np.isfinite(layers["elevation"])
    layers |= {
        "clearance": clearance(layers["hazard"], resolution),
        "age": np.where(known, np.uint8(0), np.uint8(255)),
        "looks": known.astype(np.uint8),
        "ceiling": np.full(known.shape, np.nan, np.float32),
    }
    for layer in layers.values():
        # A grid does not copy read-only layers.
        layer.setflags(write=False)
    return layers


class DiscTests:
    """Tests of the disc around each cell; the result of a cell depends only on its disc, to the last bit.

    Slope and roughness are those of a plane through the known cells of the disc. They are defined as in the filters of
    grid_map, but with least squares instead of principal components; on planes, both give the same result. They are NaN
    if too little of the disc, or nothing on one side of its centre, is known. The step height is the largest rise or
    fall to any known cell of the disc, from lowest and highest samples, so that a step within one cell counts.
    """

    def __init__(self) -> None:
        """Start without results."""
        self._before: tuple[Raster, Flags, Float32, Flags] | None = None

    def of(
        self,
        raster: Raster,
        flags: Flags,
        resolution: float,
        limits: TraversabilityLimits,
        slope_sigma: Float | float,
    ) -> tuple[Float32, Flags]:
        """Layers JUDGED, in this order, and flags without EDGE; only columns that a change can affect are computed.

        Args:
            raster, resolution, limits, slope_sigma: as in `assess_layers`.
            flags: (ny, nx) initial flags, with a cause in exactly the unknown cells.
        """
        ny, nx = flags.shape
        disc = disc_kernel(limits.disc_radius / resolution)
        side = disc.shape[0]
        raster = Raster(*(np.ascontiguousarray(layer, np.float64) for layer in raster.layers))
        first, end = 0, nx
        if self._before is None:
            judged, hazard = np.empty((4, ny, nx), np.float32), flags.copy()
        else:
            changed = np.flatnonzero(_differ(raster, flags, *self._before[:2]))
            first = max(int(changed[0]) - side // 2, 0) if changed.size else nx
            end = min(int(changed[-1]) + 1 + side // 2, nx) if changed.size else nx
            judged, hazard = self._before[2].copy(), self._before[3].copy()
            hazard[:, first:end] = flags[:, first:end]
        tilts = np.ascontiguousarray(np.broadcast_to(np.asarray(slope_sigma, np.float64), flags.shape))
        limit, where, work = (
            np.array([getattr(limits, name) for name in TESTED], np.float64),
            np.array(addresses(*raster.layers, tilts)),
            np.empty((side, 5, nx + side)),
        )
        given = address(where), ny, nx, first, end, address(disc), side, resolution, KNOWN_SHARE * float(disc.sum())
        kernel().test_discs(*given, *addresses(limit, work, judged, hazard))
        for result in (judged, hazard):
            result.setflags(write=False)
        self._before = raster, flags, judged, hazard
        return judged, hazard


def _differ(raster: Raster, flags: Flags, other: Raster, other_flags: Flags) -> Mask:
    """Mask (nx,) of the columns in which two rasters or their flags differ."""
    differ = flags != other_flags
    for one, two in zip(raster.layers, other.layers, strict=True):
        # Compared bit by bit, so that NaN is equal to NaN.
        differ |= one.view(np.int64) != two.view(np.int64)
    return np.asarray(differ.any(axis=0))


def _sole_off_grid(shape: tuple[int, ...], resolution: float, limits: TraversabilityLimits) -> Mask:
    """Mask of the cells on which a sole would extend beyond the border."""
    y, x = (half_cells(length, resolution) for length in (limits.sole_width, limits.sole_length))
    result = np.ones(shape, dtype=bool)
    result[y : max(shape[0] - y, 0), x : max(shape[1] - x, 0)] = False
    return result


def _extent(known: Mask, axis: int) -> slice:
    """Range of the rows (axis 0) or columns (axis 1) with known cells; the first row or column if there are none."""
    occupied = np.flatnonzero(known.any(axis=1 - axis))
    return slice(int(occupied[0]), int(occupied[-1]) + 1) if occupied.size else slice(0, 1)
