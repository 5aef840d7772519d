"""`Ceiling`: how high the ground of each cell of a grid can be at most."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float32, readonly
from guara_perception.exceptions import InvalidInput


@dataclass(frozen=True, slots=True, eq=False)
class Ceiling:
    """Upper bounds of the ground for one grid, as `LinesOfSight.ceiling` gives them.

    Attributes:
        height: (ny, nx) upper bound of the ground's height in each cell, in base_footprint [m]; NaN where there is
            none.
        sigma: standard deviation of each bound [m].
    """

    height: Float32
    sigma: float

    def __post_init__(self) -> None:
        """Check and freeze."""
        if not (np.isfinite(self.sigma) and self.sigma >= 0) or np.ndim(self.height) != 2:
            raise InvalidInput(
                f"a ceiling of shape {np.shape(self.height)} with sigma {self.sigma}, it must be (ny, nx) with a "
                "finite sigma of 0 or more [m]"
            )
        object.__setattr__(self, "height", readonly(np.asarray(self.height, np.float32)))
