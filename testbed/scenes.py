"""The scans that every contender is given: a simulated one of any size, or a recorded one; frames in memory."""

from __future__ import annotations

import re
import shutil
import tempfile
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

import guara_perception as gp
from guara_perception.arrays import Image
from guara_perception.ranging.scan_geometry import in_groups
from guara_perception.settings import Settings
from guara_perception.simulation import Light, SimulatedRangefinder, World, specimen
from guara_perception.simulation.features import Box, Patch, Pit, Ramp, material_index
from kinematics import RobotModel, Stance, load_robot
from testbed.grid_truth import Truth, load_truth, truth_of

ROOT = Path(__file__).resolve().parents[1]
ROBOTS, OWN_DATA = ROOT / "robots", ROOT / "tests" / "data"
# Five boxes as in the paper, and what the paper leaves out: a ramp, a hole, a patch that swallows the laser.
WORLD = World(
    features=(
        Box(x=0.56, y=-0.18, size=(0.06, 0.08), height=0.010),
        Box(x=0.60, y=0.16, size=(0.06, 0.08), height=0.020, material="concrete"),
        Box(x=0.72, y=-0.05, size=(0.06, 0.08), height=0.040, material="brick"),
        Box(x=0.84, y=0.17, size=(0.06, 0.08), height=0.060),
        Box(x=0.86, y=-0.19, size=(0.06, 0.08), height=0.080, material="concrete"),
        Ramp(x=0.74, y=0.08, size=(0.12, 0.10), height=0.030),
        Pit(x=0.62, y=-0.02, size=(0.06, 0.08), depth=0.030),
        Patch(x=0.74, y=-0.20, size=(0.06, 0.06), material="dark"),
    ),
    undulation=0.001,
)
# A floor with most of what a foot must not stand on.
FLOOR = World(
    features=(
        Box(x=0.60, y=0.16, size=(0.06, 0.08), height=0.020, material="concrete"),
        Box(x=0.86, y=-0.19, size=(0.06, 0.08), height=0.080, material="concrete"),
        Pit(x=0.62, y=-0.15, size=(0.06, 0.08), depth=0.060),
        Patch(x=0.72, y=0.0, size=(0.08, 0.08), material="dark"),
    ),
)


@dataclass(frozen=True, slots=True, eq=False)
class ScanInMemory:
    """One scan with all its frames in memory.

    Attributes:
        name: name of the scan in tables.
        robot, calibration, stance, mode: arguments of `gp.ScanProcessor`.
        frames: index, laser-on and laser-off picture of each stripe.
        truth: per cell of 5 mm, or None.
    """

    name: str
    robot: RobotModel
    calibration: gp.Calibration
    stance: Stance
    mode: str
    frames: tuple[tuple[int, Image, Image], ...]
    truth: Truth | None

    def processor(self, method: str = "precise") -> gp.ScanProcessor:
        """A scan of these frames, none added yet."""
        return gp.ScanProcessor(self.calibration, self.robot, self.stance, self.mode, method=method)

    def add_to(self, processor: gp.ScanProcessor, but_last: int = 0) -> None:
        """Add all frames, without the last few, in groups as the node does when they wait for it."""
        for group in in_groups(list(self.frames[: len(self.frames) - but_last])):
            processor.add_all([gp.FramePair(*frames) for frames in group])

    def bands(self) -> list[tuple[Image, Image, int]]:
        """Laser on, laser off and first row of the predicted band of every stripe that is in view."""
        processor = self.processor()
        found = []
        for index, on, off in self.frames:
            first, end = processor.band(index)
            if end > first:
                found.append((on[first:end], off[first:end], first))
        return found


def simulated(
    size: tuple[int, int] = (1280, 1024),
    stripes: int = 70,
    light: Light | None = None,
    seed: int = 0,
    *,
    is_uncertain: bool = True,
    world: World = WORLD,
) -> ScanInMemory:
    """The benchmark's own scene, or another one, the same on every machine; in ordinary light unless another is given.

    Its calibration is exact, and as uncertain as a real one unless `is_uncertain` is false.
    """
    robot = robot_with(stripes)
    calibration = with_covariance(specimen(robot, size)) if is_uncertain else specimen(robot, size)
    stance = scan_stance(robot)
    rangefinder = SimulatedRangefinder(world, calibration, robot, seed, light=light)
    view = rangefinder.set_pose(robot.stance_pose(stance).transform_base_to_footprint, robot.posture("scan"))
    frames = tuple(rangefinder.frames(range(stripes)))
    seen = (view.points + view.origin)[view.laser_gain > 0]
    name = f"simulated, {size[0]} x {size[1]}, {stripes} stripes"
    return ScanInMemory(name, robot, calibration, stance, "standard", frames, _simulated_truth(world, robot, seen))


def recorded(folder: Path) -> ScanInMemory:
    """A recorded scan with the calibration made from the session of its specimen; `folder` is DATA/scans/NAME."""
    data = folder.parent.parent
    scan = gp.open_scan(folder)
    frames = tuple((s.index, on, np.zeros_like(on) if off is None else off) for s, on, off in scan.frames())
    truth = folder / "truth.npz"
    size = f"{frames[0][1].shape[1]} x {frames[0][1].shape[0]}"
    return ScanInMemory(
        name=f"recorded, {folder.name}, {size}, {len(frames)} stripes",
        robot=load_robot(scan.robot),
        calibration=real_calibration(data),
        stance=scan.stance,
        mode=scan.mode,
        frames=frames,
        truth=load_truth(truth, 5) if truth.is_file() else None,
    )


@lru_cache(maxsize=4)
def real_calibration(data: Path) -> gp.Calibration:
    """The calibration that the recorded session of a data folder gives, covariances included."""
    return gp.calibrate(data / "calibration")


def with_covariance(calibration: gp.Calibration) -> gp.Calibration:
    """A true calibration that is as uncertain as a real one: its covariances are those of the recorded session."""
    return replace(calibration, covariance=real_calibration(OWN_DATA).covariance)


@lru_cache(maxsize=4)
def robot_with(stripes: int) -> RobotModel:
    """The Guará with another number of stripes in its standard pattern."""
    robot = load_robot("guara")
    if Settings.of(robot).stripes == stripes:
        return robot
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(shutil.copytree(ROBOTS / "guara", Path(folder) / "guara"))
        toml = copy / "robot.toml"
        toml.write_text(re.sub(r"(?m)^stripes = \d+", f"stripes = {stripes}", toml.read_text()))
        robot = load_robot(copy)
        assert Settings.of(robot).stripes == stripes
        return robot


def scan_stance(robot: RobotModel) -> Stance:
    """Level, on all feet, in the scan posture."""
    return Stance.from_dict(
        {
            "joint_positions": robot.posture("scan"),
            "support_feet": list(robot.legs),
            "gravity_in_base": [0.0, 0.0, -1.0],
        }
    )


def _simulated_truth(world: World, robot: RobotModel, seen_points: npt.NDArray[np.floating]) -> Truth:
    """Truth by cells of 5 mm; seen is what a lit pixel of the camera falls on."""
    settings = Settings.of(robot)
    (x0, x1), (y0, y1) = settings.footprint_x, settings.footprint_y
    elevation, materials = world.raster((x0, x1), (y0, y1), 1e-3)
    ny, nx = elevation.shape
    hit = np.zeros((ny, nx), np.uint8)
    ix = np.floor((seen_points[:, 0] - x0) * 1e3).astype(int)
    iy = np.floor((seen_points[:, 1] - y0) * 1e3).astype(int)
    inside = (ix >= 0) & (ix < nx) & (iy >= 0) & (iy < ny)
    hit[iy[inside], ix[inside]] = 1
    # Pixels are about a millimetre apart on the ground: single cells between them are seen too.
    seen = cv2.morphologyEx(hit, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)) > 0
    dark = materials == material_index("dark")
    return truth_of(elevation, seen & ~dark, dark, 5)
