"""Light and sensor of the simulated rangefinder, and disturbances scaled to their strength in photographs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any

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
        chessboard: weight, 0 ... 1, of a chessboard with 20 mm squares in the albedo of the ground; absorbing material
            stays as it is.
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
        """True if, where no laser light falls, laser-on and laser-off images differ only by the noise of pixels."""
        return not (self.is_scattered or self.blotches or self.flicker or self.demosaiced or self.jpeg_quality) and (
            self.drift == (1.0, 1.0, 1.0)
        )


PLAIN = Light()
# Values at strength 1, unless noted: the strongest in photographs of laser lines (21 combinations of camera and scene),
# converted to images of the simulated camera (0.88 mm of ground per pixel at 640 x 512).
WIDEST_SIGMA_M = 0.0045  # full width at half maximum: 12 px
STRONGEST_SKIRT = 0.12
STRONGEST_HALO = 150.0
# Factors of the laser light for "halo" and "clipping": without the halo, the clipped core on soil is up to
# about 1 px wide at the least and 3 px at the most.
LEAST_CLIPPED, MOST_CLIPPED = 3.0, 8.0
MOST_LEAKAGE = (0.25, 0.52, 1.0)
# Factor of the ambient light. The red level of most pixels of soil is then 170 to 310 before clipping at 255, and
# brighter surfaces are clipped.
MOST_AMBIENT = 4.0
# Factor of the laser light: a line of 85 grey levels on soil then has 34.
WEAKEST_LASER = 0.4
MOST_NOISE, MOST_BLOTCHES = 7.0, 5.0
WORST_JPEG, BEST_JPEG = 75, 95  # BEST_JPEG: quality just above strength 0
MOST_DRIFT = (0.67, 1.4, 2.6)
MOST_FLICKER = 0.1
STRONGEST_GHOST = 0.6


def _between(least: float, most: float, strength: float) -> float:
    """Geometric interpolation between two values."""
    return float(least * (most / least) ** strength)


def _triple(least: tuple[float, ...], most: tuple[float, ...], strength: float) -> tuple[float, ...]:
    return tuple(_between(a, b, strength) for a, b in zip(least, most, strict=True))


EFFECTS: Mapping[str, Callable[[float], dict[str, Any]]] = MappingProxyType(
    {
        "width": lambda s: {"stripe_sigma": _between(PLAIN.stripe_sigma, WIDEST_SIGMA_M, s)},
        "skirt": lambda s: {"skirt": s * STRONGEST_SKIRT},
        # There is no halo without a clipped core.
        "halo": lambda s: {"halo": s * STRONGEST_HALO, "laser": PLAIN.laser * _between(1, LEAST_CLIPPED, s)},
        "clipping": lambda s: {"laser": PLAIN.laser * _between(1, MOST_CLIPPED, s)},
        "leakage": lambda s: {"leakage": _triple(PLAIN.leakage, MOST_LEAKAGE, s)},
        "ambient": lambda s: {"ambient": tuple(level * _between(1, MOST_AMBIENT, s) for level in PLAIN.ambient)},
        "weak_line": lambda s: {"laser": PLAIN.laser * _between(1, WEAKEST_LASER, s)},
        "noise": lambda s: {
            "read_noise": PLAIN.read_noise + s * (MOST_NOISE - PLAIN.read_noise),
            "blotches": s * MOST_BLOTCHES,
        },
        "demosaicing": lambda s: {"demosaiced": s > 0},
        "jpeg": lambda s: {"jpeg_quality": round(BEST_JPEG + s * (WORST_JPEG - BEST_JPEG)) if s > 0 else 0},
        "drift": lambda s: {"drift": _triple((1.0, 1.0, 1.0), MOST_DRIFT, s)},
        "flicker": lambda s: {"flicker": s * MOST_FLICKER},
        "chessboard": lambda s: {"chessboard": s},
        "ghosts": lambda s: {"ghost": s * STRONGEST_GHOST},
    }
)
"""Functions that map the strength of an effect to fields of `Light`, by the name of the effect."""


def real_light(strengths: Mapping[str, float]) -> Light:
    """Create a light with one or several effects, scaled relative to their strength in photographs of laser lines.

    If several effects change the same field, such as "clipping" and "weak_line", their factors are multiplied.

    Example:
        rangefinder = SimulatedRangefinder(world, calibration, robot, light=real_light({"ambient": 0.5, "jpeg": 1}))

    Args:
        strengths: strength of each effect, by its name in EFFECTS; 0 = none, 1 = as in the worst photograph.

    Raises:
        InvalidInput: there is no such effect, or a strength is not 0 ... 1.
    """
    options: dict[str, Any] = {}
    for name, strength in strengths.items():
        if name not in EFFECTS:
            raise InvalidInput(f"effect is {name!r}, allowed: {', '.join(EFFECTS)}")
        if not (np.isfinite(strength) and 0 <= strength <= 1):
            raise InvalidInput(f"strength of {name} is {strength}, allowed: 0 ... 1")
        for field, value in EFFECTS[name](float(strength)).items():
            known = options.get(field)
            options[field] = value if known is None else known * value / getattr(PLAIN, field)
    return Light(**options)
