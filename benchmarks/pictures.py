"""Walks whose laser-off pictures hold the map: drift aside without and with them, on floors of any texture.

Feet slide back by a share of the way, which no joint shows. Each walk has errors of lens, mount and laser planes and
biases of joints of its own. Drift is measured as in `walks drift`; its normalised error is the mean square by the sigma
that the map claims for it, with its interval of 95 % by bootstrap over walks. Walks in MuJoCo need the extra `physics`,
those of Go2 `robots-test`.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.command import options
from benchmarks.scanned_walk import PAUSES_BETWEEN, SEEN_AT, WalkedPause, drift_aside
from benchmarks.sigmas import SAMPLES, calibrated
from guara_perception.app.robot_folder.new_robot import new_robot
from guara_perception.arrays import Float
from guara_perception.calibration.height_sigma import HeightUncertainty
from guara_perception.ground_picture import GroundPicture
from guara_perception.settings import Settings
from guara_perception.simulation import SimulatedRangefinder, World, specimen
from guara_perception.simulation.light import Light
from guara_perception.simulation.specimen import rotation
from guara_perception.simulation.walk import WalkNoise, WalkPause, fresh_reading, simulate_walk
from kinematics import LegOdometry, RobotModel, Stance, load_robot
from testbed.random_world import random_world
from testbed.stock_robots import stock_urdf

# Factors of texture, and shares of the way by which feet slide, of walks that draw them.
TEXTURES, SLIDES = (0.4, 3.0), (-0.08, 0.08)


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


def misread(true: gp.Calibration, rng: np.random.Generator) -> gp.Calibration:
    """A calibration of a rangefinder, with errors of lens, mount and planes as of one from pictures."""
    covariance, uncertainty = calibrated().covariance, HeightUncertainty.of(calibrated())
    assert covariance is not None and uncertainty is not None
    errors = rng.multivariate_normal(np.zeros(12), np.array(covariance["matrix"]), method="svd")
    matrix = true.camera.matrix + np.diag([*errors[:2], 0.0])
    matrix[:2, 2] += errors[2:4]
    camera = replace(
        true.camera, matrix=matrix, distortion=true.camera.distortion + np.append(errors[4:6], np.zeros(3))
    )
    pose = np.array(covariance["values"])[6:]
    mount = true.transform_camera_to_base @ _to_camera(pose) @ np.linalg.inv(_to_camera(pose + errors[6:]))
    stripes = []
    for stripe in true.stripes:
        plane = rng.multivariate_normal(stripe.plane, uncertainty.plane_covariance(stripe.index), method="svd")
        stripes.append(replace(stripe, plane=plane / np.linalg.norm(plane[:3])))
    return replace(true, camera=camera, stripes=tuple(stripes), transform_camera_to_base=mount, covariance=covariance)


def _to_camera(pose: Float) -> Float:
    """Transform (4, 4) of a rotation vector and a translation (6,)."""
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation(pose[:3]), pose[3:]
    return transform


def pictured(
    robot: RobotModel, seed: int, cycles: float, texture: float | None, slide: float | None, *, physics: bool = False
) -> Iterator[PicturedPause]:
    """A walk through simulated frames; texture and slide are drawn where they are None.

    In MuJoCo contacts decide what slides.
    """
    rng = np.random.default_rng(1000 + seed)
    texture = float(np.exp(rng.uniform(*np.log(TEXTURES)))) if texture is None else texture
    noise = WalkNoise(joint=0.0, slide=float(rng.uniform(*SLIDES)) if slide is None else slide)
    if physics:
        world = random_world(seed, boxes=7, rocks=0, pits=0, dark=0, undulation=0.0, box_heights=(0.01, 0.04))
    else:
        world = random_world(seed)
    true = specimen(robot, (640, 512), seed)
    calibration = misread(true, rng)
    bias = dict(zip(robot.tree.joint_names, robot.noise.encoder_sigma * rng.standard_normal(99), strict=False))
    rangefinder = SimulatedRangefinder(world, true, robot, seed, light=Light(texture=texture))
    for pause in _walk(robot, world, seed, cycles, noise, physics=physics):
        rangefinder.set_pose(pause.transform_base_to_world, pause.joint_positions)
        joints = {name: angle + bias[name] for name, angle in pause.joint_positions.items()}
        stance = Stance(joints, robot.legs, pause.stance.gravity_in_base)
        stance = fresh_reading(stance, rng, robot.noise.encoder_noise)
        processor, off = gp.ScanProcessor(calibration, robot, stance, "coarse", step=pause.step), None
        for index in Settings.of(robot).pattern("coarse"):
            off = rangefinder.frame(laser=0.0) if off is None else off
            processor.add(index, rangefinder.frame(mirror_angle=true.stripe(index).mirror_angle), off)
        scan = processor.finish("wide")
        footprint = np.linalg.inv(np.array(scan.metadata["transform_base_to_footprint"]))
        to_world, known = pause.transform_base_to_world @ footprint, pause.known_ground
        yield PicturedPause(stance, scan, to_world, None, known, picture=processor.ground_picture)


def _walk(
    robot: RobotModel, world: World, seed: int, cycles: float, noise: WalkNoise, *, physics: bool
) -> Iterator[WalkPause]:
    if not physics:
        return simulate_walk(world, robot, cycles=cycles, seed=seed, noise=noise)
    from testbed.physics.physics_walk import physics_walk

    return physics_walk(world, robot, cycles=cycles, seed=seed, noise=noise)


def held(robot: RobotModel, pauses: list[PicturedPause], *, with_pictures: bool) -> Held:
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


def show(name: str, robot: RobotModel, walks: Iterator[list[PicturedPause]]) -> None:
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
    ) -> Iterator[list[PicturedPause]]:
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
