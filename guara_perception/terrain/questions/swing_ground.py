"""The ground that a swinging foot must stay above: that of the grid, and where it starts the sole that stands there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Flags, Float, Float32, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from guara_perception.terrain.layers.layered_grid import Ceiling, LayeredGrid
from guara_perception.terrain.questions.leg_reach import StandingSole, standing_soles
from kinematics import KinematicsError

# A path whose start is this near to the centre of a standing sole begins at that sole.
SAME_PLACE_M = 0.010


@dataclass(frozen=True, slots=True)
class SwingGround:
    """The layers of a grid that a swing needs.

    Attributes:
        geometry: geometry of the grid.
        hazard: (ny, nx) flags.
        top: (ny, nx) highest sample of each cell [m].
        variance: (ny, nx) variance of the heights [m^2].
        confidence: number of sigmas that are added to `top`.
        rounding: largest share of itself by which rounding on the wire may have raised `variance`.
    """

    geometry: GridGeometry
    hazard: Flags
    top: Float32
    variance: Float32
    confidence: float
    rounding: float


def swing_ground(terrain: LayeredGrid, start: Float, ceiling: Ceiling | None = None) -> SwingGround:
    """The ground under a path that begins at `start` (3,).

    Unknown cells that a ceiling bounds are taken to be as high as that bound, unless they lie under a standing sole.

    A sole that stands at `start` rests on the ground below it: nothing there is higher than the sole, whether a scan
    saw it or not. So unknown cells that lie wholly under that sole, with its own error allowed for, are taken to be as
    high as the sole. This says nothing about whether a foot may be set there, nor about any cell beside the sole.
    """
    hazard = np.asarray(terrain.hazard)
    top, variance = np.asarray(terrain.elevation_max), np.asarray(terrain.variance)
    limits = terrain.record.required_limits
    rounding = terrain.record.checked_rounding.variance
    unknown = (hazard & UNKNOWN_MASK) != 0
    if ceiling is not None:
        if ceiling.height.shape != terrain.shape:
            raise InvalidInput(f"a ceiling of shape {ceiling.height.shape} for a grid of {terrain.shape}")
        bounded = unknown & np.isfinite(ceiling.height)
        hazard, top, variance = hazard.copy(), top.copy(), variance.copy()
        # A ceiling's variance was not rounded: it is raised by the share that users of `variance` subtract again.
        hazard[bounded], top[bounded], variance[bounded] = 0, ceiling.height[bounded], ceiling.sigma**2 * (1 + rounding)
    ground = SwingGround(terrain.geometry, hazard, top, variance, limits.confidence, rounding)
    half = np.array([limits.sole_length, limits.sole_width]) / 2 - terrain.resolution / 2 + 1e-9
    # Loading the robot's model costs time: only where unknown cells lie at the start.
    sole = _sole_at(terrain, start) if (unknown & _within(terrain, start, half + SAME_PLACE_M)).any() else None
    if sole is None:
        return ground
    borne = unknown & _within(terrain, sole.centre, half - limits.confidence * np.sqrt(np.diag(sole.covariance)[:2]))
    hazard, top, variance = hazard.copy(), top.copy(), variance.copy()
    hazard[borne], top[borne], variance[borne] = 0, sole.centre[2], sole.covariance[2, 2]
    return SwingGround(terrain.geometry, hazard, top, variance, limits.confidence, rounding)


def _within(terrain: LayeredGrid, centre: Float, half: Float) -> Mask:
    """Cells whose centres lie in a rectangle about a centre; `half` is half its length along x and y [m]."""
    x, y = terrain.geometry.centres()
    return np.asarray((np.abs(y - centre[1]) <= half[1])[:, None] & (np.abs(x - centre[0]) <= half[0]))


def _sole_at(terrain: LayeredGrid, start: Float) -> StandingSole | None:
    """The standing sole that a path begins at; None where none does, or the grid does not say how the robot stood."""
    try:
        soles: Sequence[StandingSole] = standing_soles(terrain)
    except (InvalidInput, KinematicsError):
        return None
    return next((sole for sole in soles if np.linalg.norm(sole.centre - start) <= SAME_PLACE_M), None)
