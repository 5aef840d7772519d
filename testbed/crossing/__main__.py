"""Draw a crossing from above: `python -m testbed.crossing KIND SEED ARM -o PICTURE`."""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib as mpl
import numpy as np

from guara_perception.arrays import Float
from testbed.crossing.courses import KINDS, START_M, course
from testbed.crossing.eyes import Sight
from testbed.crossing.ground import CELL_M
from testbed.crossing.robot import LEGS, Robot
from testbed.crossing.walk import ARMS, Crossing, cross

COLOURS = dict(zip(LEGS, ("tab:blue", "tab:orange", "tab:cyan", "tab:red"), strict=True))
BEFORE_M, BEYOND_M, ASIDE_M = 0.45, 0.55, 0.30
UNKNOWN, REFUSED, FREE = 0, 1, 2


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m testbed.crossing", description=__doc__)
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("seed", type=int)
    parser.add_argument("arm", choices=ARMS)
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="PICTURE", help="file to write (.png)")
    given = parser.parse_args()
    drawing = Drawing(given.kind, given.seed)
    done = cross(given.kind, given.seed, given.arm, drawing.add)
    drawing.save(given.out, f"{done.course}, {done.arm.replace('_', '-')}: {done.result} in {done.steps} steps")


class Drawing:
    """The true ground, what the robot knew of it when it was last near, its feet and its body."""

    def __init__(self, kind: str, seed: int) -> None:
        """Begin with the true ground of a course."""
        self._course = course(kind, seed)
        self._x = np.arange(START_M - BEFORE_M, self._course.goal + BEYOND_M, CELL_M)
        self._y = np.arange(-ASIDE_M, ASIDE_M, CELL_M)
        self._x_grid, self._y_grid = np.meshgrid(self._x, self._y)
        self._known = np.full(self._x_grid.shape, UNKNOWN)
        self._feet: list[tuple[str, float, float]] = []
        self._bodies: list[Float] = []

    def add(self, done: Crossing, robot: Robot, sight: Sight) -> None:
        """See `cross`: a step was made."""
        points = np.stack([self._x_grid, self._y_grid, np.zeros(self._x_grid.shape)], axis=-1)
        x, y, _ = np.moveaxis((points - sight.to_world[:3, 3]) @ sight.to_world[:3, :3], -1, 0)
        known = sight.ground
        i, j = known.indices(x, y)
        inside = (np.abs(known.x[i] - x) <= CELL_M) & (np.abs(known.y[j] - y) <= CELL_M)
        now = np.where(known.safe[i, j], FREE, np.where(np.isnan(known.heights[i, j]), UNKNOWN, REFUSED))
        self._known = np.where(inside, now, self._known)
        leg = done.trace[-1][0]
        self._feet.append((leg, *robot.feet[LEGS.index(leg), :2].tolist()))
        self._bodies.append(robot.base)

    def save(self, path: Path, title: str) -> None:
        """Write the picture: x to the right, y upwards."""
        mpl.use("Agg")
        from matplotlib import pyplot as plt

        figure, axes = plt.subplots(figsize=(10, 3.9), layout="constrained")
        extent = (self._x[0], self._x[-1], self._y[0], self._y[-1])
        colours = mpl.colors.ListedColormap(["0.72", "#f2b79b", "#bfe3b4"])
        axes.imshow(self._known, origin="lower", extent=extent, cmap=colours, vmin=UNKNOWN, vmax=FREE)
        heights = self._course.world.height(self._x_grid, self._y_grid)
        rims = np.hypot(*np.gradient(heights)) > CELL_M
        axes.contour(self._x, self._y, rims, levels=[0.5], colors="black", linewidths=0.8)
        axes.plot(*np.array(self._bodies)[:, :2].T, color="0.3", linewidth=0.8, linestyle=":")
        for leg in LEGS:
            places = np.array([(x, y) for name, x, y in self._feet if name == leg]).reshape(-1, 2)
            axes.plot(*places.T, "o", color=COLOURS[leg], markersize=7, markeredgecolor="white", label=leg)
        axes.set(title=title, xlabel="x [m]", ylabel="y [m]", xlim=extent[:2], ylim=extent[2:])
        patches = [mpl.patches.Patch(color=colours(n), label=t) for n, t in enumerate(("unknown", "refused", "free"))]
        handles, labels = axes.get_legend_handles_labels()
        axes.legend(
            [*handles, *patches], [*labels, "unknown", "refused", "free"], ncols=7, loc="lower center", fontsize=8
        )
        figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
