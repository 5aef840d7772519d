"""Why a cell is unknown: not looked at, hidden, out of range, doubtful, or simply no return."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.terrain.geometry import GridGeometry
from guara_perception.terrain.hazard import Hazard

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
    ground = np.column_stack(
        (np.tile(x, len(y)), np.repeat(y, len(x)), np.zeros(geometry.size), np.ones(geometry.size))
    )
    side = ground @ planes_in_footprint.T > 0
    changes = side[:, 1:] != side[:, :-1]
    pair = np.where(changes.any(axis=1), changes.argmax(axis=1), -1)
    with np.errstate(invalid="ignore"):
        in_view = (pixels >= 0).all(axis=1) & (pixels[:, 0] <= size[0] - 1) & (pixels[:, 1] <= size[1] - 1)
    return LookPlan(pair.reshape(geometry.shape), in_view.reshape(geometry.shape))


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
    open_cells = unknown & (flags == 0)
    if in_own_shadow is not None and open_cells.any():
        iy, ix = np.nonzero(open_cells)
        x, y = geometry.centres()
        own = in_own_shadow(np.column_stack((x[ix], y[iy], _ground_height(elevation)[iy, ix])))
        flags[iy[own], ix[own]] = np.uint16(Hazard.SELF)
        open_cells = unknown & (flags == 0)
    hidden = np.zeros_like(open_cells)
    for eye in eyes:
        hidden |= is_hidden(elevation, open_cells, eye, geometry)
    flags[open_cells] = np.where(hidden[open_cells], np.uint16(Hazard.OCCLUDED), np.uint16(Hazard.DROPOUT))
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
    iy, ix = np.nonzero(cells)
    if not iy.size:
        return result
    ground = _ground_height(elevation)
    x, y = geometry.centres()
    target = np.column_stack((x[ix], y[iy], ground[iy, ix]))
    top = float(np.nanmax(elevation)) if np.isfinite(elevation).any() else 0.0
    # Above the highest surface nothing can hide: only the last stretch of each line needs a look.
    climb = np.maximum(eye[2] - target[:, 2], 1e-6)
    start = np.clip(1 - (top - target[:, 2]) / climb, 0.0, 1.0)
    length = np.linalg.norm(eye[:2] - target[:, :2], axis=1) * (1 - start)
    steps = int(np.clip(np.ceil(2 * length.max() / geometry.resolution), 1, 400))
    share = start + (1 - start) * ((np.arange(steps) + 0.5) / steps)[:, None]
    # One array per coordinate: an array of points would be walked through with gaps.
    line_x, line_y, line_z = (eye[i] + share * (target[:, i] - eye[i]) for i in range(3))
    jy, jx = geometry.indices(line_x, line_y)
    inside = geometry.contains(jy, jx)
    surface = np.where(inside, elevation[np.where(inside, jy, 0), np.where(inside, jx, 0)], np.nan)
    with np.errstate(invalid="ignore"):
        result[iy, ix] = (surface > line_z + HIDING_MARGIN_M).any(axis=0)
    return result


def _ground_height(elevation: Float) -> Float:
    """Lowest measured height in a neighbourhood of 0.1 m on a 5 mm grid, 0 where nothing is known nearby."""
    far = 1e3
    lowest = cv2.erode(np.where(np.isnan(elevation), far, elevation), np.ones((21, 21), np.uint8))
    return np.where(lowest > far / 2, 0.0, lowest)
