"""Simulation of a robot on terrain: world, rangefinder, walk.

It imports `calibration`, `ranging`, `terrain`, `kinematics` and `drivers`; `app`, `testbed`, `benchmarks` and
`examples` use it.
"""

from __future__ import annotations

from guara_perception.simulation.light import EFFECTS as EFFECTS
from guara_perception.simulation.light import Light as Light
from guara_perception.simulation.light import real_light as real_light
from guara_perception.simulation.rangefinder import SimulatedRangefinder as SimulatedRangefinder
from guara_perception.simulation.specimen import specimen as specimen
from guara_perception.simulation.world import World as World
from guara_perception.simulation.world import load_world as load_world
