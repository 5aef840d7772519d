"""Joins a new height with what a cell remembers: Kalman filter with a gate, and what happens when looks disagree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Flags, Float, Index, Mask
from guara_perception.terrain.map.odom_cells import OdomCells

# 3 sigma: one good look in 370 is taken for a disagreement, and the next one mends it.
GATE_SIGMAS = 3.0


@dataclass(frozen=True, slots=True)
class OdometryDrift:
    """How far leg odometry may have drifted since the start.

    Attributes:
        rise: variance of z [m^2].
        shift: variance along x or y, whichever is larger [m^2].
        turn: variance of the heading [rad^2].
    """

    rise: float
    shift: float
    turn: float


@dataclass(frozen=True, slots=True)
class Heights:
    """New heights of some cells, arrays (n,) of one length.

    Attributes:
        slot: slot of each cell in the memory, none twice.
        height: [m] in odom.
        variance: [m^2].
        below, above: distance of the lowest and highest sample from the height, 0 or more [m].
        steepness: tan^2 of the slope.
    """

    slot: Index
    height: Float
    variance: Float
    below: Float
    above: Float
    steepness: Float


def drift_variance(cells: OdomCells, slot: Index, drift: OdometryDrift, distance: Float) -> Float:
    """Variance that cells have gained since they were last seen: drift in z, and sideways drift on a slope [m^2].

    Args:
        cells: the memory.
        slot: (n,) slots of the cells.
        drift: drift of the odometry now.
        distance: (n,) distances of the cells from the robot [m], the lever of a wrong heading.
    """
    memory = cells.memory
    rise = np.maximum(drift.rise - memory["rise"][slot], 0.0)
    return np.asarray(rise + memory["steepness"][slot] * sideways_variance(cells, slot, drift, distance))


def sideways_variance(cells: OdomCells, slot: Index, drift: OdometryDrift, distance: Float) -> Float:
    """Variance of the sideways positions of cells that odometry has added since they were last seen [m^2].

    Args:
        cells: the memory.
        slot: (n,) slots of the cells.
        drift: drift of the odometry now.
        distance: (n,) distances of the cells from the robot [m], the lever of a wrong heading.
    """
    shift = np.maximum(drift.shift - cells.memory["shift"][slot], 0.0)
    turn = np.maximum(drift.turn - cells.memory["turn"][slot], 0.0)
    return np.asarray(shift + turn * distance**2)


def fuse_heights(
    cells: OdomCells,
    new: Heights,
    drift: OdometryDrift,
    distance: Float,
    pause: int,
    stamp: int,
    *,
    is_look: bool = True,
) -> Mask:
    """Bring new heights into memory.

    Unknown cells take them over. Known cells are corrected where the new height agrees within GATE_SIGMAS. Where it
    does not, the cell keeps its height and is marked as in conflict; from then on each new height is compared with the
    last one, and when two in a row agree they replace the old height.

    Args:
        cells: the memory, changed in place.
        new: heights.
        drift: drift of the odometry now.
        distance: (n,) distances of the cells from the robot [m].
        pause: number of this pause.
        stamp: time of this pause [ns].
        is_look: whether a scan saw the cells (and not, for instance, a foot).

    Returns:
        (n,) whether each height was accepted.
    """
    memory, slot = cells.memory, new.slot
    grown = drift_variance(cells, slot, drift, distance)
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
    joined = confirmed | settled

    memory["height"][slot] = np.where(joined, corrected, np.where(was_known, height, new.height))
    memory["variance"][slot] = np.where(
        joined, (1 - gain) * prior_variance, np.where(was_known, variance, new.variance)
    )
    # While looks disagree the lowest and the highest sample of both are kept.
    below_both = np.maximum(below, height - (new.height - new.below))
    above_both = np.maximum(above, new.height + new.above - height)
    memory["below"][slot] = np.where(confirmed, np.maximum(below, new.below), np.where(rejected, below_both, new.below))
    memory["above"][slot] = np.where(confirmed, np.maximum(above, new.above), np.where(rejected, above_both, new.above))
    memory["steepness"][slot] = np.where(rejected, np.maximum(memory["steepness"][slot], new.steepness), new.steepness)
    memory["conflict"][slot] = rejected
    memory["other"][slot] = np.where(rejected, new.height, np.nan)
    memory["other_variance"][slot] = np.where(rejected, new.variance, 0.0)
    memory["cause"][slot] = 0
    mark_seen(cells, slot, drift, pause, stamp)
    if is_look:
        looks = memory["looks"][slot]
        memory["looks"][slot] = np.where(was_known, np.minimum(looks, 254) + 1, 1)
    return np.asarray(~rejected)


def mark_seen(cells: OdomCells, slot: Index, drift: OdometryDrift, pause: int, stamp: int) -> None:
    """Remember when, and at what drift, cells were last seen."""
    for name, value in (
        ("pause", pause),
        ("stamp", stamp),
        ("rise", drift.rise),
        ("shift", drift.shift),
        ("turn", drift.turn),
    ):
        cells.memory[name][slot] = value


def forget_heights(cells: OdomCells, slot: Index, cause: Flags) -> None:
    """Forget what was known of cells that were looked at without a return."""
    memory = cells.memory
    for name in ("height", "other"):
        memory[name][slot] = np.nan
    for name in ("variance", "below", "above", "steepness", "other_variance", "looks", "conflict"):
        memory[name][slot] = 0
    memory["cause"][slot] = cause
