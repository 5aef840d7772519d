"""Drift checks on walks with a rangefinder whose mount has moved since its calibration, or whose mirror lost steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import numpy.typing as npt

import guara_perception as gp
from drivers.emulator.config import STEP
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.drift import Drift
from guara_perception.scanning.scan_processor import ScanProcessor
from guara_perception.simulation.features import Box
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.specimen import rotation, specimen
from guara_perception.simulation.walk import WalkPause, simulate_walk
from guara_perception.simulation.world import World
from kinematics import RobotModel, load_robot

PAUSES = 3
SPECIMENS = 7
STRIPES = range(0, 70, 2)
UNDULATION_M = 0.002


def moved_about(turn: np.ndarray, about: np.ndarray, shift: npt.ArrayLike = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Motion (4, 4) by a rotation about a point and a shift [m]."""
    transform = np.eye(4)
    transform[:3, :3] = turn
    transform[:3, 3] = about - turn @ about + shift
    return transform


def moved(calibration: gp.Calibration, *, camera: np.ndarray, laser: np.ndarray) -> gp.Calibration:
    """Calibration after motions (4, 4) of the camera and of the laser planes in base_link."""
    before = calibration.transform_camera_to_base
    # A plane transforms by the inverse transpose; in the camera's frame the laser moves against the camera.
    now = camera @ before
    planes = [stripe.plane @ np.linalg.inv(np.linalg.inv(now) @ laser @ before) for stripe in calibration.stripes]
    stripes = tuple(
        replace(stripe, plane=plane / np.linalg.norm(plane[:3]))
        for stripe, plane in zip(calibration.stripes, planes, strict=True)
    )
    return replace(calibration, transform_camera_to_base=now, stripes=stripes)


@dataclass(frozen=True, slots=True)
class Injected:
    """Drift after the calibration.

    Attributes:
        camera: rotation vector (3,) of the camera about its optical centre [rad].
        laser: rotation vector (3,) of laser and mirror about the nominal position of the laser [rad].
        steps: error of the mirror from a random stripe of the first scan on; the mirror is not homed again [motor
            steps].
    """

    camera: tuple[float, ...] = (0.0, 0.0, 0.0)
    laser: tuple[float, ...] = (0.0, 0.0, 0.0)
    steps: float = 0.0

    @classmethod
    def of(cls, kind: str, size: float, rng: np.random.Generator) -> Injected:
        """Create a drift of a size ("steps" in motor steps, otherwise in degrees) in a random direction."""
        if kind == "steps":
            return cls(steps=size * float(rng.choice((-1.0, 1.0))))
        direction = rng.standard_normal(3)
        turn = tuple((np.deg2rad(size) * direction / np.linalg.norm(direction)).tolist())
        return cls(camera=turn) if kind == "camera" else cls(laser=turn)

    def apply(self, calibration: Calibration, robot: RobotModel) -> Calibration:
        """Calibration of the rangefinder after the drift."""
        camera = moved_about(rotation(self.camera), calibration.transform_camera_to_base[:3, 3])
        laser = moved_about(rotation(self.laser), robot.transform_laser_to_base[:3, 3])
        return moved(calibration, camera=camera, laser=laser)


def world_of(rng: np.random.Generator, *, is_rough: bool) -> World:
    """Create a flat floor, or ground that undulates by 2 mm, with up to five boxes on it."""
    boxes = tuple(
        Box(
            x=float(rng.uniform(0.55, 1.1)),
            y=float(rng.uniform(-0.22, 0.22)),
            size=(float(rng.uniform(0.05, 0.15)), float(rng.uniform(0.05, 0.15))),
            height=float(rng.uniform(0.01, 0.08)),
            yaw=float(rng.uniform(0, 3)),
            material="wood",
        )
        for _ in range(int(rng.integers(0, 6)))
    )
    undulation = UNDULATION_M if is_rough else 0.0
    return World(features=boxes, undulation=undulation, seed=int(rng.integers(1 << 30)), flat_until=0.55)


def scan(
    robot: RobotModel, rig: SimulatedRangefinder, known: Calibration, pause: WalkPause, offsets: Sequence[float]
) -> Drift:
    """Scan at a pause with the calibration `known` and errors `offsets` of the mirror angle [rad]; check the drift."""
    rig.set_pose(pause.transform_base_to_world, pause.joint_positions)
    processor = ScanProcessor(known, robot, pause.stance, "coarse")
    off = rig.frame(laser=0.0)
    for index, offset in zip(STRIPES, offsets, strict=True):
        processor.add(index, rig.frame(mirror_angle=known.stripe(index).mirror_angle + offset), off)
    return processor.drift()


@cache
def guara() -> RobotModel:
    """Load the Guará, once per process."""
    return load_robot("guara")


def walk(seed: int, kind: str = "", size: float = 0.0, *, is_rough: bool = False) -> list[Drift]:
    """Drift checks at three pauses of a walk with noise in joints, contacts and the direction of gravity.

    A drift of `kind` is present from the start, in a random direction; steps are lost once, during the first scan.
    """
    robot, rng = guara(), np.random.default_rng(seed)
    known = specimen(robot, seed=seed % SPECIMENS)
    world = world_of(rng, is_rough=is_rough)
    injected = Injected.of(kind, size, np.random.default_rng(seed + 10_000)) if kind else Injected()
    rig = SimulatedRangefinder(world, injected.apply(known, robot), robot, seed)
    lost_from, lost = int(rng.integers(1, len(STRIPES))), injected.steps * STEP
    checks = []
    for number, pause in zip(range(PAUSES), simulate_walk(world, robot, seed=seed), strict=False):
        offsets = [lost if number > 0 or index >= lost_from else 0.0 for index in range(len(STRIPES))]
        checks.append(scan(robot, rig, known, pause, offsets))
    return checks
