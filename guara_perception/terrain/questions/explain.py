"""`explain`: what is known of a place, and why a foot may or may not go there."""

from __future__ import annotations

import numpy as np

from guara_perception.terrain.layers.hazard import MEANING, UNKNOWN_MASK, Hazard
from guara_perception.terrain.layers.layered_grid import LayeredGrid
from guara_perception.terrain.questions.foothold import FootholdVerdict, check_foothold


def explain(terrain: LayeredGrid, x: float, y: float) -> str:
    """One sentence: what is known about the ground at a point, and why a foot may or may not go there."""
    flags = terrain.hazard_at(float(x), float(y))
    point = f"x={float(x):.3f} y={float(y):.3f}"
    iy, ix = terrain.geometry.indices(float(x), float(y))
    if not terrain.geometry.contains(iy, ix):
        (x0, y0), (ny, nx) = terrain.origin, terrain.shape
        end_x, end_y = x0 + nx * terrain.resolution, y0 + ny * terrain.resolution
        return f"{point} is off the grid (x {x0:.3f} ... {end_x:.3f}, y {y0:.3f} ... {end_y:.3f} m): not traversable"
    causes = "; ".join(MEANING[flag] for flag in Hazard if flag and flag in flags)
    if int(flags) & int(UNKNOWN_MASK):
        return f"{point} is unknown: {causes}; not traversable"
    layer = {name: float(values[iy, ix]) for name, values in terrain.layers.items()}
    phrases = [
        f"{point} is {layer['elevation'] * 1e3:.1f} mm high (sigma {np.sqrt(layer['variance']) * 1e3:.1f} mm)",
        _slope_words(layer["slope"], layer["roughness"]),
        f"step {layer['step_height'] * 1e3:.1f} mm",
        f"clearance {layer['clearance'] * 1e3:.0f} mm",
        _seen_words(int(layer["looks"]), int(layer["age"])),
    ]
    text = ", ".join(phrases)
    if flags == Hazard.NONE:
        return f"{text}: traversable, score {layer['traversability']:.2f}"
    verdict = check_foothold(terrain, x, y)
    assert isinstance(verdict, FootholdVerdict)
    tests = "; ".join(str(reason) for reason in verdict.reasons)
    return f"{text}: not traversable: {causes}" + (f" [{tests}]" if tests else "")


def _slope_words(slope: float, roughness: float) -> str:
    if not np.isfinite(slope):
        return "slope not known (too little around it)"
    return f"slope {np.degrees(slope):.1f} deg, roughness {roughness * 1e3:.1f} mm"


def _seen_words(looks: int, age: int) -> str:
    source = "felt by a foot or declared by the gait" if looks == 0 else f"seen by {looks} scan" + "s" * (looks > 1)
    return source + (f", last {age} pause{'s' * (age > 1)} ago" if age else ", now")
