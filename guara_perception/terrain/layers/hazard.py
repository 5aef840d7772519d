"""Hazard flags of cells, and the safety invariant of terrain grids."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntFlag

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Array, Flags, Float32, Mask
from guara_perception.exceptions import UnsafeGrid
from guara_perception.terrain.layers.layers import LAYERS


class Hazard(IntFlag):
    """Flags of a cell: causes of unknown cells up to 32, hazards of known cells above (see docs/safety.md)."""

    NONE = 0
    DROPOUT = 1
    OCCLUDED = 2
    UNSCANNED = 4
    OUT_OF_RANGE = 8
    AMBIGUOUS = 16
    SELF = 32
    SOFT = 64
    STEEP = 256
    STEP = 512
    DROP = 1024
    ROUGH = 2048
    EDGE = 4096
    UNCERTAIN = 8192
    CONFLICT = 16384
    STALE = 32768

    def __str__(self) -> str:
        """Names of the flags, lowest first, as in "STEP|EDGE"."""
        return self.name or str(int(self))


FLAGS = {int(flag): str(flag.name) for flag in Hazard}

UNKNOWN_MASK = np.uint16(0x003F)

ALL_BUT_EDGE = np.uint16(0xFFFF & ~Hazard.EDGE)

MEANING = {
    Hazard.DROPOUT: "no return where one was expected: dark, absorbing or a hole",
    Hazard.OCCLUDED: "hidden from camera or laser by something nearer",
    Hazard.UNSCANNED: "not observed: out of view, stripe not fired or frame missing",
    Hazard.OUT_OF_RANGE: "below or above the heights that count as terrain",
    Hazard.AMBIGUOUS: "unreliable return: two stripes, saturation, or light from both sides of an edge",
    Hazard.SELF: "hidden by the robot's own leg or body",
    Hazard.SOFT: "a foot sank or slid on ground like this",
    Hazard.STEEP: "too steep",
    Hazard.STEP: "rises too much nearby",
    Hazard.DROP: "falls too much nearby",
    Hazard.ROUGH: "too rough",
    Hazard.EDGE: "a sole here would reach something unknown, hazardous or off the grid",
    Hazard.UNCERTAIN: "standard deviation of the height too large",
    Hazard.CONFLICT: "observations disagree",
    Hazard.STALE: "last seen too long ago, or drifted too far since",
}


def names(flags: int | Hazard) -> list[str]:
    """Names of the flags that are set, in ascending order."""
    return [str(flag.name) for flag in Hazard(int(flags))]


def cells_by_flag(hazard: Flags) -> dict[str, int]:
    """Number of cells of a grid with each flag, by name."""
    # Counted by combination of flags, because a grid contains few combinations.
    cells = np.bincount(hazard.ravel())
    combinations = np.flatnonzero(cells)
    counts = cells[combinations] @ ((combinations[:, None] & list(FLAGS)) != 0)
    return dict(zip(FLAGS.values(), counts.tolist(), strict=True))


def check_invariant(layers: Mapping[str, Array]) -> None:
    """Reject a grid that violates the safety invariant (docs/safety.md).

    Raises:
        UnsafeGrid: a layer is missing or has another shape or type, or cells violate a rule; the message then names the
            rule, the number of cells and the first of them.
    """
    shape = layers["elevation"].shape if "elevation" in layers else None
    for layer in LAYERS:
        array = layers.get(layer.name)
        if array is None or array.shape != shape or array.dtype != layer.dtype or array.ndim != 2:
            given = "missing" if array is None else f"{array.dtype} {array.shape}"
            wanted = shape if shape is not None and len(shape) == 2 else "(ny, nx)"
            raise UnsafeGrid(f"layer {layer.name} is {given}; it must be {np.dtype(layer.dtype)} {wanted}")
    check_safe(layers["elevation"], np.asarray(layers["hazard"], np.uint16), layers["traversability"])
    known = (layers["hazard"] & UNKNOWN_MASK) == 0
    for name in ("variance", "variance_local"):
        _reject(
            known & ~((layers[name] >= 0) & np.isfinite(layers[name])),
            f"{name} of a known cell is NaN, infinite or negative",
        )
    low, high = layers["elevation_min"], layers["elevation_max"]
    is_between = (low <= layers["elevation"]) & (layers["elevation"] <= high) & np.isfinite(low) & np.isfinite(high)
    _reject(
        known & ~is_between,
        "elevation_min, elevation and elevation_max of a known cell do not ascend, or are not finite",
    )
    ceiling = layers["ceiling"]
    _reject(np.isinf(ceiling) | (known & ~np.isnan(ceiling)), "ceiling is infinite, or set in a known cell")


def check_safe(elevation: Float32, hazard: Flags, traversability: Float32) -> None:
    """Check the rules of `check_invariant` for the three layers that decide where a foot may be set.

    Args:
        elevation: (ny, nx) [m], NaN where unknown.
        hazard: (ny, nx) flags.
        traversability: (ny, nx), 0 where no foot may be set, up to 1.

    Raises:
        UnsafeGrid: a rule is violated.
    """
    traversability = np.asarray(traversability, np.float32)
    unknown = (hazard & UNKNOWN_MASK) != 0
    _reject(np.isinf(elevation), "elevation is infinite")
    _reject(np.isnan(elevation) != unknown, "elevation is NaN without an unknown flag, or known with one")
    _reject(~((traversability >= 0) & (traversability <= 1)), "traversability is outside 0 ... 1")
    # Occupancy needs no rule: `occupancy_values` with `unknown` = 100 is less than 100 exactly where hazard is 0.
    mismatch = (hazard == 0) != (traversability > 0)
    _reject(mismatch, "a cell is traversable with a hazard, or not traversable without one")
    # All cells in the test windows of a safe cell must be known. The size of the windows is not known here, so only
    # the eight neighbours are checked.
    _reject((hazard == 0) & with_neighbours(unknown), "a cell beside an unknown one is traversable")


def with_neighbours(cells: Mask) -> Mask:
    """Mask (ny, nx) of some cells and their eight neighbours; without OpenCV, which guara-client lacks."""
    rows = cells.copy()
    rows[1:] |= cells[:-1]
    rows[:-1] |= cells[1:]
    result = rows.copy()
    result[:, 1:] |= rows[:, :-1]
    result[:, :-1] |= rows[:, 1:]
    return result


def occupancy_values(traversability: Float32, hazard: Flags, unknown: int = 100) -> npt.NDArray[np.int8]:
    """Occupancy as in nav_msgs/OccupancyGrid: 0 ... 99 free, 100 hazard, `unknown` in unknown cells."""
    free = np.rint(99 * (1 - traversability.astype(np.float64))).astype(np.int8)
    values = np.where(hazard == 0, free, np.int8(100))
    if unknown != 100:
        values[(hazard & UNKNOWN_MASK) != 0] = unknown
    return values


def _reject(broken: Mask, rule: str) -> None:
    if broken.any():
        iy, ix = (int(i[0]) for i in np.nonzero(broken))
        raise UnsafeGrid(f"{rule}: {int(broken.sum())} cells, the first at iy={iy}, ix={ix}; the grid is rejected")
