"""Tests of the simulated rangefinder: geometry by first principles, light, the whole chain of perception."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.calibration.calibration import Calibration
from guara_perception.exceptions import CalibrationMismatch, InvalidInput
from guara_perception.simulation.features import Box, Patch, Pit
from guara_perception.simulation.light import Light
from guara_perception.simulation.rangefinder import LaserPlanes, SimulatedRangefinder
from guara_perception.simulation.specimen import rotation, specimen
from guara_perception.simulation.world import World
from kinematics import RobotModel, Stance, load_robot
from tests.thorough import examples

QUIET = Light(speckle=0.0, bounce=0.0, shot_noise=0.0, read_noise=0.0)


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return load_robot("guara")


@pytest.fixture(scope="module")
def calibration(robot: RobotModel) -> Calibration:
    return specimen(robot, (640, 512), seed=1)


def test_the_true_calibration_has_the_hash_of_its_file(calibration: Calibration, tmp_path: Path) -> None:
    """Simulated scans and grids carry it, as those of a calibrated robot do."""
    saved = gp.save_calibration(calibration, tmp_path / "calibration.json")
    assert len(calibration.hash) == 16 and calibration.hash == saved.hash


def standing(roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0, x: float = 0.0) -> np.ndarray:
    transform = np.eye(4)
    transform[:3, :3] = rotation([0, 0, yaw]) @ rotation([0, pitch, 0]) @ rotation([roll, 0, 0])
    transform[:3, 3] = x, 0, 0.36
    return transform


@pytest.fixture(scope="module")
def on_level_ground(robot: RobotModel, calibration: Calibration) -> SimulatedRangefinder:
    """A rangefinder over wide level ground; its pose is each test's own."""
    return SimulatedRangefinder(World(x=(-2, 2), y=(-2, 2)), calibration, robot, light=QUIET)


@pytest.mark.slow
@settings(max_examples=examples(6), deadline=None, derandomize=True)
@given(roll=st.floats(-0.08, 0.08), pitch=st.floats(-0.08, 0.08), yaw=st.floats(-3.2, 3.2))
def test_every_pixel_shows_the_point_where_its_ray_meets_the_floor(
    on_level_ground: SimulatedRangefinder, calibration: Calibration, roll: float, pitch: float, yaw: float
) -> None:
    """On level ground the points seen are those of plane geometry, at any attitude and heading."""
    transform = standing(roll, pitch, yaw)
    view = on_level_ground.set_pose(transform)
    camera = transform @ calibration.transform_camera_to_base
    rows, columns = np.meshgrid(np.arange(0, 512, 37), np.arange(0, 640, 41), indexing="ij")
    rays = calibration.camera.rays(np.column_stack((columns.ravel(), rows.ravel()))) @ camera[:3, :3].T
    wanted = camera[:3, 3] - rays * (camera[2, 3] / rays[:, 2])[:, None]
    points = view.points[rows, columns].reshape(-1, 3) + view.origin
    near = np.linalg.norm(wanted[:, :2] - camera[:2, 3], axis=1) < 1.2
    assert near.mean() > 0.8
    np.testing.assert_allclose(points[near], wanted[near], atol=2e-5)


@pytest.mark.slow
def test_points_on_boxes_lie_on_boxes(robot: RobotModel, calibration: Calibration) -> None:
    """What is seen lies on the exact surface: on tops, on the floor, or on a wall between the two."""
    world = World(features=(Box(x=0.7, y=0.05, size=(0.1, 0.12), height=0.06, yaw=0.3),))
    view = SimulatedRangefinder(world, calibration, robot, light=QUIET).set_pose(standing())
    points = (view.points + view.origin).reshape(-1, 3)
    above = points[:, 2] - world.height(points[:, 0], points[:, 1])
    assert (np.abs(points[:, 2] - 0.06) < 1e-4).sum() > 1000
    off = np.abs(above) > 4e-4
    assert off.mean() < 0.03
    # What is left is on walls: within two raster cells of the outline, between floor and top.
    u, v = world.features[0].local(points[off, 0], points[off, 1])
    outside = np.abs(np.maximum(np.abs(u) - 0.05, np.abs(v) - 0.06))
    in_the_air = outside > 0.002
    assert in_the_air.sum() < 20
    assert np.abs(above[off][in_the_air]).max(initial=0.0) < 0.0015
    assert points[off, 2].min() > -1e-4
    assert points[off, 2].max() < 0.0601


def test_laser_planes_turn_with_the_mirror(robot: RobotModel) -> None:
    """At a calibrated angle the laser plane is that stripe's; between two, halfway; all hold the mirror's axis."""
    nominal = specimen(robot, seed=None, mirror_step=0.0)
    model = LaserPlanes.of(nominal)
    assert len(model.angles) == 70
    for k in (0, 35, 69):
        np.testing.assert_allclose(model.plane_at(model.angles[k]), model.planes_in_base[k], atol=1e-12)
    for angle in (-0.15, 0.0, 0.1234, 0.35):
        plane = model.plane_at(angle)
        # The laser plane turns by twice the mirror: from straight down towards +x.
        np.testing.assert_allclose(plane[:3], [np.cos(2 * angle), 0, np.sin(2 * angle)], atol=1e-9)
        assert plane[:3] @ robot.transform_laser_to_base[:3, 3] + plane[3] == pytest.approx(0, abs=1e-9)


def test_specimens_differ_and_repeat(robot: RobotModel) -> None:
    """A seed is one specimen, close to nominal; its mirror angles are steps of the motor."""
    one, again, other = specimen(robot, seed=3), specimen(robot, seed=3), specimen(robot, seed=4)
    np.testing.assert_array_equal(one.transform_camera_to_base, again.transform_camera_to_base)
    assert not np.allclose(one.transform_camera_to_base, other.transform_camera_to_base, atol=1e-4)
    np.testing.assert_allclose(one.transform_camera_to_base, robot.transform_camera_to_base, atol=0.04)
    steps = np.array([stripe.mirror_angle for stripe in one.stripes]) / 122718e-9
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    with pytest.raises(InvalidInput, match="picture size is 32x512, allowed: 64x64 px or more"):
        specimen(robot, (32, 512))


def process(
    robot: RobotModel, calibration: Calibration, world: World, light: Light | None = None, legs: bool = True
) -> gp.TerrainGrid:
    rangefinder = SimulatedRangefinder(world, calibration, robot, seed=0, light=light)
    posture = robot.posture("scan")
    rangefinder.set_pose(standing(), posture if legs else None)
    processor = gp.ScanProcessor(calibration, robot, Stance(posture, robot.legs, (0, 0, -1)))
    for index, on, off in rangefinder.frames(range(70)):
        processor.add(index, on, off)
    return processor.finish()


@pytest.mark.slow
def test_perception_measures_the_simulated_world(robot: RobotModel, calibration: Calibration) -> None:
    """Frames of a box on the floor become its true heights: the geometry of both sides agrees."""
    world = World(features=(Box(x=0.70, y=0.05, size=(0.12, 0.12), height=0.04, material="concrete"),))
    terrain = process(robot, calibration, world)
    x, y = terrain.geometry.centres()
    inside = np.abs(terrain.height_at(*np.meshgrid(x, y)) - world.height(*np.meshgrid(x, y)))
    far = np.maximum(np.abs(x - 0.70)[None, :], np.abs(y - 0.05)[:, None])
    floor, top = inside[far > 0.10], inside[far < 0.05]
    assert np.nanmean(floor) < 0.00012
    assert np.nanmean(top) < 0.00012
    assert np.isfinite(floor).mean() > 0.97
    assert np.isfinite(top).mean() > 0.99


@pytest.mark.slow
def test_dark_patches_and_shadows_give_no_height(robot: RobotModel, calibration: Calibration) -> None:
    """Nothing is measured where the laser is swallowed, nor where a wall hides the ground from the laser."""
    world = World(
        features=(
            Patch(x=0.70, y=0.15, size=(0.1, 0.1), material="dark"),
            Box(x=0.80, y=-0.1, size=(0.05, 0.1), height=0.08, material="concrete"),
        )
    )
    terrain = process(robot, calibration, world)
    assert np.isnan(terrain.height_at(*np.meshgrid(np.linspace(0.67, 0.73, 9), np.linspace(0.12, 0.18, 9)))).all()
    # The laser stands at x = 0.6, 0.47 m high: the box's far top edge (0.825, 0.08) shades the floor to 0.871.
    assert np.isnan(terrain.height_at(*np.meshgrid(np.linspace(0.835, 0.855, 5), np.linspace(-0.13, -0.07, 9)))).all()
    assert not np.isnan(terrain.height_at(0.90, -0.1))


@pytest.mark.slow
def test_the_stripe_is_where_the_plane_meets_the_floor(robot: RobotModel, calibration: Calibration) -> None:
    """The brightest row of a column is that of the calibrated laser plane, to a fraction of a pixel, and red."""
    rangefinder = SimulatedRangefinder(World(), calibration, robot, light=QUIET)
    transform = standing(pitch=0.03)
    rangefinder.set_pose(transform)
    camera = transform @ calibration.transform_camera_to_base
    for index in (5, 40, 65):
        stripe = calibration.stripe(index)
        on = rangefinder.frame(mirror_angle=stripe.mirror_angle).astype(float)
        light = on - rangefinder.frame(laser=0.0)
        assert light[..., 2].max() > 10 * max(light[..., 0].max(), 1)
        profile = gp.extract_stripe(on.astype(np.uint8), rangefinder.frame(laser=0.0))
        for column in (150, 320, 480):
            ray = calibration.camera.rays([[column, profile.position_px[column]]])[0]
            point = camera[:3, :3] @ (ray * -stripe.plane[3] / (stripe.plane[:3] @ ray)) + camera[:3, 3]
            assert abs(point[2]) < 0.0004


@pytest.mark.slow
def test_legs_hide_the_ground_and_throw_shadows(robot: RobotModel, calibration: Calibration) -> None:
    """A foot stretched ahead is seen, and what it hides from the laser is dark; without legs neither happens."""
    posture = robot.posture("scan")
    rangefinder = SimulatedRangefinder(World(), calibration, robot, light=QUIET)
    reached = robot.reach("lf", [0.50, 0.18, -0.30])
    assert reached.is_reachable
    stretched = {**posture, **dict(zip(robot.tree.leg("lf").joints, reached.joint_positions.tolist(), strict=True))}
    bare = rangefinder.set_pose(standing())
    stepping = rangefinder.set_pose(standing(), stretched)
    assert not bare.is_body.any()
    assert 500 < stepping.is_body.sum() < 0.2 * stepping.is_body.size
    points = stepping.points[stepping.is_body] + stepping.origin
    assert points[:, 1].min() > 0.1
    assert points[:, 2].max() > 0.03
    shaded = (bare.laser_gain > 0) & (stepping.laser_gain == 0) & ~stepping.is_body
    assert shaded.sum() > 50


@pytest.mark.slow
def test_light_adds_up(robot: RobotModel, calibration: Calibration) -> None:
    """Half the laser time gives half the laser light, twice the exposure twice the grey levels, up to saturation."""
    light = Light(speckle=0, shot_noise=0, read_noise=0, laser=120.0, ambient=(60.0, 60.0, 60.0))
    rangefinder = SimulatedRangefinder(World(), calibration, robot, light=light)
    rangefinder.set_pose(standing())
    angle = calibration.stripe(30).mirror_angle
    dark = rangefinder.frame(laser=0.0).astype(float)
    full = rangefinder.frame(mirror_angle=angle).astype(float) - dark
    half = rangefinder.frame(mirror_angle=angle, laser=0.5).astype(float) - dark
    np.testing.assert_allclose(half, full / 2, atol=1.01)
    np.testing.assert_allclose(rangefinder.frame(laser=0.0, exposure=2.0), 2 * dark, atol=1.01)
    assert rangefinder.frame(mirror_angle=angle, exposure=40.0).max() == 255
    # A mirror that turns during the exposure spreads the same light over more rows.
    swept = rangefinder.frame(mirror_angle=angle, mirror_travel=0.004).astype(float) - dark
    assert swept.max() < 0.7 * full.max()
    assert swept[..., 2].sum() == pytest.approx(full[..., 2].sum(), rel=0.05)


@pytest.mark.slow
def test_a_lit_wall_lights_the_floor_before_it(robot: RobotModel, calibration: Calibration) -> None:
    """The second bounce brightens the floor beside a lit wall, weakly, and nothing on level ground."""
    world = World(features=(Box(x=0.66, y=0.0, size=(0.1, 0.4), height=0.08, material="concrete"),))
    angle = calibration.stripe(18).mirror_angle
    difference = []
    for bounce in (0.0, 1.0):
        light = Light(speckle=0, shot_noise=0, read_noise=0, bounce=bounce)
        rangefinder = SimulatedRangefinder(world, calibration, robot, light=light)
        rangefinder.set_pose(standing())
        difference.append(rangefinder.frame(mirror_angle=angle).astype(float))
    added = difference[1] - difference[0]
    assert added.min() >= -1
    assert 1 <= added[..., 2].max() < 40
    flat = SimulatedRangefinder(World(), calibration, robot, light=Light(speckle=0, shot_noise=0, read_noise=0))
    flat.set_pose(standing())
    lit = flat.frame(mirror_angle=angle).astype(float) - flat.frame(laser=0.0)
    assert (lit.max(axis=(1, 2)) > 0).sum() < 20


@pytest.mark.slow
def test_noise_has_the_stated_size(robot: RobotModel, calibration: Calibration) -> None:
    """Between two dark frames the variance is read noise and shot noise, and no two frames are alike."""
    light = Light(shot_noise=0.02, read_noise=1.0)
    rangefinder = SimulatedRangefinder(World(), calibration, robot, light=light)
    view = rangefinder.set_pose(standing())
    frames = [rangefinder.frame(laser=0.0).astype(float) for _ in range(6)]
    for one, two in zip(frames, frames[1:], strict=False):
        assert (one != two).any()
    variance = np.mean((frames[1] - frames[0]) ** 2) / 2
    # Rounding to whole grey levels adds 1/12.
    assert variance == pytest.approx(1.0 + 0.02 * view.ambient.mean() + 1 / 12, rel=0.05)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_frames(robot: RobotModel, calibration: Calibration) -> None:
    """Two rangefinders built alike take identical pictures."""
    frames = []
    for _ in range(2):
        rangefinder = SimulatedRangefinder(World(), calibration, robot, seed=7)
        rangefinder.set_pose(standing())
        frames.append([picture for _, *pair in rangefinder.frames([3, 4]) for picture in pair])
    for one, two in zip(*frames, strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.slow
def test_bad_input_is_refused(robot: RobotModel, calibration: Calibration) -> None:
    """Poses in the ground, foreign calibrations, unknown stripes, impossible light: refused with the reason."""
    rangefinder = SimulatedRangefinder(
        World(features=(Pit(x=0.7, y=0, size=(0.1, 0.1), depth=0.05),)), calibration, robot
    )
    with pytest.raises(InvalidInput, match="has no pose: call set_pose"):
        rangefinder.frame()
    low = np.eye(4)
    low[2, 3] = -0.1
    with pytest.raises(InvalidInput, match="the camera is 0.0.* m above the ground; allowed: 0.05 m or more"):
        rangefinder.set_pose(low)
    rangefinder.set_pose(standing())
    with pytest.raises(CalibrationMismatch, match="stripe index 70 is not in the calibration"):
        list(rangefinder.frames([70]))
    with pytest.raises(InvalidInput, match="exposure is 0.0 times the nominal one; allowed: finite factors above 0"):
        rangefinder.frame(exposure=0.0)
    with pytest.raises(InvalidInput, match="light: blur is -1, allowed: finite values of 0 or more"):
        Light(blur=-1)
    with pytest.raises(InvalidInput, match="stripe_sigma is 0 m, fan is 0.75 rad, allowed: values above 0"):
        Light(stripe_sigma=0)


@pytest.mark.slow
def test_pictures_are_plausible(robot: RobotModel, calibration: Calibration) -> None:
    """An ordinary frame is neither black nor white, and its stripe crosses the picture once per column."""
    rangefinder = SimulatedRangefinder(World(), calibration, robot)
    rangefinder.set_pose(standing(), robot.posture("scan"))
    on, off = next(iter(rangefinder.frames([20])))[1:]
    assert on.shape == (512, 640, 3)
    assert 10 < off.mean() < 120
    signal = cv2.blur(on[..., 2].astype(np.float32) - off[..., 2], (5, 1))
    assert np.median(signal.max(axis=0)) > 15
    assert np.abs(np.diff(signal.argmax(axis=0)[100:540])).max() <= 2
