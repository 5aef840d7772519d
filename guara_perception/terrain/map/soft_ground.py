"""Ground that gave way under a foot: soles that sank below the map or slid, and where the surface goes on alike."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Float, Mask
from guara_perception.terrain.map.support_feet import SoleError

# A sole this far below the map, beyond SINK_SIGMAS of what legs and map know, sank [m]. Legs bend and maps drift by
# less; snow, foam and loose gravel give way by more.
SINK_M, SINK_SIGMAS = 0.008, 4.0
# A standing foot that moved this much further than the others slid [m]; soles that rock on stiff ankles creep by 20 mm.
SLIP_M = 0.030
# The surface goes on alike, no further than this from the foothold, over cells that differ from the next by less [m].
REACH_M, STEP_M = 0.30, 0.005
# Footholds that are remembered; a walk of 5 m has as many. The oldest go first.
MOST_FOOTHOLDS = 128
ALIKE = 2
# Two footholds nearer to one another are one [m].
APART_M = 0.02


@dataclass(frozen=True, slots=True)
class SoftFoothold:
    """Place in odom where a foot sank or slid: centre of the sole [m]."""

    x: float
    y: float


def sunk_feet(soles: Mapping[str, SoleError], variance: float) -> dict[str, float]:
    """Feet that sank below the map, and how far [m]: by the walk's height before, and by the feet that did not sink.

    Args:
        soles: leg -> its error against the map.
        variance: of the walk's height against the map, before these soles [m^2].
    """
    standing, sunk = dict(soles), dict[str, float]()
    while standing:
        depths = {}
        for leg, sole in standing.items():
            weights = [1 / variance] if variance > 0 else [1e12]
            others = [other for name, other in standing.items() if name != leg]
            weights += [1 / other.variance for other in others]
            height = sum(w * other.residual for w, other in zip(weights[1:], others, strict=True)) / sum(weights)
            depth, sigma = height - sole.residual, np.sqrt(sole.variance + 1 / sum(weights))
            # Beside an edge that the map has elsewhere a sole stands lower on hard ground.
            if depth > max(SINK_M, SINK_SIGMAS * sigma) + sole.relief:
                depths[leg] = float(depth)
        if not depths:
            break
        # The deepest first: it pulls the height of the others.
        deepest = max(depths, key=lambda leg: depths[leg])
        sunk[deepest] = depths[deepest]
        del standing[deepest]
    return sunk


def slid_feet(slips: Mapping[str, float], slipped: tuple[str, ...]) -> dict[str, float]:
    """Feet that slid relative to the others, and how far [m].

    Args:
        slips: leg -> distance by which each foot that stood moved since the last pause [m].
        slipped: feet that odometry found to have moved against the others.
    """
    common = float(np.median([distance for leg, distance in slips.items() if leg not in slipped] or [0.0]))
    return {leg: slips[leg] - common for leg in slipped if slips.get(leg, 0.0) - common > SLIP_M}


def remembered(soft: tuple[SoftFoothold, ...], centres: list[Float]) -> tuple[SoftFoothold, ...]:
    """Footholds with new ones at these centres in odom, the newest last."""
    for x, y, *_ in centres:
        if all(np.hypot(x - each.x, y - each.y) > APART_M for each in soft):
            soft = (*soft, SoftFoothold(float(x), float(y)))
    return soft[-MOST_FOOTHOLDS:]


def soft_cells(
    heights: Float, first: tuple[int, int], resolution: float, soft: tuple[SoftFoothold, ...], sole: float
) -> Mask:
    """Known cells (ny, nx) round the footholds and where the surface goes on alike.

    Args:
        heights: (ny, nx) of cells of odom [m], NaN where unknown.
        first: (cy, cx) of the first of them.
        resolution: of the cells [m].
        soft: the footholds.
        sole: distance from a foothold's centre within which everything is soft [m].
    """
    found = np.zeros(heights.shape, dtype=bool)
    known = np.isfinite(heights)
    image = np.nan_to_num(heights).astype(np.float32)
    y, x = ((np.arange(count) + low + 0.5) * resolution for count, low in zip(heights.shape, first, strict=True))
    for each in soft:
        away = np.hypot(x - each.x, (y - each.y)[:, None])
        under, near = known & (away <= sole), known & (away <= REACH_M)
        # OpenCV's mask: closed cells are not 0, those that it reaches become ALIKE.
        mask = np.pad((~near).astype(np.uint8), 1, constant_values=1)
        for row, column in np.argwhere(under).tolist():
            if not mask[row + 1, column + 1]:
                cv2.floodFill(image, mask, (column, row), 0.0, STEP_M, STEP_M, 8 | cv2.FLOODFILL_MASK_ONLY | ALIKE << 8)
        found |= mask[1:-1, 1:-1] == ALIKE
    return found
