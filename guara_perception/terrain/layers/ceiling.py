"""Upper bounds of unknown ground in a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float32
from guara_perception.exceptions import InvalidInput
from kinematics.arrays import read_only


@dataclass(frozen=True, slots=True, eq=False)
class Ceiling:
    """Upper bounds of the ground in a grid, by `LinesOfSight.ceiling`.

    Attributes:
        height: (ny, nx) upper bound of the ground's height in each cell, in base_footprint [m]; NaN where unbounded.
        sigma: standard deviation of each bound [m].
    """

    height: Float32
    sigma: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sigma) and self.sigma >= 0) or np.ndim(self.height) != 2:
            raise InvalidInput(
                f"a ceiling of shape {np.shape(self.height)} with sigma {self.sigma}, it must be (ny, nx) with a "
                "finite sigma of 0 or more [m]"
            )
        object.__setattr__(self, "height", read_only(np.asarray(self.height, np.float32)))
