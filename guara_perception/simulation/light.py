"""Parameters of light and sensor of the simulated rangefinder: brightness, noise, stripe width, real-light effects."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from guara_perception.exceptions import InvalidInput

# Upper bounds of fields.
MOST = {"skirt": 1, "ghost": 1, "chessboard": 1, "jpeg_quality": 100}


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """Light, laser and sensor; levels are grey levels at nominal exposure, before clipping at 255.

    The effects from `skirt` to `jpeg_quality` occur outside a laboratory and are off by default. `real_light` scales
    them relative to their strength in photographs.

    Attributes:
        ambient: levels of blue, green and red on a white, horizontal surface under the ambient light.
        sun: share of the ambient light that comes from one direction; the rest comes evenly from the sky.
        laser: level of the stripe's centre in the red channel, before blur and vignetting, on a white surface that
            faces the laser 0.5 m away.
        leakage: factors of the laser light in the blue, green and red channels.
        stripe_sigma: standard deviation of the laser plane's Gaussian profile [m].
        fan: half the fan angle of the laser line [rad].
        speckle: relative standard deviation of the laser light from pixel to pixel.
        bounce: strength of indirect light from one surface on another, 1 = physical, 0 = none.
        blur: standard deviation of the blur of the lens [px].
        shot_noise: variance of the noise per grey level.
        read_noise: standard deviation of the noise at level 0.
        vignetting: exponent v of the brightness cos(field angle)^v.
        texture: factor of the mottled texture of the ground, 0 = none.
        skirt: level of the light scattered by the lens, relative to the stripe's peak (clipped at 255). It is constant
            up to 8 px beside the stripe and decreases from there; it ends at 40 px.
        halo: level beside a clipped core of the stripe; it fades to 8 % at 20 px.
        ghost: relative strength of a second image of the stripe, caused by reflection.
        blotches: standard deviation of the noise in patches of several pixels [grey levels], independent in each
            channel.
        flicker: relative standard deviation of the ambient light from image to image.
        drift: gains of blue, green and red in laser-on images relative to laser-off images, due to automatic exposure
            and white balance.
        chessboard: share, 0 ... 1, of a chessboard with 20 mm squares in the albedo of the ground, except that of
            absorbing material.
        demosaiced: True to interpolate the pixels from a colour filter array.
        jpeg_quality: quality of JPEG compression with halved colour resolution (4:2:0), 1 ... 100; 0 = none.
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
    texture: float = 1.0
    skirt: float = 0.0
    halo: float = 0.0
    ghost: float = 0.0
    blotches: float = 0.0
    flicker: float = 0.0
    drift: tuple[float, float, float] = (1.0, 1.0, 1.0)
    chessboard: float = 0.0
    demosaiced: bool = False
    jpeg_quality: int = 0

    def __post_init__(self) -> None:
        for f in fields(self):
            values = np.atleast_1d(getattr(self, f.name))
            if not np.isfinite(values).all() or (values < 0).any():
                raise InvalidInput(f"light: {f.name} is {getattr(self, f.name)}, allowed: finite values of 0 or more")
        if self.stripe_sigma <= 0 or self.fan <= 0:
            given = f"stripe_sigma is {self.stripe_sigma} m, fan is {self.fan} rad"
            raise InvalidInput(f"light: {given}, allowed: values above 0")
        for name, most in MOST.items():
            if getattr(self, name) > most:
                raise InvalidInput(f"light: {name} is {getattr(self, name)}, allowed: 0 ... {most}")
        if min(self.drift) <= 0:
            raise InvalidInput(f"light: drift is {self.drift}, allowed: values above 0")

    @property
    def is_scattered(self) -> bool:
        """True if lens or sensor adds laser light beside the stripe."""
        return self.skirt > 0 or self.halo > 0 or self.ghost > 0

    @property
    def is_even(self) -> bool:
        """True if laser-on and laser-off images differ only by noise where no laser light falls."""
        return not (self.is_scattered or self.blotches or self.flicker or self.demosaiced or self.jpeg_quality) and (
            self.drift == (1.0, 1.0, 1.0)
        )
