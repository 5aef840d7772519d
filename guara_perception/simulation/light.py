"""Light and sensor of the simulated rangefinder: how bright, how noisy, how wide the stripe."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from guara_perception.exceptions import InvalidInput


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """Light, laser and sensor; levels are those of the picture, 0 ... 255, at nominal exposure.

    Attributes:
        ambient: level of a white, level surface under the ambient light, blue, green, red.
        sun: share of the ambient light that comes from one direction (the rest from all over the sky).
        laser: level of the stripe's centre on a white surface that faces the laser 0.5 m away, in the red channel.
        leakage: share of the laser's light that the blue, green and red channel take up.
        stripe_sigma: standard deviation of the laser plane's Gaussian profile [m].
        fan: half the opening of the laser plane [rad].
        speckle: standard deviation of the laser's light from pixel to pixel, as a share.
        bounce: strength of light that comes from a surface and falls on another, 1 = as physics has it, 0 = none.
        blur: standard deviation of the lens's blur [px].
        shot_noise: variance per level, from the number of electrons.
        read_noise: standard deviation of the darkest level.
        vignetting: exponent of the fall of brightness with the cosine of the field angle.
    """

    ambient: tuple[float, float, float] = (235.0, 255.0, 270.0)
    sun: float = 0.35
    laser: float = 620.0
    leakage: tuple[float, float, float] = (0.035, 0.075, 1.0)
    stripe_sigma: float = 0.00045
    fan: float = 0.75
    speckle: float = 0.08
    bounce: float = 1.0
    blur: float = 0.55
    shot_noise: float = 0.011
    read_noise: float = 0.5
    vignetting: float = 3.0

    def __post_init__(self) -> None:
        """Refuse what no light can be."""
        for f in fields(self):
            values = np.atleast_1d(getattr(self, f.name))
            if not np.isfinite(values).all() or (values < 0).any():
                raise InvalidInput(f"light: {f.name} is {getattr(self, f.name)}, it must be finite and 0 or more")
        if self.stripe_sigma <= 0 or self.fan <= 0:
            given = f"stripe_sigma is {self.stripe_sigma} m, fan is {self.fan} rad"
            raise InvalidInput(f"light: {given}, each must be above 0")
