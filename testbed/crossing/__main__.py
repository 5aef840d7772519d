"""Simulate a crossing and draw it from above: `python -m testbed.crossing KIND SEED ARM -o PICTURE`."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from guara_perception.app.demo.pictures import CourseDrawing
from guara_perception.settings import Settings
from guara_perception.simulation.footing import CELL_M
from guara_perception.terrain.drawing.style import save_figure, styled
from testbed.crossing.courses import KINDS, SIZES, START_M, course
from testbed.crossing.eyes import Sight
from testbed.crossing.walk import ARMS, Crossing, cross
from testbed.physics.guara import ROBOTS
from testbed.physics.robot import LEGS, Robot


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m testbed.crossing", description=__doc__)
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("seed", type=int)
    parser.add_argument("arm", choices=ARMS)
    parser.add_argument("--robot", choices=ROBOTS, default="go2", help="robot that walks")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="PICTURE", help="file to write (.png)")
    given = parser.parse_args()
    ground = course(given.kind, given.seed, SIZES[given.robot])
    drawing = CourseDrawing(ground.world, START_M, ground.goal)

    def add(done: Crossing, robot: Robot, sight: Sight) -> None:
        """Add a step to the drawing; called by `cross` after each swing."""
        x, y, _ = np.moveaxis((drawing.cells - sight.to_world[:3, 3]) @ sight.to_world[:3, :3], -1, 0)
        known = sight.ground
        i, j = known.indices(x, y)
        inside = (np.abs(known.x[i] - x) <= CELL_M) & (np.abs(known.y[j] - y) <= CELL_M)
        # Ground behind the map keeps the state that it had when it was last in the map.
        inside &= drawing.cells[..., 0] > robot.base[0] + Settings.of(robot.product).map_x[0] + CELL_M
        drawing.know(inside, known.safe[i, j], np.isnan(known.heights[i, j]))
        leg = done.trace[-1][0]
        drawing.step(leg, robot.feet[LEGS.index(leg)], robot.base)

    with styled():
        done = cross(given.kind, given.seed, given.arm, add, robot=given.robot)
        title = f"{done.course}, {done.arm.replace('_', '-')}: {done.result} in {done.steps} steps"
        save_figure(drawing.figure(title), given.out)


if __name__ == "__main__":
    main()
