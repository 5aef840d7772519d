"""Scans with all frames in memory, simulated at any size or recorded, for tests and benchmarks."""

from __future__ import annotations

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
from testbed.altered_robot import altered_guara
from testbed.grid_truth import Truth, load_truth, truth_of

ROOT = Path(__file__).resolve().parents[1]
OWN_DATA = ROOT / "tests" / "data"
# Five boxes as in the paper, and ground that the paper leaves out: a ramp, a hole, and a patch that absorbs the laser.
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
# Floor with most kinds of unsafe ground.
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
    """Scan with all its frames in memory.

    Attributes:
        name: name of the scan in tables.
        robot, calibration, stance, mode: arguments of `gp.ScanProcessor`.
        frames: index, laser-on and laser-off image of each stripe.
        truth: truth per cell of 5 mm; None if unknown.
    """

    name: str
    robot: RobotModel
    calibration: gp.Calibration
    stance: Stance
    mode: str
    frames: tuple[tuple[int, Image, Image], ...]
    truth: Truth | None

    def processor(self, method: str = "precise") -> gp.ScanProcessor:
        """Create a processor for this scan, without frames."""
        return gp.ScanProcessor(self.calibration, self.robot, self.stance, self.mode, method=method)

    def add_to(self, processor: gp.ScanProcessor, but_last: int = 0) -> None:
        """Add all frames except the last `but_last`, in groups, as the node does when several frames are waiting."""
        for group in in_groups(list(self.frames[: len(self.frames) - but_last])):
            processor.add_all([gp.FramePair(*frames) for frames in group])

    def bands(self) -> list[tuple[Image, Image, int]]:
        """Cut out the predicted band of every visible stripe: laser-on image, laser-off image, and first row."""
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
    """Render a scan of the benchmark's scene or another world; the result is the same on every machine.

    The calibration is exact. Its covariance is that of the recorded session, or none if `is_uncertain` is False.
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
    """Read a recorded scan, DATA/scans/NAME, with the calibration computed from the session in DATA/calibration."""
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
    """Compute the calibration of the recorded session in a data folder, including covariances."""
    return gp.calibrate(data / "calibration")


def with_covariance(calibration: gp.Calibration) -> gp.Calibration:
    """Return a copy of a calibration with the covariances of the recorded session."""
    return replace(calibration, covariance=real_calibration(OWN_DATA).covariance)


@lru_cache(maxsize=4)
def robot_with(stripes: int) -> RobotModel:
    """Load the Guará with another number of stripes in its standard pattern."""
    robot = load_robot("guara")
    if Settings.of(robot).stripes == stripes:
        return robot
    with tempfile.TemporaryDirectory() as folder:
        return load_robot(altered_guara(Path(folder), ("\nstripes = 70", f"\nstripes = {stripes}")))


def scan_stance(robot: RobotModel) -> Stance:
    """Stance in the scan posture, level, on all feet."""
    return Stance.from_dict(
        {
            "joint_positions": robot.posture("scan"),
            "support_feet": list(robot.legs),
            "gravity_in_base": [0.0, 0.0, -1.0],
        }
    )


def _simulated_truth(world: World, robot: RobotModel, seen_points: npt.NDArray[np.floating]) -> Truth:
    """Truth per cell of 5 mm; ground is seen if a lit pixel of the camera shows it."""
    settings = Settings.of(robot)
    (x0, x1), (y0, y1) = settings.footprint_x, settings.footprint_y
    elevation, materials = world.raster((x0, x1), (y0, y1), 1e-3)
    ny, nx = elevation.shape
    hit = np.zeros((ny, nx), np.uint8)
    ix = np.floor((seen_points[:, 0] - x0) * 1e3).astype(int)
    iy = np.floor((seen_points[:, 1] - y0) * 1e3).astype(int)
    inside = (ix >= 0) & (ix < nx) & (iy >= 0) & (iy < ny)
    hit[iy[inside], ix[inside]] = 1
    # Pixels are about a millimetre apart on the ground, so single cells between them are seen too.
    seen = cv2.morphologyEx(hit, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)) > 0
    dark = materials == material_index("dark")
    return truth_of(elevation, seen & ~dark, dark, 5)
