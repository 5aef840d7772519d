"""Walks over ground of which parts move: drift of the map, cells that are wrongly free, bounds that are exceeded."""

from __future__ import annotations

import numpy as np

import guara_perception as gp
from benchmarks.command import Table, options
from benchmarks.fused_walk import drift_aside, fused_pauses, rms
from guara_perception.arrays import Float, Float32
from kinematics import RobotModel, load_robot
from kinematics.transforms import transform_points
from testbed.analytic_walk import seen_height
from testbed.moving_ground import WORLDS, MovingPause, pauses_of

# Distance of a free cell's height from the ground above which the cell counts as wrong.
WRONG_M = 0.015
EXCEEDED_M = 0.017
# Bounds are compared only at every BOUNDS_EVERY-th pause, because this takes most of the time.
BOUNDS_EVERY = 4


def figures(robot: RobotModel, pauses: list[MovingPause], *, registered: bool) -> dict[str, float]:
    """Drift by axis and the map's sigma of y, rms [mm], and numbers of cells, with or without registration."""
    terrain_map = gp.TerrainMap(robot)
    poses: list[Float] = []
    sigmas: list[float] = []
    unsafe = exceeded = refused = conflicts = 0
    for pause, fused in fused_pauses(terrain_map, robot, pauses, registered=registered):
        record = fused.record
        assert isinstance(record, gp.MapRecord)
        assert record.transform_footprint_to_odom is not None and record.sideways_correction_sigma is not None
        poses.append(record.transform_footprint_to_odom)
        sigmas.append(record.sideways_correction_sigma[1])
        refused += registered and record.registration_refused is not None
        conflicts += int(((fused.hazard & np.uint16(gp.Hazard.CONFLICT)) != 0).sum())
        unsafe += wrongly_free(fused, pause)
        if pause.scan.step % BOUNDS_EVERY == 0:
            exceeded += broken_bounds(fused.ceiling, fused, pause)
    x, y, _ = map(rms, drift_aside(pauses, poses).T)
    counts = {"unsafe": unsafe, "exceeded": exceeded, "refused": refused, "conflicts": conflicts}
    return {"x": x, "y": y, "claimed": 1e3 * rms(sigmas), **counts}


def wrongly_free(fused: gp.TerrainGrid, pause: MovingPause) -> int:
    """Number of free cells whose ground was dark, higher or lower when they were last seen."""
    iy, ix = np.nonzero(fused.hazard == 0)
    x, y = (axis[index] for axis, index in zip(fused.geometry.centres(), (ix, iy), strict=True))
    ages, count = fused.layers["age"][iy, ix], 0
    for age in np.unique(ages):
        seen = ages == age
        ground = pause.ground.at(max(pause.scan.step - int(age), 0))
        true, world = seen_height(ground, pause.to_world, x[seen], y[seen])
        wrong = np.abs(true - fused.elevation[iy, ix][seen]) > WRONG_M
        count += int((wrong | ground.is_dark(world[:, 0], world[:, 1])).sum())
    return count


def broken_bounds(ceiling: Float32, fused: gp.TerrainGrid, pause: MovingPause) -> int:
    """Number of bounds that lie lower than the ground ever was there by more than EXCEEDED_M."""
    iy, ix = np.nonzero(np.isfinite(ceiling))
    x, y = (axis[index] for axis, index in zip(fused.geometry.centres(), (ix, iy), strict=True))
    bound = np.asarray(ceiling[iy, ix], np.float64)
    world = transform_points(pause.to_world, np.column_stack((x, y, bound)))
    lowest = pause.ground.lowest_at(world[:, 0], world[:, 1])
    return int((lowest > world[:, 2] + EXCEEDED_M).sum())


def main() -> None:
    """Drift, wrongly free cells and bounds where parts of the ground move [--first, --walks, --cycles, --world]."""
    asked = options(
        __doc__,
        first=(0, "first seed"),
        walks=(1, "walks over each world"),
        cycles=(9, "cycles of each walk"),
        pictures=(False, "laser-off pictures hold the map"),
        world=([*WORLDS], "names of worlds", {"choices": tuple(WORLDS)}),
    )
    robot = load_robot("guara")
    print("each without registration -> with it; x, y and claimed sigma of y: rms [mm]")
    table = Table("world:<24 | x:>12 | y:>12 | claimed:>12 | unsafe:>12 | bounds over:>12 | unused:8d | conflicts:d")
    for name in asked.world:
        for seed in range(asked.first, asked.first + asked.walks):
            pauses = list(pauses_of(robot, name, seed, asked.cycles, pictures=asked.pictures))
            off, on = (figures(robot, pauses, registered=registered) for registered in (False, True))
            pairs = (
                *(f"{off[key]:.1f} -> {on[key]:.1f}" for key in ("x", "y", "claimed")),
                *(f"{off[key]} -> {on[key]}" for key in ("unsafe", "exceeded")),
            )
            table.row(name, *pairs, on["refused"], on["conflicts"])
