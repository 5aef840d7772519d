"""Ground that trenches bar for the ball feet of a stock Go2, in the map of a walk: `usable_ground --rims`."""

from __future__ import annotations

import numpy as np

import guara_perception as gp
from benchmarks.command import Table
from benchmarks.fused_walk import fused_pauses
from guara_perception.arrays import Float
from guara_perception.simulation import World
from guara_perception.simulation.features import Pit
from guara_perception.terrain.layers.hazard import ALL_BUT_EDGE
from testbed.physics.robot import go2
from testbed.scanned_walk import scanned

WIDTH_M, DEPTH_M = 0.080, 0.25
# Trenches across the way, between the tracks of the feet, so that no foot has to cross them.
FIRST_M, APART_M, COUNT, LENGTH_M = 0.75, 0.35, 3, 0.22
# Half the width of the judged strip of ground in the middle, beyond the margins of a trench's ends.
STRIP_M = 0.05
# Ground around a trench that is judged, on either side of its middle.
AROUND_M = 0.15
# Places from the body [m]: scanned again and again, before the front feet, before the hind feet.
PLACES = {"in the scans": (0.45, 0.75), "front feet": (0.10, 0.45), "hind feet": (-0.35, 0.10)}


def trenched(seed: int) -> tuple[World, Float]:
    """World with trenches drawn from a seed, and x of their middles [m]."""
    rng = np.random.default_rng([seed, 39])
    middles = FIRST_M + APART_M * np.arange(COUNT) + rng.uniform(-0.02, 0.02, COUNT)
    pits = tuple(Pit(x=float(x), y=0.0, size=(WIDTH_M, LENGTH_M), depth=DEPTH_M) for x in middles)
    return World(x=(-0.9, 3.2), y=(-0.9, 0.9), features=pits, seed=seed, undulation=0.001, flat_until=0.6), middles


def trenches(seeds: int, mode: str, cycles: int) -> None:
    """Print the lengths along x on which the map offers no place for a foot, by the place of the trench."""
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in PLACES}
    for seed in range(seeds):
        world, middles = trenched(seed)
        for item, fused in fused_pauses(gp.TerrainMap(go2()), go2(), scanned(go2(), ((0, world),), seed, mode, cycles)):
            for middle in middles - item.to_world[0, 3]:
                for name, (low, high) in PLACES.items():
                    if low <= middle < high:
                        found[name] += barred(fused, float(middle))
    table = Table(
        "trenches of 80 mm:<20 | rows:>6d | bars, median mm:7.0f | 90 %:7.0f | worst:7.0f | unknown or bad:7.0f"
    )
    for name, rows in found.items():
        if rows:
            bars, bad = 1e3 * np.array(rows).T
            table.row(name, len(rows), np.median(bars), np.quantile(bars, 0.9), bars.max(), np.median(bad))


def barred(fused: gp.TerrainGrid, middle: float) -> list[tuple[float, float]]:
    """Lengths [m] in each row across a trench without a free cell, and of cells that are unknown or hazardous."""
    x, y = fused.geometry.centres()
    columns = np.flatnonzero(np.abs(x - middle) < AROUND_M)
    lengths = []
    for hazard in fused.hazard[np.abs(y) < STRIP_M][:, columns]:
        free = np.flatnonzero(hazard == 0)
        before, after = free[x[columns[free]] < middle], free[x[columns[free]] >= middle]
        if before.size and after.size:
            lengths.append((after[0] - before[-1] - 1, int(((hazard & ALL_BUT_EDGE) != 0).sum())))
    return [(fused.resolution * length, fused.resolution * bad) for length, bad in lengths]
