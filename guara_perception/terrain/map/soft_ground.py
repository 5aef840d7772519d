"""Ground that gave way under a foot: soles that sank below the map or slid, and the surface around them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Float, Mask
from guara_perception.terrain.map.support_feet import SoleError

# Depth below the map beyond which a sole counts as sunk, in metres and in sigmas of legs and map. The larger limit
# applies, plus the height range of the map under the sole. Legs bend and maps drift by less; snow, foam and loose
# gravel give way by more.
SINK_M, SINK_SIGMAS = 0.008, 4.0
# A foot that odometry reports as slipped counts as slid if it moved farther than the others by more than CREEP_M plus
# SLIP_SIGMAS standard deviations of the difference of two readings of its position. Soles that rock on stiff ankles
# creep by about CREEP_M in MuJoCo.
CREEP_M, SLIP_SIGMAS = 0.020, 4.0
# The surface continues up to REACH_M from the foothold, over neighbours that differ in height by STEP_M at most.
REACH_M, STEP_M = 0.30, 0.005
# Largest number of footholds in memory, enough for 4.5 m of walking; the oldest are forgotten first.
MOST_FOOTHOLDS = 128
ALIKE = 2
# Distance up to which two footholds count as one.
APART_M = 0.02


@dataclass(frozen=True, slots=True)
class SoftFoothold:
    """Foothold at which a foot sank or slid, as the centre of the sole in odom [m]."""

    x: float
    y: float


def sunk_feet(soles: Mapping[str, SoleError], variance: float, tilt: Float) -> dict[str, float]:
    """Feet that sank below the map, with their depths [m].

    The depth of a sole is measured relative to the height predicted from the walk and from the other soles that did not
    sink. Errors of height and tilt are common to all soles.

    Args:
        soles: leg -> error of its sole relative to the map.
        variance: variance of the walk's height relative to the map, before these soles [m^2].
        tilt: covariance (2, 2) of the tilt of the soles relative to the map [rad^2].
    """
    standing, sunk = dict(soles), dict[str, float]()
    while standing:
        arms = np.array([sole.arm for sole in standing.values()])
        own = np.diag([sole.variance for sole in standing.values()])
        weights = np.linalg.inv(own + arms @ tilt @ arms.T + variance)
        # Leave-one-out residuals (W r)_i / W_ii, whose variance is 1 / W_ii.
        precision = np.diag(weights)
        depths = -(weights @ [sole.residual for sole in standing.values()]) / precision
        # Near an edge that is misplaced in the map, a sole may stand lower although the ground is hard.
        reliefs = np.array([sole.relief for sole in standing.values()])
        apart = np.abs(depths) > np.maximum(SINK_M, SINK_SIGMAS / np.sqrt(precision)) + reliefs
        if not apart.any():
            break
        # The sole that is farthest off is removed first, because it affects the others; if the tilt is uncertain, the
        # diagonally opposite one appears as deep and is removed too.
        farthest = int(np.where(apart, np.abs(depths), -np.inf).argmax())
        alike = apart & (np.abs(depths) > abs(depths[farthest]) - 1.0 / np.sqrt(precision[farthest]))
        # A sole far above the map stands on ground that the map lacks; the others did not sink relative to it.
        deep = alike & (depths > 0)
        for row, leg in enumerate(list(standing)):
            if deep[row]:
                sunk[leg] = float(depths[row])
            if deep[row] or (row == farthest and not deep.any()):
                del standing[leg]
    return sunk


def slid_feet(slips: Mapping[str, float], slipped: tuple[str, ...], variances: Mapping[str, float]) -> dict[str, float]:
    """Feet that slid relative to the others, with the distances [m].

    Args:
        slips: leg -> distance by which each standing foot moved since the last pause [m].
        slipped: feet that, according to odometry, moved relative to the others.
        variances: leg -> variance of its horizontal position in one pause [m^2]; feet without an entry did not carry
            the body and are not returned.
    """
    common = float(np.median([distance for leg, distance in slips.items() if leg not in slipped] or [0.0]))
    ways = {leg: slips[leg] - common for leg in slipped if leg in slips and leg in variances}
    return {leg: way for leg, way in ways.items() if way > CREEP_M + SLIP_SIGMAS * np.sqrt(2.0 * variances[leg])}


def remembered(soft: tuple[SoftFoothold, ...], centres: list[Float]) -> tuple[SoftFoothold, ...]:
    """Add footholds at centres in odom, newest last; skip near duplicates, and drop the oldest beyond the limit."""
    for x, y, *_ in centres:
        if all(np.hypot(x - each.x, y - each.y) > APART_M for each in soft):
            soft = (*soft, SoftFoothold(float(x), float(y)))
    return soft[-MOST_FOOTHOLDS:]


def soft_cells(
    heights: Float, first: tuple[int, int], resolution: float, soft: tuple[SoftFoothold, ...], sole: float
) -> Mask:
    """Mask (ny, nx) of the known cells around soft footholds, and of the surface that continues from there.

    Args:
        heights: (ny, nx) heights of cells in odom [m], NaN where unknown.
        first: (cy, cx) of `heights[0, 0]` in the lattice of odom.
        resolution: cell edge [m].
        soft: soft footholds.
        sole: distance from the centre of a foothold within which all known cells are soft [m].
    """
    found = np.zeros(heights.shape, dtype=bool)
    known = np.isfinite(heights)
    image = np.nan_to_num(heights).astype(np.float32)
    y, x = ((np.arange(count) + low + 0.5) * resolution for count, low in zip(heights.shape, first, strict=True))
    for each in soft:
        away = np.hypot(x - each.x, (y - each.y)[:, None])
        under, near = known & (away <= sole), known & (away <= REACH_M)
        # Mask of OpenCV, with a border: cells that are not 0 are closed, cells that the fill reaches become ALIKE.
        mask = np.pad((~near).astype(np.uint8), 1, constant_values=1)
        for row, column in np.argwhere(under).tolist():
            if not mask[row + 1, column + 1]:
                cv2.floodFill(image, mask, (column, row), 0.0, STEP_M, STEP_M, 8 | cv2.FLOODFILL_MASK_ONLY | ALIKE << 8)
        found |= mask[1:-1, 1:-1] == ALIKE
    return found
