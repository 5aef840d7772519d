"""Light outside a laboratory, with effects scaled relative to their strength in photographs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from guara_perception.exceptions import InvalidInput
from guara_perception.simulation.light import Light

PLAIN = Light()
# Values at strength 1, unless noted: the strongest in photographs of laser lines (21 combinations of camera and scene),
# converted to images of the simulated camera (0.88 mm of ground per pixel at 640 x 512).
WIDEST_SIGMA_M = 0.0045  # 12 px wide at half its height
STRONGEST_SKIRT = 0.12
STRONGEST_HALO = 150.0
# Factors of the laser light for "halo" and "clipping": without the halo, the clipped cores on soil are up to about 1 px
# and 3 px wide.
LEAST_CLIPPED, MOST_CLIPPED = 3.0, 8.0
MOST_LEAKAGE = (0.25, 0.52, 1.0)
# Factor of the ambient light. Most red levels of soil are then 170 to 310 before clipping at 255, and brighter surfaces
# are clipped.
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
