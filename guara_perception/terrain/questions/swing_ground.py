"""Ground below a swing: the grid, bounds of unknown cells, and the sole that stands at the start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Flags, Float, Float32, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.layers.ceiling import Ceiling
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from guara_perception.terrain.layers.layered_grid import LayeredGrid
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
        rounding: largest fraction of itself by which rounding on the wire may have raised `variance`.
    """

    geometry: GridGeometry
    hazard: Flags
    top: Float32
    variance: Float32
    confidence: float
    rounding: float


def swing_ground(terrain: LayeredGrid, start: Float, ceiling: Ceiling | None = None) -> SwingGround:
    """Ground under a path that begins at `start` (3,).

    Unknown cells with a ceiling are as high as the ceiling, unless they lie under a standing sole.

    A sole that stands at `start` rests on the ground, so nothing below it is higher than the sole. Unknown cells that
    lie wholly under that sole, reduced by its error, therefore count as being as high as the sole. This does not make
    them footholds, and does not extend to cells beside the sole.
    """
    hazard, top, variance = terrain.hazard.copy(), terrain.elevation_max.copy(), terrain.variance.copy()
    limits = terrain.record.required_limits
    rounding = terrain.record.checked_rounding.variance
    unknown = (hazard & UNKNOWN_MASK) != 0
    if ceiling is not None:
        if ceiling.height.shape != terrain.shape:
            raise InvalidInput(f"a ceiling of shape {ceiling.height.shape} for a grid of {terrain.shape}")
        bounded = unknown & np.isfinite(ceiling.height)
        # A ceiling's variance was not rounded: it is raised by the fraction that users of `variance` subtract again.
        hazard[bounded], top[bounded], variance[bounded] = 0, ceiling.height[bounded], ceiling.sigma**2 * (1 + rounding)
    half = np.array([limits.sole_length, limits.sole_width]) / 2 - terrain.resolution / 2 + 1e-9
    # Loading the robot's model takes time, so it is loaded only if there are unknown cells at the start.
    sole = _sole_at(terrain, start) if (unknown & _within(terrain, start, half + SAME_PLACE_M)).any() else None
    if sole is not None:
        covered = half - limits.confidence * np.sqrt(np.diag(sole.covariance)[:2])
        borne = unknown & _within(terrain, sole.centre, covered)
        hazard[borne], top[borne], variance[borne] = 0, sole.centre[2], sole.covariance[2, 2]
    return SwingGround(terrain.geometry, hazard, top, variance, limits.confidence, rounding)


def _within(terrain: LayeredGrid, centre: Float, half: Float) -> Mask:
    """Cells whose centres lie in a rectangle about a centre; `half` is half its length along x and y [m]."""
    x, y = terrain.geometry.centres()
    return np.asarray((np.abs(y - centre[1]) <= half[1])[:, None] & (np.abs(x - centre[0]) <= half[0]))


def _sole_at(terrain: LayeredGrid, start: Float) -> StandingSole | None:
    """The standing sole at the start of a path; None if there is none, or the grid holds no stance."""
    try:
        soles = standing_soles(terrain)
    except (InvalidInput, KinematicsError):
        return None
    return next((sole for sole in soles if np.linalg.norm(sole.centre - start) <= SAME_PLACE_M), None)
