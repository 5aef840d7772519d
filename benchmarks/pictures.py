"""Walks whose laser-off pictures hold the map: drift aside without and with them, on floors of any texture.

Feet slide back by a share of the way, which no joint shows. Each walk has errors of mount and laser planes and
biases of joints of its own. Drift is measured as in `walks drift`; its normalised error is the mean square by the sigma
that the map claims for it, with its interval of 95 % by bootstrap over walks. Walks in MuJoCo need the extra `physics`,
those of Go2 `robots-test`.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.command import options
from benchmarks.fused_walk import PAUSES_BETWEEN, SEEN_AT, drift_aside
from benchmarks.sigmas import SAMPLES
from guara_perception.app.robot_folder.new_robot import new_robot
from guara_perception.arrays import Float
from kinematics import LegOdometry, RobotModel, load_robot
from testbed.erring_walk import pictured
from testbed.scanned_walk import WalkedPause
from testbed.stock_robots import stock_urdf


@dataclass(frozen=True)
class Held:
    """Figures of a walk.

    Attributes:
        aside: (n, 2) drift while ground comes from the near edge to the hind feet [mm].
        sigmas: (n, 2) sigma that the map claims for it [mm].
        end: error of the pose at the end, x, y [mm] and yaw [mrad].
        refused: reasons for which pictures were not used, by number of pauses.
        unsafe: cells that are unknown and traversable.
        seconds: processor time of the map a pause, median [s].
    """

    aside: Float
    sigmas: Float
    end: Float
    refused: Counter[str]
    unsafe: int
    seconds: float


def held(robot: RobotModel, pauses: list[WalkedPause], *, with_pictures: bool) -> Held:
    """Figures of a walk with its pictures, or as if none had shown anything."""
    terrain_map, odometry = gp.TerrainMap(robot), LegOdometry(robot)
    poses: list[Float] = []
    sigmas: list[Float] = []
    refused: Counter[str] = Counter()
    seconds, unsafe = [], 0
    for pause in pauses:
        pose, begun = odometry.update(pause.stance), time.process_time()
        picture = pause.picture if with_pictures else "it is not used"
        fused = terrain_map.update(pause.scan, pose, known_ground=pause.known_ground, picture=picture)
        seconds.append(time.process_time() - begun)
        unsafe += int((np.isnan(fused.elevation) & (fused.traversability > 0)).sum())
        poses.append(np.array(fused.metadata["transform_footprint_to_odom"]))
        if (reason := fused.metadata.get("visual_refused")) is not None:
            refused[" ".join(word for word in str(reason).split() if not any(map(str.isdigit, word)))] += 1
        if len(poses) > PAUSES_BETWEEN:
            seen = np.full(len(SEEN_AT), terrain_map.pause - PAUSES_BETWEEN)
            x, y = (poses[-1 - PAUSES_BETWEEN] @ SEEN_AT.T)[:2]
            sigmas += list(1e3 * np.sqrt(terrain_map.sideways_drift.variances(seen, x, y, poses[-1]).T))
    truth = np.linalg.inv(pauses[0].to_world) @ pauses[-1].to_world
    off = np.linalg.inv(truth) @ np.linalg.inv(poses[0]) @ poses[-1]
    end = 1e3 * np.array([*off[:2, 3], np.arctan2(off[1, 0], off[0, 0])])
    return Held(drift_aside(pauses, poses), np.array(sigmas), end, refused, unsafe, float(np.median(seconds)))


def normalised(walks: list[Held]) -> str:
    """Mean square error by sigma along x and y, its interval by bootstrap over walks, and the share within 2 sigma."""
    squares = [(each.aside / each.sigmas) ** 2 for each in walks]
    means = np.array([each.mean(axis=0) for each in squares])
    rows = np.random.default_rng(0).integers(len(means), size=(SAMPLES, len(means)))
    low, high = np.quantile(means[rows].mean(axis=1), [0.025, 0.975], axis=0)
    inside = (np.concatenate(squares) < 4).mean(axis=0)
    axes = zip("xy", means.mean(axis=0), low, high, 100 * inside, strict=True)
    return ", ".join(f"{name} {mean:.2f} [{a:.2f} {b:.2f}], {share:.0f} %" for name, mean, a, b, share in axes)


def show(name: str, robot: RobotModel, walks: Iterator[list[WalkedPause]]) -> None:
    """Print a kind of walk without and with pictures."""
    both = [
        (held(robot, each, with_pictures=False), held(robot, each, with_pictures=True), len(each)) for each in walks
    ]
    pauses = sum(count for _, _, count in both)
    for label, found in (("without", [each[0] for each in both]), ("with", [each[1] for each in both])):
        aside, sigmas = np.concatenate([each.aside for each in found]), np.concatenate([each.sigmas for each in found])
        x, y = np.sqrt((aside**2).mean(axis=0))
        end = np.abs([each.end for each in found]).max(axis=0)
        refused = sum((each.refused for each in found), Counter[str]())
        unsafe, milliseconds = sum(each.unsafe for each in found), 1e3 * np.median([each.seconds for each in found])
        print(
            f"{name}, {label:7} pictures: x {x:5.2f} y {y:5.2f} rms, worst {np.abs(aside).max():5.2f} mm; claimed "
            f"{sigmas[:, 0].mean():5.2f} {sigmas[:, 1].mean():5.2f}; normalised, within 2 sigma: {normalised(found)}; "
            f"at the end at most x {end[0]:.1f} y {end[1]:.1f} mm yaw {end[2]:.1f} mrad; {unsafe} cells unsafe; "
            f"{milliseconds:.0f} ms a pause; of {pauses} pauses not held: {dict(refused.most_common()) or 'none'}",
            flush=True,
        )


def main() -> None:
    """Drift with and without laser-off pictures, with feet that slide [--walks, --drawn, --go2, --physics]."""
    asked = options(
        __doc__,
        first=(40, "first seed"),
        walks=(2, "walks of each texture and slide"),
        drawn=(0, "walks that draw their texture and slide"),
        go2=(0, "such walks of Go2"),
        physics=(0, "such walks in MuJoCo"),
        cycles=(8.0, "cycles of each walk"),
    )
    robot, cycles = load_robot("guara"), asked.cycles
    cv2.setNumThreads(1)

    def walks(
        count: int, texture: float | None = None, slide: float | None = None, *, physics: bool = False
    ) -> Iterator[list[WalkedPause]]:
        for seed in range(asked.first, asked.first + count):
            yield list(pictured(robot, seed, cycles, texture, slide, physics=physics))

    kinds = [(1.0, slide) for slide in (0.0, 0.04, 0.08, -0.04)] + [(each, 0.04) for each in (3.0, 0.5, 0.2, 0.0)]
    for texture, slide in kinds if asked.walks else []:
        show(f"texture {texture:g}, slide {100 * slide:+.0f} %", robot, walks(asked.walks, texture, slide))
    if asked.drawn:
        show("drawn", robot, walks(asked.drawn))
    if asked.physics:
        show("physics", robot, walks(asked.physics, physics=True))
    if asked.go2:
        with TemporaryDirectory() as folder:
            new_robot(stock_urdf("go2"), Path(folder) / "go2")
            robot = load_robot(Path(folder) / "go2")
            show("Go2, drawn", robot, walks(asked.go2))
