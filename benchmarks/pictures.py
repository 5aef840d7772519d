"""Walks whose laser-off pictures hold the map: drift aside without and with them, on floors of any texture.

Feet slide back by a share of the way, which no joint shows. Drift is measured as in `walks drift`; its normalised error
is the mean square by the sigma that the map claims for it. Walks in MuJoCo need the extra `physics`.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.command import options
from benchmarks.scanned_walk import PAUSES_BETWEEN, SEEN_AT, WalkedPause, drift_aside
from guara_perception.arrays import Float
from guara_perception.ground_picture import GroundPicture
from guara_perception.settings import Settings
from guara_perception.simulation import SimulatedRangefinder, World, specimen
from guara_perception.simulation.light import Light
from guara_perception.simulation.walk import WalkNoise, WalkPause, simulate_walk
from kinematics import LegOdometry, RobotModel, load_robot
from testbed.random_world import random_world


@dataclass(frozen=True)
class PicturedPause(WalkedPause):
    """One pause with the laser-off picture of its scan, or the reason why there is none."""

    picture: GroundPicture | str = ""


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


def pictured(robot: RobotModel, seed: int, cycles: int, texture: float, slide: float | None) -> Iterator[PicturedPause]:
    """A walk through simulated frames; slide None: in MuJoCo, where contacts decide what slides."""
    if slide is None:
        world = random_world(seed, boxes=7, rocks=0, pits=0, dark=0, undulation=0.0, box_heights=(0.01, 0.04))
    else:
        world = random_world(seed)
    calibration = specimen(robot, (640, 512), seed)
    rangefinder = SimulatedRangefinder(world, calibration, robot, seed, light=Light(texture=texture))
    for pause in _walk(robot, world, seed, cycles, slide):
        rangefinder.set_pose(pause.transform_base_to_world, pause.joint_positions)
        processor, off = gp.ScanProcessor(calibration, robot, pause.stance, "coarse", step=pause.step), None
        for index in Settings.of(robot).pattern("coarse"):
            off = rangefinder.frame(laser=0.0) if off is None else off
            processor.add(index, rangefinder.frame(mirror_angle=calibration.stripe(index).mirror_angle), off)
        scan = processor.finish("wide")
        footprint = np.linalg.inv(np.array(scan.metadata["transform_base_to_footprint"]))
        to_world, known = pause.transform_base_to_world @ footprint, pause.known_ground
        yield PicturedPause(pause.stance, scan, to_world, None, known, picture=processor.ground_picture)


def _walk(robot: RobotModel, world: World, seed: int, cycles: int, slide: float | None) -> Iterator[WalkPause]:
    if slide is not None:
        return simulate_walk(world, robot, cycles=cycles, seed=seed, noise=WalkNoise(slide=slide))
    from testbed.physics.physics_walk import physics_walk

    return physics_walk(world, robot, cycles=cycles, seed=seed, noise=WalkNoise())


def held(robot: RobotModel, pauses: list[PicturedPause], *, with_pictures: bool) -> Held:
    """Figures of a walk with or without its pictures."""
    terrain_map, odometry = gp.TerrainMap(robot), LegOdometry(robot)
    poses: list[Float] = []
    sigmas: list[Float] = []
    refused: Counter[str] = Counter()
    seconds, unsafe = [], 0
    for pause in pauses:
        pose, begun = odometry.update(pause.stance), time.process_time()
        picture = pause.picture if with_pictures else None
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


def show(name: str, robot: RobotModel, walks: list[list[PicturedPause]]) -> None:
    """Print a kind of walk without and with pictures."""
    for label, with_pictures in (("without", False), ("with", True)):
        found = [held(robot, pauses, with_pictures=with_pictures) for pauses in walks]
        aside, sigmas = np.concatenate([each.aside for each in found]), np.concatenate([each.sigmas for each in found])
        x, y = np.sqrt((aside**2).mean(axis=0))
        by_sigma = ((aside / sigmas) ** 2).mean(axis=0)
        end = np.abs([each.end for each in found]).max(axis=0)
        refused = sum((each.refused for each in found), Counter[str]())
        unsafe, milliseconds = sum(each.unsafe for each in found), 1e3 * np.median([each.seconds for each in found])
        print(
            f"{name}, {label:7} pictures: x {x:5.2f} y {y:5.2f} rms, worst {np.abs(aside).max():5.2f} mm; claimed "
            f"{sigmas[:, 0].mean():5.2f} {sigmas[:, 1].mean():5.2f}, normalised {by_sigma[0]:.2f} {by_sigma[1]:.2f}; "
            f"at the end at most x {end[0]:.1f} y {end[1]:.1f} mm yaw {end[2]:.1f} mrad; {unsafe} cells unsafe; "
            f"{milliseconds:.0f} ms a pause; of {sum(map(len, walks))} pauses not held: "
            f"{dict(refused.most_common()) or 'none'}",
            flush=True,
        )


def main() -> None:
    """Drift with and without laser-off pictures, with feet that slide, rich to no texture [--walks, --physics]."""
    asked = options(
        __doc__,
        first=(40, "first seed"),
        walks=(2, "walks of each kind"),
        physics=(0, "walks in MuJoCo"),
        cycles=(8, "cycles of each walk"),
    )
    robot, seeds = load_robot("guara"), range(asked.first, asked.first + asked.walks)
    cv2.setNumThreads(1)
    kinds = [(1.0, slide) for slide in (0.0, 0.04, 0.08, -0.04)] + [(each, 0.04) for each in (3.0, 0.5, 0.2, 0.0)]
    for texture, slide in kinds if asked.walks else []:
        walks = [list(pictured(robot, seed, asked.cycles, texture, slide)) for seed in seeds]
        show(f"texture {texture:g}, slide {100 * slide:+.0f} %", robot, walks)
    if asked.physics:
        seeds = range(asked.first, asked.first + asked.physics)
        show("physics", robot, [list(pictured(robot, seed, asked.cycles, 1.0, None)) for seed in seeds])
