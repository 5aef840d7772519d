"""Textured triangle mesh between the cell centres of a terrain grid, and intersection of rays with the cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float, Float32, Image
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.drawing.style import (
    HEIGHT_COLOURS,
    TRAVERSABILITY_COLOURS,
    UNKNOWN_COLOUR,
    hazard_picture,
    rgb,
)
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard

COLOURINGS = ("hazard", "elevation", "traversability")
# Sampling step of a ray relative to a cell, and largest length of a ray [m].
SHARE_OF_CELL = 0.5
FAR_M = 20.0
# Margin above the highest and below the lowest cell within which a ray is sampled [m].
MARGIN_M = 0.005


@dataclass(frozen=True, slots=True)
class Scale:
    """Colour scale of a layer from `low` to `high`, with the texts at its ends."""

    name: str
    low: float
    high: float
    colours: str
    low_text: str
    high_text: str


# Step to which the ends of the range of height colours are rounded outwards, and minimum size of this range.
ROUNDED_TO_M, LEAST_HEIGHT_RANGE_M = 0.01, 0.06

# Fraction of the known cells that may be beyond either end of the range.
BEYOND = 0.005

# Largest height difference of neighbours that are joined, so that walls that were not measured are not drawn.
JOIN_HEIGHT_M = 0.030

TRAVERSABILITY = Scale("traversability", 0.0, 1.0, TRAVERSABILITY_COLOURS, "0 not traversable", "1 best")


@dataclass(frozen=True, slots=True, eq=False)
class TerrainMesh:
    """Triangle mesh of a grid.

    Attributes:
        vertices: (n, 3) float32 in base_footprint [m].
        faces: (m, 3) uint32, facing up.
        picture: (ny, nx, 3) uint8, red, green, blue of each cell.
        texture_positions: (n, 2) float32, position of each vertex in `picture`, 0 ... 1 to the right and upwards; the
            first row of `picture` is at the top.
        legend: (name, colour) of free cells and of the flags shown; empty unless the colouring is "hazard".
        scale: colour scale of the other colourings, None for "hazard".
    """

    vertices: Float32
    faces: npt.NDArray[np.uint32]
    picture: Image
    texture_positions: Float32
    legend: tuple[tuple[str, str], ...] = ()
    scale: Scale | None = None


def terrain_mesh(terrain: TerrainGrid, colouring: str = "hazard") -> TerrainMesh:
    """Make a mesh over all cells except those whose only unknown flag is UNSCANNED.

    Unknown cells are drawn at the height of the nearest known cell: in the colour of their cause if the colouring is
    "hazard", otherwise in grey.

    Raises:
        InvalidInput: no such colouring.
    """
    if colouring not in COLOURINGS:
        raise InvalidInput(f"colouring is {colouring!r}, allowed: {', '.join(COLOURINGS)}")
    known = np.isfinite(terrain.elevation)
    drawn = known | ((terrain.hazard & (UNKNOWN_MASK & ~np.uint16(Hazard.UNSCANNED))) != 0)
    legend: tuple[tuple[str, str], ...] = ()
    scale = None
    if colouring == "hazard":
        picture, shown = hazard_picture(terrain.hazard)
        legend = tuple(item for item in shown if item[0] != "unscanned")
    else:
        scale = _height_scale(terrain.elevation) if colouring == "elevation" else TRAVERSABILITY
        values = terrain.layers[colouring]
        picture = _coloured(np.nan_to_num((values - scale.low) / (scale.high - scale.low)), scale.colours)
        picture[~known] = rgb(UNKNOWN_COLOUR)
    heights = drawn_heights(terrain)
    x, y = terrain.geometry.centres()
    ny, nx = terrain.shape
    iy, ix = np.nonzero(drawn)
    vertices = np.column_stack((x[ix], y[iy], heights[drawn])).astype(np.float32)
    texture_positions = np.column_stack(((ix + 0.5) / nx, 1 - (iy + 0.5) / ny)).astype(np.float32)
    number = np.full(terrain.shape, -1, dtype=np.int64)
    number[drawn] = np.arange(len(ix))
    corners = np.stack((number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]), axis=-1).reshape(-1, 4)
    corners = corners[(corners >= 0).all(axis=1)]
    corners = corners[np.ptp(vertices[corners, 2], axis=1) < JOIN_HEIGHT_M]
    faces = np.vstack((corners[:, [0, 1, 2]], corners[:, [0, 2, 3]])).astype(np.uint32)
    return TerrainMesh(vertices, faces, np.round(picture * 255).astype(np.uint8), texture_positions, legend, scale)


def _coloured(values: npt.NDArray[np.floating], name: str) -> Float32:
    """Colours (..., 3) 0 ... 1 of values 0 ... 1."""
    import matplotlib

    return np.asarray(matplotlib.colormaps[name](np.clip(values, 0, 1))[..., :3], dtype=np.float32)


def _height_scale(elevation: Float32) -> Scale:
    known = elevation[np.isfinite(elevation)]
    low, high = np.quantile(known, (BEYOND, 1 - BEYOND)) if len(known) else (0.0, 0.0)
    low, high = ROUNDED_TO_M * np.floor(low / ROUNDED_TO_M), ROUNDED_TO_M * np.ceil(high / ROUNDED_TO_M)
    high = max(high, low + LEAST_HEIGHT_RANGE_M)
    texts = (f"{1e3 * low:+.0f} mm", f"{1e3 * high:+.0f} mm")
    return Scale("height", float(low), float(high), HEIGHT_COLOURS, *texts)


def drawn_heights(terrain: TerrainGrid) -> Float32:
    """Heights (ny, nx) of all cells [m]; unknown cells, drawn or not, are as high as the nearest known cell, or 0."""
    from scipy.ndimage import distance_transform_edt

    elevation = terrain.elevation
    known = np.isfinite(elevation)
    if not known.any():
        return np.zeros_like(elevation)
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(elevation[tuple(nearest)])


def met_by_ray(terrain: TerrainGrid, origin: npt.ArrayLike, direction: npt.ArrayLike) -> Float | None:
    """First sampled position (3,) on a ray that is at or below the height of its cell, None if there is none.

    Args:
        terrain: grid; cells have the heights of `drawn_heights`, even if they are not drawn.
        origin, direction: (3,) in the frame of the grid [m]; the direction may have any length.
    """
    start, along = np.asarray(origin, dtype=np.float64), np.asarray(direction, dtype=np.float64)
    along = along / np.linalg.norm(along)
    heights = drawn_heights(terrain)
    near, far = 0.0, FAR_M
    if along[2] != 0.0:
        # The ray is sampled only between the heights of the highest and the lowest cell, with a margin.
        limits = np.array([heights.max() + MARGIN_M, heights.min() - MARGIN_M])
        one, other = np.sort((limits - start[2]) / along[2])
        near, far = max(near, float(one)), min(far, float(other))
    if far <= near:
        return None
    lengths = np.arange(near, far, SHARE_OF_CELL * terrain.resolution)[:, None]
    points = start + lengths * along
    iy, ix = terrain.geometry.indices(points[:, 0], points[:, 1])
    inside = terrain.geometry.contains(iy, ix)
    met = np.flatnonzero(inside)[points[inside, 2] <= heights[iy[inside], ix[inside]] + 1e-9]
    return points[met[0]] if len(met) else None
