"""A simulated robot on simulated terrain: world, rangefinder, walk; the test bench of everything above it.

Imports `calibration`, `ranging`, `terrain` and, for the emulated camera, `drivers`; `app`, tests and benchmarks use it.
"""

from __future__ import annotations

from guara_perception.simulation.light import Light
from guara_perception.simulation.random_world import random_world
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.real_light import EFFECTS, real_light
from guara_perception.simulation.specimen import specimen
from guara_perception.simulation.world import World
from guara_perception.simulation.world_file import load_world

__all__ = [
    "EFFECTS",
    "Light",
    "SimulatedRangefinder",
    "World",
    "load_world",
    "random_world",
    "real_light",
    "specimen",
]
