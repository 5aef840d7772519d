"""Foothold check: is a position safe for a sole, and which tests fail otherwise."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import overload

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Flags, Float, Index, Mask
from guara_perception.settings import RobotLike, TraversabilityLimits
from guara_perception.terrain.layers.geometry import GridGeometry, disc_kernel, widest_window
from guara_perception.terrain.layers.hazard import ALL_BUT_EDGE, MEANING, UNKNOWN_MASK, Hazard, names
from guara_perception.terrain.layers.layered_grid import LayeredGrid, asked, coordinates, look_up
from guara_perception.terrain.questions.leg_reach import beyond_reach_of_ground
from guara_perception.terrain.questions.reason import Reason, Verdict
from kinematics.arrays import FrozenArrays

# Number of positions per block, which bounds the memory for whole grids of positions.
CHUNK = 4096
# Overlap up to which a sole does not cover a cell [cells]: rounding may let a sole overlap a cell that it only touches.
TOLERANCE_CELLS = 1e-6


@dataclass(frozen=True, slots=True, repr=False)
class FootholdVerdict(Verdict):
    """Result of a foothold check.

    Attributes:
        ok: True if a sole may be placed at the position.
        score: traversability of the position, 0 if not ok.
        reasons: each failed test with value and limit; empty if ok.
    """

    ok: bool
    score: float
    reasons: tuple[Reason, ...]

    def _ok_text(self) -> str:
        return f"ok, score {self.score:.2f}"


@dataclass(frozen=True, slots=True, eq=False)
class FootholdVerdicts(FrozenArrays):
    """Results for several positions; `verdicts[i]` is the FootholdVerdict of position i, with its reasons.

    Attributes:
        terrain: grid that was queried.
        x, y: (...) positions in base_footprint [m].
        ok: (...) mask of the positions where a sole may be placed.
        score: (...) float64 traversability, 0 where not ok.
        leg: leg of the query, or None.
        beyond: (...) excess of the leg's joints over their limits [rad], NaN if no joint positions reach or the height
            is unknown; zeros without a leg.
    """

    terrain: LayeredGrid
    x: Float
    y: Float
    ok: Mask
    score: Float
    leg: str | None
    beyond: Float

    def __repr__(self) -> str:
        return f"FootholdVerdicts({int(self.ok.sum())} of {len(self)} positions ok, leg={self.leg!r})"

    def __len__(self) -> int:
        return int(self.x.size)

    def __getitem__(self, i: int) -> FootholdVerdict:
        """Verdict of position i of the flattened arrays."""
        ok = bool(self.ok.ravel()[i])
        if ok:
            return FootholdVerdict(True, float(self.score.ravel()[i]), ())
        x, y, beyond = (float(values.ravel()[i]) for values in (self.x, self.y, self.beyond))
        return FootholdVerdict(False, 0.0, tuple(_reasons(self.terrain, x, y, self.leg, beyond)))

    def __iter__(self) -> Iterator[FootholdVerdict]:
        return (self[i] for i in range(len(self)))


@overload
def check_foothold(
    terrain: LayeredGrid,
    x: float,
    y: float,
    leg: str | None = None,
    robot: RobotLike | None = None,
    *,
    allow_stale: bool = False,
) -> FootholdVerdict: ...


@overload
def check_foothold(
    terrain: LayeredGrid,
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    leg: str | None = None,
    robot: RobotLike | None = None,
    *,
    allow_stale: bool = False,
) -> FootholdVerdicts: ...


def check_foothold(
    terrain: LayeredGrid,
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    leg: str | None = None,
    robot: RobotLike | None = None,
    *,
    allow_stale: bool = False,
) -> FootholdVerdict | FootholdVerdicts:
    """Check if a sole aligned with the x axis may be placed at each position.

    Args:
        x, y: centres of the sole in base_footprint [m].
        leg: also require that this leg reaches the position, with the body at its pose in the scan.
        robot: model, name or folder, used with `leg`; None = the robot of the grid.

    Returns:
        A FootholdVerdict if x and y are numbers; FootholdVerdicts if they are arrays.

    Raises:
        InvalidInput: x and y are not numbers, their shapes cannot be broadcast together, or the metadata of the grid
            lacks limits. With a leg, also if robot, stance or pose is missing from the metadata or unreadable, or if
            `robot` is not the robot of the grid.
        kinematics.KinematicsError: no such leg, or the robot cannot be loaded or does not fit the stance.
    """
    terrain = asked(terrain, allow_stale)
    px, py = coordinates(x, y)
    limits = terrain.record.required_limits
    flat_x, flat_y = np.atleast_1d(px).ravel(), np.atleast_1d(py).ravel()
    finite = np.isfinite(flat_x) & np.isfinite(flat_y)
    score = np.asarray(look_up(terrain, "traversability", flat_x, flat_y, np.float32(0)), np.float64)
    flags = np.full(flat_x.size, np.uint16(Hazard.UNSCANNED))
    flags[finite] = sole_flags(terrain.hazard, terrain.geometry, flat_x[finite], flat_y[finite], limits)
    ok = (score > 0) & ((flags & ALL_BUT_EDGE) == 0)
    beyond = np.zeros(flat_x.size)
    if leg is not None:
        z = np.asarray(terrain.height_at(flat_x, flat_y), np.float64)
        beyond = beyond_reach_of_ground(terrain, leg, np.column_stack((flat_x, flat_y, z)), robot)
        ok &= beyond == 0
    score, shape = np.where(ok, score, 0.0), px.shape
    verdicts = FootholdVerdicts(terrain, px, py, ok.reshape(shape), score.reshape(shape), leg, beyond.reshape(shape))
    return verdicts[0] if px.ndim == 0 else verdicts


def _reasons(terrain: LayeredGrid, x: float, y: float, leg: str | None, beyond: float) -> Iterator[Reason]:
    """Yield the failed tests of one position."""
    if not (np.isfinite(x) and np.isfinite(y)):
        yield Reason("unknown", 1.0, 0.0, "share", "the position is not finite")
        return
    limits = terrain.record.required_limits
    rows, columns, total, off = sole_window(terrain.geometry, x, y, limits)
    hazard = terrain.hazard[rows, columns]
    unknown = (hazard & UNKNOWN_MASK) != 0
    count = int(unknown.sum()) + off
    if count:
        causes = names(int(np.bitwise_or.reduce(hazard[unknown] & UNKNOWN_MASK, axis=None)) if unknown.any() else 0)
        detail = ", ".join(causes + (["off the grid"] if off else []))
        yield Reason("unknown", count / total, 0.0, "share", f"of the sole: {detail}")
    record = terrain.record
    record.check("validity_pauses", "validity_seconds", "limit_flags")
    validity = 255.0 if record.validity_pauses is None else float(record.validity_pauses)
    # Age has limits in pauses and in seconds; the layer only contains pauses.
    seconds = record.validity_seconds
    too_old = "" if seconds is None else f"or last seen more than {seconds:g} s ago"
    sigma = f"plus {limits.confidence:g} sigma"
    tests: tuple[tuple[Hazard, str, str, float, str, str], ...] = (
        (Hazard.STEEP, "slope", "slope", limits.slope, "rad", sigma),
        (Hazard.STEP, "step", "step_height", limits.step, "m", sigma),
        (Hazard.DROP, "drop", "step_height", limits.drop, "m", sigma),
        (Hazard.ROUGH, "roughness", "roughness", limits.roughness, "m", sigma),
        (Hazard.UNCERTAIN, "sigma", "variance_local", limits.sigma, "m", "of the height"),
        (Hazard.STALE, "age", "age", validity, "pauses", too_old),
    )
    for flag, test, layer, limit, unit, detail in tests:
        where = (hazard & np.uint16(flag)) != 0
        if where.any():
            value = float(np.nanmax(terrain.layers[layer][rows, columns][where]))
            yield Reason(test, math.sqrt(value) if layer == "variance_local" else value, limit, unit, detail)
    counted: list[tuple[str, Hazard, str]] = []
    for name, (flag, most) in record.other_limits().items():
        detail = f"of the sole flagged {flag.name}, which a limit of a newer version also sets: {name} {most:g}"
        counted.append((name, flag, detail))
    counted += [(test, flag, MEANING[flag]) for test, flag in (("soft", Hazard.SOFT), ("conflict", Hazard.CONFLICT))]
    for test, flag, detail in counted:
        if cells := int(((hazard & np.uint16(flag)) != 0).sum()):
            yield Reason(test, cells, 0.0, "cells", detail)
    if terrain.hazard_at(x, y) & Hazard.EDGE and not count:
        clearance = float(look_up(terrain, "clearance", x, y, np.float32(np.nan))[()])
        detail = "too close to something unknown, hazardous or off the grid; a larger clearance always suffices"
        yield Reason("edge", clearance, enough_clearance(terrain, limits), "m", detail)
    if leg is not None and beyond != 0:
        yield Reason("reach", beyond, 0.0, "rad", f"joints of {leg} beyond their limits")


def enough_clearance(terrain: LayeredGrid, limits: TraversabilityLimits) -> float:
    """Clearance above which a cell cannot be EDGE [m]: the reach of the largest test window."""
    kernel = disc_kernel(limits.disc_radius / terrain.resolution)
    return widest_window(kernel, terrain.resolution, limits, is_map=terrain.extent == "map")


def sole_flags(hazard: Flags, geometry: GridGeometry, x: Float, y: Float, limits: TraversabilityLimits) -> Flags:
    """Union (n,) of the flags of all cells that each sole rectangle, aligned with x, covers at least in part.

    A sole that extends beyond the grid has UNSCANNED among its flags.

    Args:
        hazard: (ny, nx) flags.
        geometry: geometry of the grid.
        x, y: (n,) finite sole centres.
        limits: limits of the robot, including the size of its sole.
    """
    result = np.empty(x.size, dtype=np.uint16)
    for start in range(0, x.size, CHUNK):
        part = slice(start, start + CHUNK)
        columns = _covered(x[part], geometry.origin[0], limits.sole_length, geometry.resolution)
        rows = _covered(y[part], geometry.origin[1], limits.sole_width, geometry.resolution)
        ny, nx = geometry.shape
        outside = ((columns < 0) | (columns >= nx)).any(axis=1) | ((rows < 0) | (rows >= ny)).any(axis=1)
        columns, rows = np.clip(columns, 0, nx - 1), np.clip(rows, 0, ny - 1)
        cells = hazard.ravel()[(rows * nx)[:, :, None] + columns[:, None, :]]
        flags = np.bitwise_or.reduce(cells.reshape(len(cells), -1), axis=1)
        result[part] = flags | np.where(outside, np.uint16(Hazard.UNSCANNED), 0).astype(np.uint16)
    return result


def sole_window(
    geometry: GridGeometry, x: float, y: float, limits: TraversabilityLimits
) -> tuple[slice, slice, int, int]:
    """Rows and columns of the grid under a sole, number of cells under it, and how many of these are off the grid."""
    columns = np.unique(_covered(np.array([x]), geometry.origin[0], limits.sole_length, geometry.resolution))
    rows = np.unique(_covered(np.array([y]), geometry.origin[1], limits.sole_width, geometry.resolution))
    ny, nx = geometry.shape
    on_x, on_y = columns[(columns >= 0) & (columns < nx)], rows[(rows >= 0) & (rows < ny)]
    total, on = columns.size * rows.size, on_x.size * on_y.size
    if not on:
        return slice(0, 0), slice(0, 0), total, total
    return slice(int(on_y[0]), int(on_y[-1]) + 1), slice(int(on_x[0]), int(on_x[-1]) + 1), total, total - on


def _covered(centre: Float, origin: float, length: float, resolution: float) -> Index:
    """Indices (n, w) of the cells covered by each sole along one axis; shorter rows repeat their last index."""
    at = (centre - origin) / resolution
    half = length / 2 / resolution
    # Clipped to avoid overflow; such positions are off the grid anyway.
    ends = np.floor(at - half + TOLERANCE_CELLS), np.ceil(at + half - TOLERANCE_CELLS) - 1
    first, last = (np.clip(end, -(2**31), 2**31).astype(np.int64) for end in ends)
    last = np.maximum(last, first)
    width = int((last - first).max()) + 1 if first.size else 1
    return np.minimum(first[:, None] + np.arange(width), last[:, None])


def explain(terrain: LayeredGrid, x: float, y: float, *, allow_stale: bool = False) -> str:
    """Describe the ground at a point in one sentence, with the score of a foothold or the reasons against it."""
    terrain = asked(terrain, allow_stale)
    flags = terrain.hazard_at(float(x), float(y))
    point = f"x={float(x):.3f} y={float(y):.3f}"
    iy, ix = terrain.geometry.indices(float(x), float(y))
    if not terrain.geometry.contains(iy, ix):
        (x0, y0), (ny, nx) = terrain.origin, terrain.shape
        end_x, end_y = x0 + nx * terrain.resolution, y0 + ny * terrain.resolution
        return f"{point} is off the grid (x {x0:.3f} ... {end_x:.3f}, y {y0:.3f} ... {end_y:.3f} m): not traversable"
    causes = "; ".join(MEANING[flag] for flag in flags)
    if int(flags) & int(UNKNOWN_MASK):
        return f"{point} is unknown: {causes}; not traversable"
    layer = {name: float(values[iy, ix]) for name, values in terrain.layers.items()}
    slope = "slope unknown (too few known cells around it)"
    if np.isfinite(layer["slope"]):
        slope = f"slope {np.degrees(layer['slope']):.1f} deg, roughness {layer['roughness'] * 1e3:.1f} mm"
    looks, age = int(layer["looks"]), int(layer["age"])
    source = f"seen by {looks} scan" + "s" * (looks > 1) if looks else "known from a foot contact or the gait"
    text = (
        f"{point} is {layer['elevation'] * 1e3:.1f} mm high (sigma {np.sqrt(layer['variance']) * 1e3:.1f} mm), "
        f"{slope}, step {layer['step_height'] * 1e3:.1f} mm, clearance {layer['clearance'] * 1e3:.0f} mm, {source}, "
        + (f"last {age} pause{'s' * (age > 1)} ago" if age else "now")
    )
    if flags == Hazard.NONE:
        return f"{text}: traversable, score {layer['traversability']:.2f}"
    verdict = check_foothold(terrain, x, y)
    assert isinstance(verdict, FootholdVerdict)
    tests = "; ".join(str(reason) for reason in verdict.reasons)
    return f"{text}: not traversable: {causes}" + (f" [{tests}]" if tests else "")
