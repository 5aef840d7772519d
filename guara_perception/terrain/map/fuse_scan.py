"""Brings one scan, and ground that the gait declares, into the memory of the map."""

from __future__ import annotations

from typing import Any

import numpy as np

from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from guara_perception.terrain.map.fuse_heights import forget_heights, fuse_heights
from guara_perception.terrain.map.known_ground import KnownGround, declared_heights
from guara_perception.terrain.map.look import LOOKED_AT, look_at
from guara_perception.terrain.map.odom_cells import OdomCells
from guara_perception.terrain.map.snapshot import MapPause


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
    if terrain.metadata.get("rounding") is not None:
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
    """Fuse a scan; return the number of heights that disagreed with what was known."""
    look = look_at(cells, terrain, now.transform_footprint_to_odom)
    accepted = fuse_heights(cells, look.heights, now.drift, look.distance, now.pause, now.stamp)
    forget_heights(cells, look.empty, look.empty_cause)
    memory = cells.memory
    # A cause says more than "never looked at", and a look without return more than no look.
    cause = memory["cause"][look.unseen]
    is_unknown = np.isnan(memory["height"][look.unseen])
    better = is_unknown & ((cause & LOOKED_AT) == 0) & (look.unseen_cause != np.uint16(Hazard.UNSCANNED))
    memory["cause"][look.unseen[better]] = look.unseen_cause[better] & UNKNOWN_MASK
    return int((~accepted).sum())


def fuse_known_ground(cells: OdomCells, ground: KnownGround, now: MapPause, step: int) -> dict[str, Any]:
    """Fill the cells of a declared patch; return its entry in the metadata of the map."""
    heights, distance = declared_heights(cells, ground, now.transform_footprint_to_odom)
    fuse_heights(cells, heights, now.drift, distance, now.pause, now.stamp, is_look=False)
    return {
        "step": step,
        "outline": ground.outline.tolist(),
        "height": ground.height,
        "sigma": ground.sigma,
        "cells": int(heights.slot.size),
    }
