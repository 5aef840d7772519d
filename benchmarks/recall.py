"""Share of the safe and visible ground that is free in maps, by kind of ground: `usable_ground --recall`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.command import Table
from benchmarks.fused_walk import FIRST_JUDGED_STEP, fused_pauses
from guara_perception.arrays import Array, Codes, Float, Index, Mask
from guara_perception.settings import Settings, TraversabilityLimits
from guara_perception.simulation.world import World
from guara_perception.terrain.layers.geometry import GridGeometry, half_cells, inside_polygon
from guara_perception.terrain.layers.hazard import Hazard
from kinematics import RobotModel
from testbed.kinds_of_ground import TRACK_M, course
from testbed.scanned_walk import SEEN_CELL_M, ScannedPause, map_geometry, scanned
from testbed.true_ground import TrueGround

# Distance from the track of the feet within which a planner searches footholds.
BESIDE_TRACK_M = 0.06
# Relief under a sole above which ground that the oracle rejects is dangerous.
DANGEROUS_RELIEF_M = 0.010
# Worlds of lower seeds were used to choose settings.
FIRST_SEED = 1000
NEVER = -1
# The disc of the tests and one cell.
BESIDE_CELLS = 4


class Seen:
    """The pause at which each cell of a world could last be seen.

    Attributes:
        last: (ny, nx) number of the pause, `NEVER` where it never could; ground that the gait declares counts as seen.
    """

    def __init__(self, world: World) -> None:
        self._corner = np.array([world.x[0], world.y[0]])
        nx, ny = (round((high - low) / SEEN_CELL_M) for low, high in (world.x, world.y))
        self.last = np.full((ny, nx), NEVER)

    def add(self, item: ScannedPause) -> None:
        """Add a pause."""
        iy, ix = item.seen.T
        self.last[iy, ix] = item.pause.step
        y, x = (SEEN_CELL_M * (np.indices(self.last.shape) + 0.5).T + self._corner[::-1]).T
        for declared in item.pause.known_ground:
            self.last[inside_polygon(declared.outline, x, y)] = item.pause.step

    def at(self, transform_footprint_to_world: Float, geometry: GridGeometry) -> Index:
        """The pause (ny, nx) at which each cell of a grid could last be seen."""
        x, y = np.meshgrid(*geometry.centres())
        transform = transform_footprint_to_world
        points = (transform[axis, 0] * x + transform[axis, 1] * y + transform[axis, 3] for axis in (0, 1))
        ix, iy = (
            np.clip(np.floor((value - low) / SEEN_CELL_M).astype(np.intp), 0, n - 1)
            for value, low, n in zip(points, self._corner, self.last.shape[::-1], strict=True)
        )
        return self.last[iy, ix]


def recall_of_kinds(robot: RobotModel, seeds: int, mode: str, cycles: int, kinds: Sequence[str]) -> None:
    """Print a line for each kind of ground, over walks of the seeds FIRST_SEED and on."""
    table = Table(
        "kind:<13 | seeable:>8d | recall:6.3f | lane:6.3f | free:>8d | relief:6d | dark:6d | never seen:10d | since:6d"
        " | lost in the lane, % of it:<40"
    )
    for kind in kinds:
        counts: Counter[str] = Counter()
        for seed in range(FIRST_SEED, FIRST_SEED + seeds):
            counts.update(walk_counts(robot, kind, seed, mode, cycles))
        lost = [(n, name) for name, n in counts.items() if name.startswith("lost")]
        shares = (f"{name[6:]} {100 * n / counts['lane']:.1f}" for n, name in sorted(lost, reverse=True)[:4])
        table.row(
            kind,
            counts["seeable"],
            counts["seeable, free"] / counts["seeable"],
            counts["lane, free"] / counts["lane"],
            *(counts[name] for name in ("free", "relief", "dark", "never seen", "since")),
            ", ".join(shares),
        )


def walk_counts(robot: RobotModel, kind: str, seed: int, mode: str, cycles: int) -> Counter[str]:
    """Counts over one walk; free cells are judged by the ground now and at the time of their last observation."""
    limits, geometry = Settings.of(robot).limits, map_geometry(robot)
    sole = sole_window(limits, geometry.resolution)
    in_lane = np.abs(np.abs(geometry.centres()[1]) - TRACK_M) <= BESIDE_TRACK_M
    on_grid = cv2.erode(np.ones(geometry.shape, np.uint8), sole, borderType=cv2.BORDER_CONSTANT, borderValue=(0,)) > 0
    states = course(kind, seed)
    firsts, truths = [first for first, _ in states], [TrueGround.of(world) for _, world in states]
    seen, counts = Seen(states[0][1]), Counter[str]()
    for item, fused in fused_pauses(gp.TerrainMap(robot), robot, scanned(robot, states, seed, mode, cycles)):
        pause, to_world = item.pause, item.to_world
        seen.add(item)
        if pause.step < FIRST_JUDGED_STEP:
            continue
        known = [first for first in firsts if first <= pause.step]
        judged = [truth.grid(to_world, geometry, robot) for truth in truths[: len(known)]]
        last, looked = (
            np.searchsorted(known, np.maximum(steps, 0), side="right") - 1
            for steps in (seen.at(to_world, geometry), pause.step - fused.layers["age"].astype(int))
        )
        now = Soles.on(judged, np.full(fused.shape, len(judged) - 1), sole, limits)
        then = Soles.on(judged, looked, sole, limits)
        free = fused.hazard == 0
        never = cv2.dilate((seen.at(to_world, geometry) == NEVER).astype(np.uint8), sole) > 0
        seeable = now.safe & Soles.on(judged, last, sole, limits).safe & ~never & on_grid
        lane = seeable & in_lane[:, None]
        counts["free"] += int(free.sum())
        for name, mask in (("seeable", seeable), ("lane", lane)):
            counts[name] += int(mask.sum())
            counts[f"{name}, free"] += int((mask & free).sum())
        for name, unsafe in (("relief", then.relief), ("dark", then.dark), ("never seen", never)):
            counts[name] += int((free & unsafe).sum())
        counts["since"] += int((free & (now.relief | now.dark) & ~then.relief & ~then.dark).sum())
        lost = lane & ~free
        for beside, window in (("", sole), ("beside ", np.pad(sole, BESIDE_CELLS, constant_values=1))):
            lost = count_lost(counts, lost, fused, window, beside)
    return counts


def count_lost(counts: Counter[str], lost: Mask, fused: gp.TerrainGrid, sole: Codes, prefix: str = "") -> Mask:
    """Count lost cells by the first of the `causes` that fits; return those of other causes."""
    for name, mask in causes(fused, sole).items():
        counts[f"lost: {prefix}{name}"] += int((lost & mask).sum())
        lost = lost & ~mask
    return lost


@dataclass(frozen=True)
class Soles:
    """Soles on the ground as it was at a time of its own for each cell, (ny, nx) each.

    Attributes:
        safe: by the limits of the robot.
        relief: soles that the oracle rejects, with a relief above DANGEROUS_RELIEF_M.
        dark: soles on ground that absorbs the laser.
    """

    safe: Mask
    relief: Mask
    dark: Mask

    @staticmethod
    def on(
        judged: Sequence[tuple[gp.TerrainGrid, Mask]], states: Index, sole: Codes, limits: TraversabilityLimits
    ) -> Soles:
        """Judge each cell (ny, nx) in its own state of the world, given oracle and dark cells of each state."""

        def of_each(layers: list[Array]) -> Array:
            return np.choose(states, layers)

        low, high, slope = (
            of_each([oracle.layers[name] for oracle, _ in judged])
            for name in ("elevation_min", "elevation_max", "slope")
        )
        dark = cv2.dilate(of_each([dark for _, dark in judged]).astype(np.uint8), sole) > 0
        refused = np.zeros(states.shape, dtype=bool)
        for number, (oracle, _) in enumerate(judged):
            refused |= (oracle.hazard != 0) & (cv2.dilate((states == number).astype(np.uint8), sole) > 0)
        relief = relief_under(low, high, slope, sole, limits)
        return Soles(~refused & ~dark, refused & (relief > DANGEROUS_RELIEF_M), dark)


def sole_window(limits: TraversabilityLimits, resolution: float) -> Codes:
    """Cells that a sole touches."""
    return np.ones([2 * half_cells(v, resolution) + 1 for v in (limits.sole_width, limits.sole_length)], np.uint8)


def relief_under(low: Array, high: Array, slope: Array, sole: Codes, limits: TraversabilityLimits) -> Float:
    """Relief under a sole beyond that of its slope [m], from lowest and highest samples [m] and the slope [rad]."""
    relief = cv2.dilate(high, sole) - cv2.erode(low, sole)
    return np.asarray(relief - np.tan(np.nan_to_num(slope)) * np.hypot(limits.sole_length, limits.sole_width))


def causes(fused: gp.TerrainGrid, sole: Codes) -> dict[str, Mask]:
    """Masks (ny, nx) by cause of what is lost in the map; a cell counts for the first cause that fits."""

    def under_sole(flags: Hazard) -> Mask:
        return cv2.dilate(((fused.hazard & np.uint16(flags)) != 0).astype(np.uint8), sole) > 0

    border = cv2.dilate(np.zeros(fused.shape, np.uint8), sole, borderType=cv2.BORDER_CONSTANT, borderValue=(1,)) > 0
    return {
        "border": border,
        "never scanned": under_sole(Hazard.UNSCANNED | Hazard.SELF),
        "dropouts": under_sole(Hazard.DROPOUT),
        "hidden": under_sole(Hazard.OCCLUDED),
        "other unknown": under_sole(Hazard.AMBIGUOUS | Hazard.OUT_OF_RANGE),
        "conflict, stale, uncertain": under_sole(Hazard.CONFLICT | Hazard.STALE | Hazard.UNCERTAIN),
        "flagged without need": under_sole(Hazard.STEEP | Hazard.STEP | Hazard.DROP | Hazard.ROUGH),
    }
