"""Fusion of a scan, and of ground that the gait declares, into the cells of the map, with the checks of both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.geometry import inside_polygon
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from guara_perception.terrain.map.fuse_heights import (
    LOOKED_AT,
    Heights,
    MapPause,
    forget_heights,
    fuse_heights,
    observe,
)
from guara_perception.terrain.map.odom_cells import SHRUNK_M, OdomCells
from kinematics import ArgumentError, OdometryPose, PoseInOdom
from kinematics.arrays import read_only
from kinematics.transforms import checked_covariance, checked_transform, inverse

# Without gravity a scan is levelled by its support plane, which tilts by 0.11 rad with two feet on a box of 40 mm.
LARGEST_TILT = 0.2
# Rounding of a vertical: a smaller tilt moves nothing by more than a nanometre and counts as zero.
LEAST_TURN = 1e-9

# Finding the cells inside an outline of 30,000 corners would delay a scan by a minute.
MOST_CORNERS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class KnownGround:
    """A level patch of ground that the gait declares safe, for instance under and before its first stance.

    Attributes:
        outline: (n, 2) corners in base_footprint of the pause at which it is declared [m], at least 3, not closed.
        height: height of the patch in the same frame [m].
        sigma: standard deviation of the height [m].

    Raises:
        InvalidInput: fewer than 3 or more than `MOST_CORNERS` corners, a value that is not finite, a negative sigma.
    """

    outline: Float
    height: float
    sigma: float

    def __post_init__(self) -> None:
        outline = np.array(self.outline, dtype=np.float64)
        if outline.ndim != 2 or outline.shape[1:] != (2,) or len(outline) < 3 or not np.isfinite(outline).all():
            raise InvalidInput(f"outline of known ground has shape {outline.shape}, it must be 3 or more finite (x, y)")
        if len(outline) > MOST_CORNERS:
            raise InvalidInput(f"outline of known ground has {len(outline)} corners; allowed: up to {MOST_CORNERS:,}")
        if not np.isfinite(self.height) or not np.isfinite(self.sigma) or self.sigma < 0:
            raise InvalidInput(
                f"known ground has height {self.height} and sigma {self.sigma}, both must be finite and sigma 0 or more"
            )
        object.__setattr__(self, "outline", read_only(outline))


def check_scan(terrain: TerrainGrid, resolution: float, last_step: int | None) -> None:
    """Refuse a grid that cannot be fused.

    Args:
        terrain: the grid.
        resolution: resolution of the map [m].
        last_step: step of the last scan fused, None before the first.

    Raises:
        InvalidInput: a grid of another extent or cell size, in the compact encoding, or of an earlier pause.
    """
    if terrain.extent != "footprint":
        raise InvalidInput(f"a grid of extent {terrain.extent!r} cannot be fused, it must be a scan's: 'footprint'")
    terrain.record.check("rounding")
    if terrain.record.rounding is not None:
        raise InvalidInput(
            "a grid in the compact encoding cannot be fused: the map would not say how its heights were rounded. "
            "Ask for it lossless, or for the node's map (extent 'map')"
        )
    if abs(terrain.resolution - resolution) > 1e-9:
        raise InvalidInput(f"the scan's cells are {terrain.resolution} m, the map's {resolution} m: they must be alike")
    if last_step is not None and terrain.step <= last_step:
        raise InvalidInput(
            f"step {terrain.step} comes after step {last_step}: scans must come in the order of their pauses; "
            "begin a new map for another walk"
        )


def fuse_scan(cells: OdomCells, terrain: TerrainGrid, now: MapPause) -> int:
    """Fuse a scan; return the number of heights that disagreed with the map."""
    found = observe(cells, terrain, now.transform_footprint_to_odom)
    accepted = fuse_heights(cells, found.heights, now)
    forget_heights(cells, found.empty, found.empty_cause)
    memory = cells.memory
    # A cause is more specific than "not observed", and an observation without return than no observation.
    is_free = np.isnan(memory["height"][found.unseen]) & ((memory["cause"][found.unseen] & LOOKED_AT) == 0)
    better = is_free & (found.unseen_cause != np.uint16(Hazard.UNSCANNED))
    memory["cause"][found.unseen[better]] = found.unseen_cause[better] & UNKNOWN_MASK
    return int((~accepted).sum())


def fuse_known_ground(cells: OdomCells, ground: KnownGround, now: MapPause, step: int) -> dict[str, Any]:
    """Fill unobserved cells wholly inside a declared patch; return its entry in the record of the map."""
    transform, half = now.transform_footprint_to_odom, cells.resolution / 2 - SHRUNK_M
    outline = ground.outline @ transform[:2, :2].T + transform[:2, 3]
    (x0, y0), (x1, y1) = outline.min(axis=0), outline.max(axis=0)
    cy, cx = cells.cells_between((x0, y0), (x1, y1))
    slot, memory = cells.slots(cy, cx), cells.memory
    # Cells that an earlier patch filled cost nothing.
    open_cells = (slot >= 0) & np.isnan(memory["height"][slot]) & ((memory["cause"][slot] & LOOKED_AT) == 0)
    slot = slot[open_cells]
    x, y = ((np.asarray(c, np.float64)[open_cells] + 0.5) * cells.resolution for c in (cx, cy))
    covered = inside_polygon(outline, x, y)
    for sx, sy in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        covered &= inside_polygon(outline, x + sx * half, y + sy * half)
    local = (np.column_stack((x, y))[covered] - transform[:2, 3]) @ transform[:2, :2]
    height = local @ transform[2, :2] + transform[2, 2] * ground.height + transform[2, 3]
    variance = np.full(len(local), ground.sigma**2)
    heights = Heights(slot[covered], height, variance, np.hypot(local[:, 0], local[:, 1]))
    fuse_heights(cells, heights, now, is_scan=False)
    patch = {"outline": ground.outline.tolist(), "height": ground.height, "sigma": ground.sigma}
    return {"step": step, **patch, "cells": len(local)}


@dataclass(frozen=True, slots=True)
class CheckedPose:
    """Checked copies of the arrays of a `PoseInOdom`; the transform is that of the scan's footprint."""

    transform: Float
    covariance: Float
    since_last: Float | None
    noise: Float


def checked_pose(terrain: TerrainGrid, pose: PoseInOdom) -> CheckedPose:
    """Check a pose and transform it to the footprint in which the scan was processed.

    Without gravity the scan's footprint is parallel to the support plane; that of leg odometry is horizontal by the
    gravity of earlier pauses.

    Raises:
        InvalidInput: a transform that is not rigid or tilts by more than 0.2 rad; an invalid covariance.
    """
    given, own = pose.transform_footprint_to_odom, pose.own_covariance
    since_last = pose.covariance_since_last
    terrain.record.check("transform_base_to_footprint")
    to_footprint = terrain.record.transform_base_to_footprint
    try:
        if isinstance(pose, OdometryPose) and to_footprint is not None:
            levelled = checked_transform(to_footprint, "transform_base_to_footprint")
            given = pose.transform_base_to_odom @ inverse(levelled)
        matrix = checked_transform(given, "transform_footprint_to_odom")
        checked = CheckedPose(
            matrix,
            checked_covariance(pose.covariance, "covariance"),
            None if since_last is None else checked_covariance(since_last, "covariance_since_last"),
            checked_covariance(np.zeros((6, 6)) if own is None else own, "own_covariance"),
        )
    except ArgumentError as error:
        raise InvalidInput(str(error)) from None
    rotation = matrix[:3, :3]
    if rotation[2, 2] < np.cos(LARGEST_TILT):
        raise InvalidInput(
            f"transform_footprint_to_odom tilts by more than {LARGEST_TILT} rad: both frames must be level"
        )
    rotation[np.abs(rotation) < LEAST_TURN] = 0.0
    return checked
