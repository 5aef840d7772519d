"""Detection of soft and sliding ground by the feet, and false alarms on hard ground.

`python -m benchmarks walks soft [--walks 5 --imu no]`. Guará walks over boxes, ramps and rough ground, with an IMU and
without; joints and IMU have the noise stated in robot.toml, new in each pause. On a patch of 0.4 m across its way feet
sink, or the left ones slide outwards once a cycle, by as much as the row says.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

import guara_perception as gp
from benchmarks.command import Table, options
from guara_perception.arrays import Float
from kinematics import LegOdometry, RobotModel, load_robot
from testbed.analytic_walk import CompliantGround, Ground, Pause, free_soft_cells, scan, walk

PATCH = (1.0, 1.4)
# How feet sink, and how they slide [m].
CASES_M = ((0.0, 0.0), *((depth, 0.0) for depth in (0.008, 0.012, 0.020, 0.030)), (0.0, 0.033), (0.0, 0.050))
CYCLES = 10


def add_walk(
    counts: Counter[str], heights: list[float], ground: Ground, robot: RobotModel, seed: int, *, has_imu: bool
) -> None:
    """Count what is reported on one walk.

    Args:
        counts: pauses; false alarms, pauses at which a foot was said to have sunk or slid on hard ground; landings,
            soles on the patch that could be compared with the map, or that slid; found, those of them that were
            reported; free cells of the patch within reach of a foot that was said to have sunk there.
        heights: heights of landing feet on hard ground against the map [m], appended to.
        ground: ground of the walk.
        robot: the robot.
        seed: seed of the walk.
        has_imu: True for stances with gravity.
    """
    terrain_map, odometry, sank = gp.TerrainMap(robot), LegOdometry(robot), list[Float]()
    last: Pause | None = None
    for pause in walk(robot, ground, CYCLES, seed, has_gravity=has_imu):
        terrain = scan(robot, ground, pause, seed, odometry.carried_gravity(pause.stance))
        pose = odometry.update(pause.stance)
        fused = terrain_map.update(terrain, pose)
        record = fused.record
        assert isinstance(record, gp.MapRecord) and record.support_residuals is not None
        told = {*(record.sunk_feet or {}), *(record.slid_feet or {})}
        slid = () if last is None else _slid(ground, last, pause.step)
        bad = {leg: leg in slid or ground.sink(*pause.soles_in_world[leg][:2].tolist()) > 0 for leg in robot.legs}
        for leg, height in record.support_residuals.items():
            if bad[leg] and (height is not None or leg in slid):
                counts.update(landings=1, found=leg in told)
            if height is not None and not bad[leg] and leg not in pose.stayed_feet:
                heights.append(height)
        sank += [pause.soles_in_world[leg] for leg in told if bad[leg]]
        free = free_soft_cells(ground, pause.transform_base_to_world, fused, sank)
        counts.update(pauses=1, alarms=any(not bad[leg] for leg in told), free=free)
        last = pause


def _slid(ground: Ground, last: Pause, step: int) -> tuple[str, ...]:
    """Feet that stood at the last pause, and slid since."""
    feet = {leg: sole for leg, sole in last.soles_in_world.items() if leg != last.next_leg}
    return tuple(leg for leg, sole in feet.items() if ground.carried(step, sole) is not sole)


def soft() -> None:
    """Feet that sink or slide: false alarms and detected feet, with an IMU and without [--walks, --imu]."""
    asked = options(__doc__, walks=(5, "walks of a row"), imu=(["yes", "no"], "with an IMU, without"))
    robot = load_robot("guara")
    table = Table(
        "IMU:<3 | sinks by [mm]:.0f | slides by [mm]:.0f | pauses:d | false alarms:d | feet on it:d | found:.0% | "
        "free cells of it:d | bias [mm]:.2f | sigma [mm]:.2f"
    )
    for imu in asked.imu:
        for depth, slide in CASES_M:
            counts, heights = Counter[str](), list[float]()
            for seed in range(asked.walks):
                base = Ground.random(seed)
                ground = CompliantGround(base.boxes, base.dark, base.phases, soft=PATCH, depth=depth, slide=slide)
                try:
                    add_walk(counts, heights, ground if depth or slide else base, robot, seed, has_imu=imu == "yes")
                except gp.InvalidInput as error:
                    print(f"walk {seed} ends: {error}")
            found = counts["found"] / max(counts["landings"], 1)
            numbers = counts["pauses"], counts["alarms"], counts["landings"], found, counts["free"]
            table.row(imu, 1e3 * depth, 1e3 * slide, *numbers, 1e3 * np.mean(heights), 1e3 * np.std(heights))
