"""Fusion of heights into the cells of the map: a gated Kalman filter per cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Flags, Float, Index, Mask
from guara_perception.terrain.layers.hazard import Hazard
from guara_perception.terrain.map.odom_cells import OdomCells
from guara_perception.terrain.map.walk_correction import SidewaysDrift

# Gate of the innovation. It rejects one correct observation in 370; the height is replaced only when the next
# observation agrees with the rejected one.
GATE_SIGMAS = 3.0
# Causes of cells that were observed without a usable height.
LOOKED_AT = np.uint16(Hazard.DROPOUT | Hazard.AMBIGUOUS | Hazard.OUT_OF_RANGE)


@dataclass(frozen=True, slots=True)
class OdometryDrift:
    """Variances of the drift accumulated since the start, after the map's corrections of leg odometry.

    Attributes:
        rise: variance of z [m^2].
        shift: upper bound of the horizontal variance in any direction [m^2].
        turn: variance of yaw [rad^2].
    """

    rise: float = 0.0
    shift: float = 0.0
    turn: float = 0.0


@dataclass(frozen=True, slots=True)
class MapPause:
    """Pause at which the map is updated or queried.

    Attributes:
        pause: number of the pause.
        stamp: time of the pause, on the clock from which the age of cells is computed [ns].
        drift: drift up to this pause.
        sideways: planar drift of the walk, by pause.
        transform_footprint_to_odom: (4, 4) pose of the robot.
    """

    pause: int
    stamp: int
    drift: OdometryDrift
    sideways: SidewaysDrift
    transform_footprint_to_odom: Float


@dataclass(frozen=True, slots=True)
class Heights:
    """New heights of cells, arrays (n,).

    Attributes:
        slot: slot of each cell in the map's memory, without duplicates.
        height: height in odom [m].
        variance: variance of the height [m^2].
        local: part of the variance that is not shared by neighbouring cells [m^2].
        distance: distance of each cell from the robot, the lever arm of a yaw error [m].
        below, above: distance of the lowest and highest sample from the height, 0 or more [m].
        steepness: tan^2 of the slope.
    """

    slot: Index
    height: Float
    variance: Float
    local: Float
    distance: Float
    below: Float | float = 0.0
    above: Float | float = 0.0
    steepness: Float | float = 0.0


def drift_variance(cells: OdomCells, slot: Index, drift: OdometryDrift, distance: Float) -> Float:
    """Increase of the height variance since cells were last seen [m^2], due to drift in z and planar drift on slopes.

    Args:
        cells: memory of the map.
        slot: (n,) slots of the cells.
        drift: drift up to the current pause.
        distance: (n,) distances of the cells from the robot [m], the lever arm of a yaw error.
    """
    memory = cells.memory
    rise, shift, turn = (
        np.maximum(getattr(drift, name) - memory[name][slot], 0.0) for name in ("rise", "shift", "turn")
    )
    return np.asarray(rise + memory["steepness"][slot] * (shift + turn * distance**2))


def fuse_heights(cells: OdomCells, new: Heights, now: MapPause, *, is_scan: bool = True) -> Mask:
    """Fuse heights into the memory by a Kalman filter per cell, with a gate on the innovation.

    An unknown cell gets the new height. A known cell is updated if the innovation is within GATE_SIGMAS; otherwise it
    keeps its height and is in conflict. In a cell in conflict, each new height is compared with the previous one, and
    two successive heights that agree replace the old height.

    Args:
        cells: memory of the map, changed in place.
        new: heights to fuse.
        now: current pause.
        is_scan: True for heights from a scan, False for heights from a foot or the gait.

    Returns:
        Mask (n,) of the accepted heights.
    """
    memory, slot = cells.memory, new.slot
    grown = drift_variance(cells, slot, now.drift, new.distance)
    height, variance = memory["height"][slot], memory["variance"][slot] + grown
    below, above = memory["below"][slot], memory["above"][slot]
    other, other_variance = memory["other"][slot], memory["other_variance"][slot] + grown
    was_known, disputed = np.isfinite(height), memory["conflict"][slot]

    def agrees(value: Float, its_variance: Float) -> Mask:
        with np.errstate(invalid="ignore"):
            return np.asarray(np.abs(new.height - value) <= GATE_SIGMAS * np.sqrt(its_variance + new.variance))

    confirmed = was_known & ~disputed & agrees(height, variance)
    settled = was_known & disputed & agrees(other, other_variance)
    rejected = was_known & ~confirmed & ~settled
    prior = np.where(settled, other, height)
    prior_variance = np.where(settled, other_variance, variance)
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = np.where(prior_variance > 0, prior_variance / (prior_variance + new.variance), 0.0)
    corrected = prior + gain * (new.height - prior)
    accepted = confirmed | settled

    memory["height"][slot] = np.where(accepted, corrected, np.where(was_known, height, new.height))
    memory["variance"][slot] = np.where(
        accepted, (1 - gain) * prior_variance, np.where(was_known, variance, new.variance)
    )
    prior_local = np.where(settled, new.local, memory["local"][slot])
    fused_local = (1 - gain) ** 2 * prior_local + gain**2 * new.local
    memory["local"][slot] = np.where(accepted, fused_local, np.where(was_known, prior_local, new.local))
    # While observations disagree, the extremes of both are kept.
    below_both = np.maximum(below, height - (new.height - new.below))
    above_both = np.maximum(above, new.height + new.above - height)
    memory["below"][slot] = np.where(confirmed, np.maximum(below, new.below), np.where(rejected, below_both, new.below))
    memory["above"][slot] = np.where(confirmed, np.maximum(above, new.above), np.where(rejected, above_both, new.above))
    memory["steepness"][slot] = np.where(rejected, np.maximum(memory["steepness"][slot], new.steepness), new.steepness)
    memory["conflict"][slot] = rejected
    memory["other"][slot] = np.where(rejected, new.height, np.nan)
    memory["other_variance"][slot] = np.where(rejected, new.variance, 0.0)
    memory["cause"][slot] = 0
    memory["pause"][slot], memory["stamp"][slot] = now.pause, now.stamp
    for name in ("rise", "shift", "turn"):
        memory[name][slot] = getattr(now.drift, name)
    if is_scan:
        looks, apart = memory["looks"][slot], memory["apart"][slot]
        # The noise of both heights and the error of the prior mean are removed. The newest observation has the largest
        # weight, because it may be the one that neighbours do not share.
        found = ((new.height - prior) ** 2 - prior_local - new.local) * looks / (looks + 1.0)
        apart = np.where(accepted, np.maximum(found, (apart + found) / 2), apart)
        memory["apart"][slot] = np.where(was_known, apart, 0.0)
        memory["looks"][slot] = np.where(was_known, np.minimum(looks, 254) + 1, 1)
    return np.asarray(~rejected)


def dispute_heights(cells: OdomCells, low: tuple[float, float], high: tuple[float, float]) -> None:
    """Mark the known cells of a rectangle whose ground moved as in conflict; an observation that agrees ends it.

    `low` and `high` are corners (x, y) in odom [m].
    """
    memory, slot = cells.memory, cells.slots(*cells.cells_between(low, high))
    slot = slot[np.isfinite(memory["height"][slot]) & ~memory["conflict"][slot]]
    memory["conflict"][slot] = True
    memory["other"][slot], memory["other_variance"][slot] = memory["height"][slot], memory["variance"][slot]


def forget_heights(cells: OdomCells, slot: Index, cause: Flags) -> None:
    """Forget the heights of cells that were observed without a usable height, and store the cause."""
    memory = cells.memory
    for name in ("height", "other"):
        memory[name][slot] = np.nan
    for name in ("variance", "local", "apart", "below", "above", "steepness", "other_variance", "looks", "conflict"):
        memory[name][slot] = 0
    memory["cause"][slot] = cause
