"""Walks whose laser-off pictures hold the map: drift aside without and with them, on floors of any texture.

Feet slide back by a share of the way, which no joint shows. Each walk has errors of mount and laser planes and
biases of joints of its own. Drift is measured as in `walks drift`; its normalised error is the mean square by the sigma
that the map claims for it, with its interval of 95 % by bootstrap over walks. Walks in MuJoCo need the extra `physics`,
those of Go2 `robots-test`. With --floors the same walks in MuJoCo see floors of five textures.
"""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.command import Table, options
from benchmarks.fused_walk import PAUSES_BETWEEN, PAUSES_TO_FORE, SEEN_AT, bootstrap, drift_aside
from guara_perception.arrays import Float
from guara_perception.terrain.map.walk_correction import SidewaysDrift
from kinematics import LegOdometry, RobotModel, load_robot
from testbed.erring_walk import CRAWLS, pictured
from testbed.physics.robot import go2
from testbed.scanned_walk import WalkedPause

# Pauses until feet come to ground seen at the near edge; textures and slides of walks; textures of floors.
FEET = {"fore": PAUSES_TO_FORE, "hind": PAUSES_BETWEEN}
KINDS = (
    *((1.0, slide) for slide in (0.0, 0.04, 0.08, -0.04)),
    *((texture, 0.04) for texture in (3.0, 0.5, 0.2, 0.0)),
)
FLOORS = (3.0, 1.0, 0.5, 0.2, 0.0)


@dataclass(frozen=True)
class Held:
    """Figures of a walk.

    Attributes:
        pauses: number of them.
        drift: by `FEET`, (n, 3) drift while ground comes from the near edge to them: x, y [mm], yaw [mrad].
        sigmas: (n, 3) sigmas that the map claims for it.
        end: error of the pose at the end, x, y [mm] and yaw [mrad].
        refused: reasons for which pictures were not used, by number of pauses.
        unsafe: cells that are unknown and traversable.
        seconds: processor time of the map a pause, median [s].
    """

    pauses: int
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
    return Held(len(pauses), drift, claims, end, refused, unsafe, float(np.median(seconds)))


def claimed(drift: SidewaysDrift, pause: int, poses: list[Float], between: int) -> list[Float]:
    """Sigmas that a map claims for the drift of `SEEN_AT` since a pause: x, y [mm], yaw [mrad]."""
    x, y = (poses[-1 - between] @ SEEN_AT.T)[:2]
    sideways = drift.variances(np.full(len(SEEN_AT), pause), x, y, poses[-1])
    first = int(np.searchsorted(drift.pauses, pause))
    yaw = (drift.total[-1] - drift.total[first] + drift.own[first] + drift.own[-1])[2, 2]
    return list(1e3 * np.sqrt(np.vstack((sideways, np.full(len(SEEN_AT), yaw)))).T)


def normalised(walks: Sequence[Held], feet: str) -> str:
    """Mean square error by sigma, its interval by bootstrap over walks, and the share within 2 sigma, by axis."""
    squares = [(each.drift[feet] / each.sigmas[feet]) ** 2 for each in walks]
    means = np.array([each.mean(axis=0) for each in squares])
    low, high = bootstrap(means, lambda some: some.mean(axis=0))
    inside = (np.concatenate(squares) < 4).mean(axis=0)
    axes = zip("x y yaw".split(), means.mean(axis=0), low, high, 100 * inside, strict=True)
    return ", ".join(f"{name} {mean:.2f} [{a:.2f} {b:.2f}] {share:.0f} %" for name, mean, a, b, share in axes)


def print_rows(table: Table, name: str, found: Sequence[Held]) -> None:
    """Print a row for fore and for hind feet."""
    end = np.abs([each.end for each in found]).max(axis=0)
    refused = sum((each.refused for each in found), Counter[str]())
    unsafe, milliseconds = sum(each.unsafe for each in found), 1e3 * np.median([each.seconds for each in found])
    of_walk = triple(end), unsafe, milliseconds, ", ".join(f"{n} {why}" for why, n in refused.most_common()) or "none"
    for feet in FEET:
        drift = np.concatenate([each.drift[feet] for each in found])
        sigmas = np.concatenate([each.sigmas[feet] for each in found])
        errors = np.sqrt((drift**2).mean(axis=0)), np.abs(drift).max(axis=0), sigmas.mean(axis=0)
        table.row(
            name, feet, sum(each.pauses for each in found), *map(triple, errors), normalised(found, feet), *of_walk
        )


def triple(values: Float) -> str:
    """Values of x, y and yaw."""
    return " ".join(f"{value:6.2f}" for value in values)


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
    print("x and y [mm], yaw [mrad]; normalised: mean square by sigma, its interval, share within 2 sigma")
    table = Table(
        "walks:<40 | feet:<4 | pauses:d | rms:<20 | worst:<20 | claimed:<20 | normalised:<70 | "
        "at the end at most:<20 | unsafe:d | ms:.0f | pauses not held:<"
    )

    def walks(robot: RobotModel, count: int, *kind: float, **how: Any) -> Iterator[list[WalkedPause]]:
        """Walks with a texture and a slide, or that draw them."""
        for seed in range(asked.first, asked.first + count):
            yield list(pictured(robot, seed, cycles, *(kind or (None, None)), **how))

    def show(name: str, robot: RobotModel, found: Iterator[list[WalkedPause]]) -> None:
        """Print walks without and with their pictures."""
        both = [[held(robot, each, with_pictures=used) for used in (False, True)] for each in found]
        for label, of_label in zip(("without", "with"), zip(*both, strict=True), strict=False):
            print_rows(table, f"{name}, {label} pictures", of_label)

    for texture, slide in KINDS:
        show(f"texture {texture:g}, slide {100 * slide:+.0f} %", guara, walks(guara, asked.walks, texture, slide))
    show("drawn", guara, walks(guara, asked.drawn))
    if asked.go2:
        show("Go2, drawn", go2(), walks(go2(), asked.go2))
    for robot, crawl in itertools.product((guara, go2()) if asked.physics or asked.floors else (), CRAWLS):
        name = f"{robot.name}, {crawl}"
        show(name, robot, walks(robot, asked.physics, crawl=crawl))
        found = list(walks(robot, asked.floors, 1.0, 0.0, crawl=crawl, floors=FLOORS))
        if found:
            slips = 1e3 * np.array([slip for each in found for pause in each for slip in pause.slips])
            print_rows(table, f"{name}, no picture", [held(robot, each, with_pictures=False) for each in found])
        for number, texture in enumerate(FLOORS if found else ()):
            on_floor = [[replace(pause, picture=pause.floors[number]) for pause in each] for each in found]
            print_rows(
                table, f"{name}, texture {texture:g}", [held(robot, each, with_pictures=True) for each in on_floor]
            )
        if found:
            print(
                f"  a standing foot slid by {slips.mean():.2f} mm a pause, 95 % by at most "
                f"{np.quantile(slips, 0.95):.2f}, worst {slips.max():.2f}",
                flush=True,
            )
