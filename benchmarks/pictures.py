"""Walks whose laser-off pictures hold the map: drift aside without and with them, on floors of any texture.

Feet slide back by a share of the way, which no joint shows. Each walk has errors of mount and laser planes and
biases of joints of its own. Drift is measured as in `walks drift`; its normalised error is the mean square by the sigma
that the map claims for it, with its interval of 95 % by bootstrap over walks. Walks in MuJoCo need the extra `physics`,
those of Go2 `robots-test`. With --floors the same walks in MuJoCo see floors of five textures.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.command import options
from benchmarks.fused_walk import PAUSES_BETWEEN, PAUSES_TO_FORE, SEEN_AT, drift_aside
from benchmarks.sigmas import SAMPLES
from guara_perception.arrays import Float
from guara_perception.terrain.map.walk_correction import SidewaysDrift
from kinematics import LegOdometry, RobotModel, load_robot
from testbed.erring_walk import CRAWLS, pictured
from testbed.physics.robot import go2
from testbed.scanned_walk import WalkedPause

# Pauses until feet come to ground seen at the near edge, axes of the drift, and textures of floors.
FEET = {"fore": PAUSES_TO_FORE, "hind": PAUSES_BETWEEN}
AXES = ("x", "y", "yaw")
FLOORS = (3.0, 1.0, 0.5, 0.2, 0.0)


@dataclass(frozen=True)
class Held:
    """Figures of a walk.

    Attributes:
        drift: by `FEET`, (n, 3) drift while ground comes from the near edge to them: x, y [mm], yaw [mrad].
        sigmas: (n, 3) sigmas that the map claims for it.
        end: error of the pose at the end, x, y [mm] and yaw [mrad].
        refused: reasons for which pictures were not used, by number of pauses.
        unsafe: cells that are unknown and traversable.
        seconds: processor time of the map a pause, median [s].
    """

    drift: dict[str, Float]
    sigmas: dict[str, Float]
    end: Float
    refused: Counter[str]
    unsafe: int
    seconds: float


def held(robot: RobotModel, pauses: list[WalkedPause], *, with_pictures: bool) -> Held:
    """Figures of a walk with its pictures, or as if none had shown anything."""
    terrain_map, odometry = gp.TerrainMap(robot), LegOdometry(robot)
    poses: list[Float] = []
    sigmas: dict[str, list[Float]] = {feet: [] for feet in FEET}
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
        for feet, between in FEET.items():
            if len(poses) > between:
                sigmas[feet] += claimed(terrain_map.sideways_drift, terrain_map.pause - between, poses, between)
    truth = np.linalg.inv(pauses[0].to_world) @ pauses[-1].to_world
    off = np.linalg.inv(truth) @ np.linalg.inv(poses[0]) @ poses[-1]
    end = 1e3 * np.array([*off[:2, 3], np.arctan2(off[1, 0], off[0, 0])])
    drift = {feet: drift_aside(pauses, poses, between) for feet, between in FEET.items()}
    claims = {feet: np.array(each) for feet, each in sigmas.items()}
    return Held(drift, claims, end, refused, unsafe, float(np.median(seconds)))


def claimed(drift: SidewaysDrift, pause: int, poses: list[Float], between: int) -> list[Float]:
    """Sigmas that a map claims for the drift of `SEEN_AT` since a pause: x, y [mm], yaw [mrad]."""
    x, y = (poses[-1 - between] @ SEEN_AT.T)[:2]
    sideways = drift.variances(np.full(len(SEEN_AT), pause), x, y, poses[-1])
    first = int(np.searchsorted(drift.pauses, pause))
    yaw = (drift.total[-1] - drift.total[first] + drift.own[first] + drift.own[-1])[2, 2]
    return list(1e3 * np.sqrt(np.vstack((sideways, np.full(len(SEEN_AT), yaw)))).T)


def normalised(walks: list[Held], feet: str) -> str:
    """Mean square error by sigma, its interval by bootstrap over walks, and the share within 2 sigma, by axis."""
    squares = [(each.drift[feet] / each.sigmas[feet]) ** 2 for each in walks]
    means = np.array([each.mean(axis=0) for each in squares])
    rows = np.random.default_rng(0).integers(len(means), size=(SAMPLES, len(means)))
    low, high = np.quantile(means[rows].mean(axis=1), [0.025, 0.975], axis=0)
    inside = (np.concatenate(squares) < 4).mean(axis=0)
    axes = zip(AXES, means.mean(axis=0), low, high, 100 * inside, strict=True)
    return ", ".join(f"{name} {mean:.2f} [{a:.2f} {b:.2f}], {share:.0f} %" for name, mean, a, b, share in axes)


def show(name: str, robot: RobotModel, walks: Iterator[list[WalkedPause]]) -> None:
    """Print a kind of walk without and with pictures."""
    both = [
        (held(robot, each, with_pictures=False), held(robot, each, with_pictures=True), len(each)) for each in walks
    ]
    pauses = sum(count for _, _, count in both)
    for label, found in (("without", [each[0] for each in both]), ("with", [each[1] for each in both])):
        tell(f"{name}, {label:7} pictures", found, pauses)


def show_floors(name: str, robot: RobotModel, walks: list[list[WalkedPause]]) -> None:
    """Print walks without pictures, and with those of each of the `FLOORS`."""
    pauses, slips = (
        sum(map(len, walks)),
        1e3 * np.array([slip for walk in walks for each in walk for slip in each.slips]),
    )
    print(
        f"{name}: {len(walks)} walks of {pauses} pauses; a standing foot slid by {slips.mean():.2f} mm a pause, "
        f"95 % by at most {np.quantile(slips, 0.95):.2f}, worst {slips.max():.2f}",
        flush=True,
    )
    tell(f"{name}, no picture", [held(robot, walk, with_pictures=False) for walk in walks], pauses)
    for number, texture in enumerate(FLOORS):
        on_floor = [[replace(each, picture=each.floors[number]) for each in walk] for walk in walks]
        tell(f"{name}, texture {texture:g}", [held(robot, walk, with_pictures=True) for walk in on_floor], pauses)


def tell(name: str, found: list[Held], pauses: int) -> None:
    """Print figures of walks."""
    for feet in FEET:
        drift, sigmas = (np.concatenate([each[feet] for each in part]) for part in _parts(found))
        rms, worst, mean = np.sqrt((drift**2).mean(axis=0)), np.abs(drift).max(axis=0), sigmas.mean(axis=0)
        print(
            f"{name}, {feet} feet: x y {rms[0]:.2f} {rms[1]:.2f} mm, yaw {rms[2]:.2f} mrad rms, worst {worst[0]:.2f} "
            f"{worst[1]:.2f} mm {worst[2]:.2f} mrad; claimed {mean[0]:.2f} {mean[1]:.2f} {mean[2]:.2f}; normalised, "
            f"within 2 sigma: {normalised(found, feet)}"
        )
    end = np.abs([each.end for each in found]).max(axis=0)
    refused = sum((each.refused for each in found), Counter[str]())
    unsafe, milliseconds = sum(each.unsafe for each in found), 1e3 * np.median([each.seconds for each in found])
    print(
        f"    at the end at most x {end[0]:.1f} y {end[1]:.1f} mm yaw {end[2]:.1f} mrad; {unsafe} cells unsafe; "
        f"{milliseconds:.0f} ms a pause; of {pauses} pauses not held: {dict(refused.most_common()) or 'none'}",
        flush=True,
    )


def _parts(found: list[Held]) -> tuple[list[dict[str, Float]], list[dict[str, Float]]]:
    return [each.drift for each in found], [each.sigmas for each in found]


def main() -> None:
    """Drift with and without laser-off pictures, feet that slide [--walks, --drawn, --go2, --physics, --floors]."""
    asked = options(
        __doc__,
        first=(40, "first seed"),
        walks=(2, "walks of each texture and slide"),
        drawn=(0, "walks that draw their texture and slide"),
        go2=(0, "such walks of Go2"),
        physics=(0, "such walks in MuJoCo of each robot, by forces and by position servos"),
        floors=(0, "walks in MuJoCo of each robot and crawl, each over five floors from rich texture to none"),
        cycles=(8.0, "cycles of each walk"),
    )
    guara, cycles = load_robot("guara"), asked.cycles
    cv2.setNumThreads(1)

    def seeds(count: int) -> range:
        return range(asked.first, asked.first + count)

    def walks(
        robot: RobotModel,
        count: int,
        texture: float | None = None,
        slide: float | None = None,
        *,
        crawl: str | None = None,
        floors: Sequence[float] = (),
    ) -> Iterator[list[WalkedPause]]:
        for seed in seeds(count):
            yield list(pictured(robot, seed, cycles, texture, slide, crawl=crawl, floors=floors))

    kinds = [(1.0, slide) for slide in (0.0, 0.04, 0.08, -0.04)] + [(each, 0.04) for each in (3.0, 0.5, 0.2, 0.0)]
    for texture, slide in kinds if asked.walks else []:
        show(f"texture {texture:g}, slide {100 * slide:+.0f} %", guara, walks(guara, asked.walks, texture, slide))
    if asked.drawn:
        show("drawn", guara, walks(guara, asked.drawn))
    if asked.go2:
        show("Go2, drawn", go2(), walks(go2(), asked.go2))
    for crawl in CRAWLS:
        for robot in (guara, go2()) if asked.physics else ():
            show(f"{robot.name}, {crawl}", robot, walks(robot, asked.physics, crawl=crawl))
        for robot in (guara, go2()) if asked.floors else ():
            found = list(walks(robot, asked.floors, 1.0, 0.0, crawl=crawl, floors=FLOORS))
            show_floors(f"{robot.name}, {crawl}", robot, found)
