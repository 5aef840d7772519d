"""`check_foothold`: whether a sole may be set here, and the reasons against it; `explain` says it in a sentence."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, overload

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Array, Flags, Float, Index, Mask
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.assessment.disc import disc_kernel, widest_window
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import ALL_BUT_EDGE, MEANING, UNKNOWN_MASK, Hazard, Reason, names
from guara_perception.terrain.layers.layered_grid import LayeredGrid, asked, coordinates, look_up
from guara_perception.terrain.questions.leg_reach import beyond_reach_of_ground
from kinematics.arrays import FrozenArrays

if TYPE_CHECKING:
    from guara_perception.settings import RobotLike

# Positions that are computed together: keeps the memory small for whole grids of positions.
CHUNK = 4096
# A sole that only shares an edge with a cell does not cover it.
TOLERANCE_CELLS = 1e-6


@dataclass(frozen=True, slots=True)
class FootholdVerdict:
    """The answer for one place.

    Attributes:
        ok: whether a sole may be set there.
        score: traversability of the place, 0 where not ok.
        reasons: each failed test with value and limit; empty where ok.
    """

    ok: bool
    score: float
    reasons: tuple[Reason, ...]

    def __bool__(self) -> bool:
        return self.ok

    def __repr__(self) -> str:
        """The same text as `str` with the name of the class."""
        return f"FootholdVerdict({self})"

    def __str__(self) -> str:
        """Text for people, in millimetres and degrees."""
        return f"ok, score {self.score:.2f}" if self.ok else f"refused: {'; '.join(map(str, self.reasons))}"


@dataclass(frozen=True, slots=True, eq=False)
class FootholdVerdicts(FrozenArrays):
    """The answers for several places; `verdicts[i]` is the FootholdVerdict of place i, with its reasons.

    Attributes:
        terrain: grid that gave the answers.
        x, y: (n,) places in base_footprint [m].
        ok: (n,) bool.
        score: (n,) float64, 0 where not ok.
        leg: leg that was asked for, or None.
        beyond: (n,) how far its joints would go beyond their limits [rad], NaN out of reach; zeros without a leg.
    """

    terrain: LayeredGrid
    x: Float
    y: Float
    ok: Mask
    score: Float
    leg: str | None
    beyond: Float

    def __repr__(self) -> str:
        """How many places are safe."""
        return f"FootholdVerdicts({int(self.ok.sum())} of {len(self)} places ok, leg={self.leg!r})"

    def __len__(self) -> int:
        return int(self.x.size)

    def __getitem__(self, i: int) -> FootholdVerdict:
        """The verdict of place i, counted in the flattened arrays."""
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
    """Whether a sole, aligned with x, may be set down centred on each point, and if not, why.

    Args:
        x, y: positions in base_footprint [m].
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
    shape = px.shape
    verdicts = FootholdVerdicts(
        terrain,
        px,
        py,
        ok.reshape(shape),
        np.where(ok, score, 0.0).reshape(shape),
        leg,
        beyond.reshape(shape),
    )
    return verdicts[0] if px.ndim == 0 else verdicts


def _reasons(terrain: LayeredGrid, x: float, y: float, leg: str | None, beyond: float) -> Iterator[Reason]:
    """Every failed test of one place."""
    if not (np.isfinite(x) and np.isfinite(y)):
        yield Reason("unknown", 1.0, 0.0, "share", "the place is not finite")
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
    # Age is limited in pauses and in seconds; the layer holds pauses only.
    seconds = record.validity_seconds
    too_old = "" if seconds is None else f"or last seen more than {seconds:g} s ago"
    sigma = f"plus {limits.confidence:g} sigma"
    tests: tuple[tuple[Hazard, str, str, float, str, str], ...] = (
        (Hazard.STEEP, "slope", "slope", limits.slope, "rad", sigma),
        (Hazard.STEP, "step", "step_height", limits.step, "m", sigma),
        (Hazard.DROP, "drop", "step_height", limits.drop, "m", sigma),
        (Hazard.ROUGH, "roughness", "roughness", limits.roughness, "m", sigma),
        (Hazard.UNCERTAIN, "sigma", "variance", limits.sigma, "m", "of the height"),
        (Hazard.STALE, "age", "age", validity, "pauses", too_old),
    )
    for flag, test, layer, limit, unit, detail in tests:
        where = (hazard & np.uint16(flag)) != 0
        if where.any():
            value = float(np.nanmax(_values(terrain, layer, rows, columns)[where]))
            yield Reason(test, value, limit, unit, detail)
    for name, (flag, limit) in terrain.record.other_limits().items():
        cells = int(((hazard & np.uint16(flag)) != 0).sum())
        if cells:
            detail = f"of the sole flagged {flag.name}, to which a limit of a newer version adds: {name} {limit:g}"
            yield Reason(name, cells, 0.0, "cells", detail)
    disputed = int(((hazard & np.uint16(Hazard.CONFLICT)) != 0).sum())
    if disputed:
        yield Reason("conflict", disputed, 0.0, "cells", "looks disagree")
    here = terrain.hazard_at(x, y)
    if here & Hazard.EDGE and not count:
        yield Reason("edge", _clearance_at(terrain, x, y), enough_clearance(terrain, limits), "m", _EDGE)
    if leg is not None and beyond != 0:
        yield Reason("reach", beyond, 0.0, "rad", f"of {leg} beyond its joints' limits")


_EDGE = "too near to something unknown, hazardous or off the grid; this much clearance is always enough"


def _values(terrain: LayeredGrid, layer: str, rows: slice, columns: slice) -> Array:
    values = terrain.layers[layer][rows, columns].astype(np.float64)
    return np.sqrt(values) if layer == "variance" else values


def _clearance_at(terrain: LayeredGrid, x: float, y: float) -> float:
    return float(look_up(terrain, "clearance", x, y, np.float32(np.nan))[()])


def enough_clearance(terrain: LayeredGrid, limits: TraversabilityLimits) -> float:
    """Clearance from which on a cell is never EDGE [m]: distance of the farthest corner that its tests read."""
    kernel = disc_kernel(limits.disc_radius / terrain.resolution)
    return widest_window(kernel, terrain.resolution, limits, is_map=terrain.extent == "map")


def sole_flags(hazard: Flags, geometry: GridGeometry, x: Float, y: Float, limits: TraversabilityLimits) -> Flags:
    """Union of the flags of all cells that the sole rectangle, aligned with x, covers wholly or partly.

    Args:
        hazard: (ny, nx).
        geometry: geometry of the grid.
        x, y: (n,) sole centres, finite.
        limits: limits of the robot, with the sole's size.

    Returns:
        (n,) uint16; a sole that reaches off the grid has UNSCANNED among its flags.
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
    """Rows and columns of the cells on the grid that one sole covers, how many it covers, and how many are off it."""
    columns = np.unique(_covered(np.array([x]), geometry.origin[0], limits.sole_length, geometry.resolution))
    rows = np.unique(_covered(np.array([y]), geometry.origin[1], limits.sole_width, geometry.resolution))
    ny, nx = geometry.shape
    on_x, on_y = columns[(columns >= 0) & (columns < nx)], rows[(rows >= 0) & (rows < ny)]
    total, on = columns.size * rows.size, on_x.size * on_y.size
    if not on:
        return slice(0, 0), slice(0, 0), total, total
    return slice(int(on_y[0]), int(on_y[-1]) + 1), slice(int(on_x[0]), int(on_x[-1]) + 1), total, total - on


def _covered(centre: Float, origin: float, length: float, resolution: float) -> Index:
    """Cell indices (n, w) along one axis; where a sole covers fewer than w the last one is repeated."""
    at = (centre - origin) / resolution
    half = length / 2 / resolution
    # Far off the grid is off the grid: no overflow for absurd positions.
    first = np.clip(np.floor(at - half + TOLERANCE_CELLS), -(2**31), 2**31).astype(np.int64)
    last = np.clip(np.ceil(at + half - TOLERANCE_CELLS) - 1, -(2**31), 2**31).astype(np.int64)
    last = np.maximum(last, first)
    width = int((last - first).max()) + 1 if first.size else 1
    return np.minimum(first[:, None] + np.arange(width), last[:, None])


def explain(terrain: LayeredGrid, x: float, y: float, *, allow_stale: bool = False) -> str:
    """One sentence: what is known about the ground at a point, and why a foot may or may not go there."""
    terrain = asked(terrain, allow_stale)
    flags = terrain.hazard_at(float(x), float(y))
    point = f"x={float(x):.3f} y={float(y):.3f}"
    iy, ix = terrain.geometry.indices(float(x), float(y))
    if not terrain.geometry.contains(iy, ix):
        (x0, y0), (ny, nx) = terrain.origin, terrain.shape
        end_x, end_y = x0 + nx * terrain.resolution, y0 + ny * terrain.resolution
        return f"{point} is off the grid (x {x0:.3f} ... {end_x:.3f}, y {y0:.3f} ... {end_y:.3f} m): not traversable"
    causes = "; ".join(MEANING[flag] for flag in Hazard if flag and flag in flags)
    if int(flags) & int(UNKNOWN_MASK):
        return f"{point} is unknown: {causes}; not traversable"
    layer = {name: float(values[iy, ix]) for name, values in terrain.layers.items()}
    phrases = [
        f"{point} is {layer['elevation'] * 1e3:.1f} mm high (sigma {np.sqrt(layer['variance']) * 1e3:.1f} mm)",
        _slope_words(layer["slope"], layer["roughness"]),
        f"step {layer['step_height'] * 1e3:.1f} mm",
        f"clearance {layer['clearance'] * 1e3:.0f} mm",
        _seen_words(int(layer["looks"]), int(layer["age"])),
    ]
    text = ", ".join(phrases)
    if flags == Hazard.NONE:
        return f"{text}: traversable, score {layer['traversability']:.2f}"
    verdict = check_foothold(terrain, x, y)
    assert isinstance(verdict, FootholdVerdict)
    tests = "; ".join(str(reason) for reason in verdict.reasons)
    return f"{text}: not traversable: {causes}" + (f" [{tests}]" if tests else "")


def _slope_words(slope: float, roughness: float) -> str:
    if not np.isfinite(slope):
        return "slope not known (too little around it)"
    return f"slope {np.degrees(slope):.1f} deg, roughness {roughness * 1e3:.1f} mm"


def _seen_words(looks: int, age: int) -> str:
    source = "felt by a foot or declared by the gait" if looks == 0 else f"seen by {looks} scan" + "s" * (looks > 1)
    return source + (f", last {age} pause{'s' * (age > 1)} ago" if age else ", now")
