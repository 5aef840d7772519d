"""Demo of a swaying body: scans rendered from the body's pose at each flash, compared with a scan of a still body."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from guara_perception.arrays import Float
from guara_perception.calibration.calibration import Calibration
from guara_perception.scanning.scan_processor import ScanProcessor
from guara_perception.settings import Settings
from guara_perception.simulation.light import Light
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.specimen import specimen
from guara_perception.simulation.sway import Sway, stream_of
from guara_perception.simulation.world import World, load_world
from guara_perception.stripes.band import FramePair
from guara_perception.terrain.drawing.style import draw_hazards, draw_layer, new_figure, save_figure, styled
from guara_perception.terrain.grid import TerrainGrid
from kinematics import BodyTrack, RobotModel, Stance, load_robot
from kinematics.transforms import inverse, transform_points

# [s] Interval between the stripes; largest random error of a flash's time; duration of the stream before and after the
# scan.
STRIPE_PERIOD, INSTANT_ERROR, AROUND = 0.035, 0.001, 0.3
# [1/s] Sampling rates of the joint stream. With NO_STREAM, only the stance at BEGIN is used.
NO_STREAM, STREAM_HZ = 0.0, 200.0
# Amplitude of the shift [m] and frequency [1/s] of the demo's sway.
SHIFT, FREQUENCY = 0.005, 1.0
# White noise of one reading of gravity [rad].
IMU_RAD = np.radians(0.1)
# Height error above which a free cell counts as wrong [m].
WRONG_M = 0.005
# Required known cells with a stream, as a fraction of those of the still scan; size of the camera images [px].
KEPT, SIZE = 0.9, (640, 512)


@dataclass(frozen=True, slots=True, eq=False)
class SwayingScan:
    """Scan of a swaying body.

    The grid is placed in the world with the true pose of the body at BEGIN. The errors therefore do not include the
    tilt and the height offset of the whole grid, which are caused by joint noise at BEGIN.

    Attributes:
        terrain: grid of the scan.
        x, y: (ny, nx) positions of the cells in the world [m].
        errors: (ny, nx) heights of the cells minus the true heights [m]; NaN where unknown.
    """

    terrain: TerrainGrid
    x: Float
    y: Float
    errors: Float

    @property
    def wrong(self) -> int:
        """Number of free cells with a height error above `WRONG_M`."""
        return int(((self.terrain.hazard == 0) & (np.abs(self.errors) > WRONG_M)).sum())


@dataclass(frozen=True, slots=True)
class Stream:
    """Readings that a scan of a swaying body gets.

    Attributes:
        rate: sampling rate of the joint stream [1/s]; `NO_STREAM` for none.
        clock_sigma: standard deviation of a clock error common to all flashes [s]. The scan knows this value, not the
            error.
        imu_bias: standard deviation of the bias of gravity at BEGIN, whose white noise is `IMU_RAD` [rad]; None = no
            IMU.
    """

    rate: float = NO_STREAM
    clock_sigma: float = 0.0
    imu_bias: float | None = None


def swaying_scans(
    robot: RobotModel,
    world: World,
    calibration: Calibration,
    sway: Sway,
    streams: Sequence[Stream],
    seed: int,
    *,
    mode: str = "coarse",
    light: Light | None = None,
    period: float = STRIPE_PERIOD,
    travel: float = 0.0,
) -> list[SwayingScan]:
    """Simulate one scan of a swaying body, and process its frames with each of several streams.

    Args:
        robot: model of the robot.
        world: simulated ground.
        calibration: true geometry of the rangefinder.
        sway: motion of the body; its phase at BEGIN is random.
        streams: readings with which the frames are processed.
        seed: random seed of the noise and of the phase.
        mode: scan pattern.
        light: light and sensor effects; None = those of the world.
        period: interval between the stripes [s].
        travel: rotation of the mirror during an exposure [rad].
    """
    view = SimulatedRangefinder(world, calibration, robot, seed, light=light)
    posture = robot.posture(robot.config.scan_posture)
    standing = robot.stance_pose(Stance(posture, robot.legs, None)).transform_base_to_footprint
    phase = np.random.default_rng(seed).uniform(0.0, 1.0 / sway.frequency)
    wanted = set(Settings.of(robot).pattern(mode))
    pairs = []
    for number, stripe in enumerate(each for each in calibration.stripes if each.index in wanted):
        instant = (number + 0.5) * period
        view.set_pose(standing @ sway.at(phase + instant))
        on = view.frame(mirror_angle=stripe.mirror_angle, mirror_travel=travel)
        pairs.append(FramePair(stripe.index, on, view.frame(laser=0.0), instant=instant))
    begin, scans = standing @ sway.at(phase), []
    for stream in streams:
        rng = np.random.default_rng(seed)
        rng.uniform()  # the phase
        times = np.arange(-AROUND, pairs[-1].instant + AROUND, 1.0 / (stream.rate or STREAM_HZ))
        readings, stance = stream_of(robot, sway, times + phase, rng, begin=phase)
        if stream.imu_bias is not None:
            off = Rotation.from_rotvec(rng.normal(0.0, math.hypot(IMU_RAD, stream.imu_bias), 3))
            stance = replace(stance, gravity_in_base=tuple(off.apply(-begin[2, :3]).tolist()))
        track = None
        if stream.rate:
            track = BodyTrack(robot, stance, transform_camera_to_base=calibration.transform_camera_to_base)
            track.add(times, readings, np.ones((len(times), len(robot.legs)), dtype=bool))
        processor = ScanProcessor(calibration, robot, stance, mode, track=track)
        late = stream.clock_sigma * math.sqrt(3.0) * rng.uniform(-1.0, 1.0)
        for pair in pairs:
            instant = pair.instant + late + rng.uniform(-INSTANT_ERROR, INSTANT_ERROR)
            processor.add_all([replace(pair, instant=instant, instant_sigma=stream.clock_sigma)])
        scans.append(_placed(processor.finish(), begin @ inverse(processor.pose.transform_base_to_footprint), world))
    return scans


def _placed(grid: TerrainGrid, transform_footprint_to_world: Float, world: World) -> SwayingScan:
    """Compare a grid with the world, in which base_footprint has the given pose (4, 4)."""
    points = np.stack((*np.meshgrid(*grid.geometry.centres()), grid.elevation), axis=-1)
    x, y, heights = np.moveaxis(transform_points(transform_footprint_to_world, points), -1, 0)
    return SwayingScan(grid, x, y, heights - world.height(x, y))


def scans_beside(robot_name: str | Path, world: str | Path, degrees: float) -> Iterator[tuple[str, SwayingScan]]:
    """Scan one place three times: with a still body, and with a swaying body with and without a joint stream.

    Args:
        robot_name: name or folder of the robot.
        world: name of a world of the package, or a world file.
        degrees: amplitude of the rotation [degrees]; that of the translation is `SHIFT`.

    Yields:
        Title and result of each scan.

    Raises:
        InvalidInput: the sway exceeds the reach of the legs.
        kinematics.KinematicsError: the robot cannot be loaded.
        MissingFile, FileFormatError: the world does not exist or is not valid.
    """
    robot, ground = load_robot(robot_name), load_world(world)
    calibration, sways = specimen(robot, SIZE), Sway(math.radians(degrees), SHIFT, FREQUENCY)
    for titles, sway, streams in (
        (("body still",), Sway(0.0, 0.0, FREQUENCY), (Stream(),)),
        (("body sways, joints streamed", "body sways, no stream"), sways, (Stream(STREAM_HZ), Stream())),
    ):
        yield from zip(titles, swaying_scans(robot, ground, calibration, sway, streams, seed=0), strict=True)


def sway_lines(scans: Sequence[tuple[str, SwayingScan]]) -> list[str]:
    """Results of the scans, as one line of text each."""
    lines = []
    for title, scan in scans:
        known, health = int(np.isfinite(scan.errors).sum()), scan.terrain.record.health
        p95 = f"95 % below {1e3 * np.nanpercentile(np.abs(scan.errors), 95):.2f} mm" if known else "none"
        told = "" if health is None or not health.reasons else f"; health: {health.reasons[0]}"
        lines.append(
            f"{title}: {known:,} cells known, height error {p95}, {scan.wrong} free cells wrong by more than 5 mm{told}"
        )
    return lines


def sway_failures(scans: Sequence[tuple[str, SwayingScan]]) -> list[str]:
    """Failed conditions as text (wrong free cells, too few known cells with a stream); empty if there are none."""
    failures = [f"{title}: {scan.wrong} free cells are wrong" for title, scan in scans if scan.wrong]
    still, streamed = (int(np.isfinite(scan.errors).sum()) for _, scan in scans[:2])
    if streamed < KEPT * still:
        failures.append(f"with a stream {streamed:,} cells are known, at least {KEPT:.0%} of {still:,} required")
    return failures


def draw_sway(path: Path, scans: Sequence[tuple[str, SwayingScan]]) -> None:
    """Draw the scans to a file, one column each: title, height errors, hazards."""
    with styled():
        figure, axes = new_figure(2, len(scans), size=(3.1 * len(scans), 5.0), sharey=True)
        for column, (title, scan) in enumerate(scans):
            above, below = axes[:, column]
            errors = {"cmap": "RdBu_r", "vmin": -1e3 * WRONG_M, "vmax": 1e3 * WRONG_M}
            image = draw_layer(above, scan.terrain.geometry, 1e3 * scan.errors, **errors)
            above.set_title(title)
            draw_hazards(below, scan.terrain.geometry, scan.terrain.hazard, legend=column == len(scans) - 1)
        figure.colorbar(image, ax=axes[0], label="height error [mm]", shrink=0.8)
        save_figure(figure, path)
