"""Why a cell is unknown: not looked at, hidden, out of range, doubtful, or simply no return."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.terrain.geometry import GridGeometry
from guara_perception.terrain.hazard import Hazard
from guara_perception.terrain.raster import ROUNDING

Float = npt.NDArray[np.float64]
Flags = npt.NDArray[np.uint16]

# A surface must rise this far above a line of sight to count as hiding what lies beyond.
HIDING_MARGIN_M = 0.001


@dataclass(frozen=True, slots=True)
class LookPlan:
    """Which pair of neighbouring stripes should pass over each cell, on flat ground.

    Attributes:
        pair: (ny, nx) int64, place of the first stripe of the pair in the pattern, -1 where no pair passes.
        in_view: (ny, nx) bool, whether the camera sees the cell's centre.
    """

    pair: npt.NDArray[np.int64]
    in_view: npt.NDArray[np.bool_]


def plan_looks(geometry: GridGeometry, planes_in_footprint: Float, pixels: Float, size: tuple[int, int]) -> LookPlan:
    """Predict the looks of a scan.

    Args:
        geometry: the grid.
        planes_in_footprint: (s, 4) sheets in the order of the pattern.
        pixels: (ny * nx, 2) picture positions of the cell centres at z = 0, NaN where behind the camera.
        size: picture width and height [px].
    """
    x, y = geometry.centres()
    sides = (np.add.outer(b * y + d, a * x) > 0 for a, b, _, d in planes_in_footprint)
    # The first pair whose sheets have a cell on different sides passes over it: sheets are counted up to there.
    first_side = next(sides)
    still = np.ones(geometry.shape, dtype=np.bool_)
    before = np.zeros(geometry.shape, dtype=np.int64)
    for side in sides:
        still &= side == first_side
        before += still
    pair = np.where(still, -1, before)
    with np.errstate(invalid="ignore"):
        in_view = (pixels >= 0).all(axis=1) & (pixels[:, 0] <= size[0] - 1) & (pixels[:, 1] <= size[1] - 1)
    return LookPlan(pair, in_view.reshape(geometry.shape))


def unknown_causes(
    elevation: Float,
    plan: LookPlan,
    pair_usable: npt.NDArray[np.bool_],
    marks: Flags,
    eyes: tuple[Float, ...],
    geometry: GridGeometry,
    in_own_shadow: Callable[[Float], npt.NDArray[np.bool_]] | None = None,
) -> Flags:
    """Give every unknown cell its cause.

    Args:
        elevation: (ny, nx) heights [m], NaN where unknown.
        plan: predicted looks.
        pair_usable: (s - 1,) whether both stripes of a pair were fired with good frames and are neighbours.
        marks: (ny, nx) flags of returns that were seen here and may not be used.
        eyes: positions (3,) of camera and laser in base_footprint.
        geometry: the grid.
        in_own_shadow: tells which points (n, 3) the robot hides from its own camera or laser; None = none.

    Returns:
        (ny, nx) uint16, one or more unknown flags where the elevation is NaN, 0 elsewhere.
    """
    unknown = np.isnan(elevation)
    flags = np.where(unknown, marks, 0).astype(np.uint16)
    looked_at = np.append(pair_usable, False)[plan.pair] & (plan.pair >= 0) & plan.in_view
    flags[unknown & ~looked_at & (flags == 0)] = np.uint16(Hazard.UNSCANNED)
    cells = np.flatnonzero(unknown & (flags == 0))
    if not cells.size:
        return flags
    targets = _lowest_ground(elevation, cells, geometry)
    cause = np.full(cells.size, Hazard.DROPOUT, dtype=np.uint16)
    for eye in eyes:
        cause[_behind_surface(elevation, targets, eye, geometry)] = Hazard.OCCLUDED
    if in_own_shadow is not None:
        cause[in_own_shadow(targets)] = Hazard.SELF
    flags.ravel()[cells] = cause
    return flags


def is_hidden(
    elevation: Float, cells: npt.NDArray[np.bool_], eye: Float, geometry: GridGeometry
) -> npt.NDArray[np.bool_]:
    """Whether a measured surface stands between an eye and each of `cells`, taken at the lowest height around it.

    Args:
        elevation: (ny, nx) measured heights [m], NaN where unknown (an unknown cell hides nothing).
        cells: (ny, nx) the cells asked about.
        eye: (3,) camera or laser in base_footprint.
        geometry: the grid.
    """
    result = np.zeros(geometry.shape, dtype=bool)
    asked = np.flatnonzero(cells)
    if asked.size:
        result.ravel()[asked] = _behind_surface(elevation, _lowest_ground(elevation, asked, geometry), eye, geometry)
    return result


def _behind_surface(elevation: Float, targets: Float, eye: Float, geometry: GridGeometry) -> npt.NDArray[np.bool_]:
    """Whether a measured surface stands between an eye and each of the targets (n, 3)."""
    top = float(np.fmax.reduce(elevation, axis=None))
    x, y, z = targets.T
    if np.isnan(top):
        return np.zeros(len(targets), dtype=bool)
    # Above the highest surface nothing can hide: only the last stretch of each line needs a look.
    climb = np.maximum(eye[2] - z, 1e-6)
    start = np.clip(1 - (top - z) / climb, 0.0, 1.0)
    length = np.hypot(eye[0] - x, eye[1] - y) * (1 - start)
    steps = int(np.clip(np.ceil(2 * length.max() / geometry.resolution), 1, 400))
    share = start + (1 - start) * ((np.arange(steps) + 0.5) / steps)[:, None]
    # Cells counted with a border of one, where nothing is known: what lies beyond the grid is cut to it.
    around = np.pad(elevation, 1, constant_values=np.nan)
    row, column = (
        ((end + share * (place - end) - origin) * (1 / geometry.resolution) + (1 + ROUNDING))
        .clip(0, count + 1)
        .astype(np.intp)
        for place, end, origin, count in (
            (y, eye[1], geometry.origin[1], geometry.shape[0]),
            (x, eye[0], geometry.origin[0], geometry.shape[1]),
        )
    )
    row *= around.shape[1]
    row += column
    with np.errstate(invalid="ignore"):
        return np.asarray((around.ravel().take(row) > eye[2] + share * (z - eye[2]) + HIDING_MARGIN_M).any(axis=0))


def _lowest_ground(elevation: Float, cells: npt.NDArray[np.intp], geometry: GridGeometry) -> Float:
    """Centres (n, 3) of flat cells at the lowest height measured around them, at 0 where nothing is known nearby."""
    x, y = geometry.centres()
    iy, ix = np.divmod(cells, x.size)
    return np.stack((x[ix], y[iy], _ground_height(elevation).ravel()[cells])).T


def _ground_height(elevation: Float) -> Float:
    """Lowest measured height in a neighbourhood of 0.1 m on a 5 mm grid, 0 where nothing is known nearby."""
    far = 1e3
    lowest = cv2.erode(np.where(np.isnan(elevation), far, elevation), np.ones((21, 21), np.uint8))
    return np.where(lowest > far / 2, 0.0, lowest)
