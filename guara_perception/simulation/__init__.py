"""A simulated robot on simulated terrain: world, rangefinder, walk.

Imports `calibration`, `ranging`, `terrain` and, for the emulated camera, `drivers`; `app` and the test bench use it.
"""

from __future__ import annotations

from guara_perception.simulation.light import Light
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.real_light import EFFECTS, real_light
from guara_perception.simulation.specimen import specimen
from guara_perception.simulation.world import World, load_world

__all__ = [
    "EFFECTS",
    "Light",
    "SimulatedRangefinder",
    "World",
    "load_world",
    "real_light",
    "specimen",
]
