"""Camera motion from the background of a scan: in any light, beside the laser, and without a wrong free cell."""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np
import pytest

import guara_perception as gp
from drivers import StripeVerdict
from drivers.sweep.proof import StripeProof
from guara_perception.app.demo.sway import Stream, swaying_scans
from guara_perception.app.node.simulated import DEMO_WORLD
from guara_perception.scanning.background import CAMERA_MOVED, BackgroundWitness, aligned, grey, motion_text
from guara_perception.scanning.flash_proof import FlashProof
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.specimen import specimen
from guara_perception.simulation.sway import Sway, stream_of
from guara_perception.simulation.world import load_world
from guara_perception.stripes.band import FramePair, bad_frame
from kinematics import BodyTrack, RobotModel, Stance
from kinematics.transforms import inverse, transform_points

SIZE = (320, 256)
PERIOD = 0.035
STRIPES = (30, 32, 34, 36)


class Rig:
    """Simulated rangefinder on a body that sways about its stance."""

    def __init__(self, robot: RobotModel, ahead: float = 0.0, brightness: float = 1.0) -> None:
        self.robot, self.calibration = robot, specimen(robot, SIZE, 0)
        self.stance = Stance(robot.posture("scan"), robot.legs, None)
        self.standing = robot.stance_pose(self.stance).transform_base_to_footprint
        world = load_world(DEMO_WORLD)
        light = dataclasses.replace(world.light, ambient=tuple(brightness * each for each in world.light.ambient))
        self.view = SimulatedRangefinder(world, self.calibration, robot, 0, light=light)
        self.ahead = np.eye(4)
        self.ahead[0, 3] = ahead

    def picture(self, motion: np.ndarray, index: int | None = None) -> np.ndarray:
        """Picture after a motion (4, 4) of the body, with the laser at a stripe or off."""
        self.view.set_pose(self.ahead @ self.standing @ motion)
        if index is None:
            return self.view.frame(laser=0.0)
        return self.view.frame(mirror_angle=self.calibration.stripe(index).mirror_angle)


@pytest.fixture(scope="module")
def rig(robot: RobotModel) -> Rig:
    return Rig(robot, ahead=0.3)


def turned(degrees: float, *shift: float) -> np.ndarray:
    motion = np.eye(4)
    motion[:3, :3] = cv2.Rodrigues(np.radians([0.3 * degrees, degrees, 0.0]))[0]
    motion[:3, 3] = shift or (0.0, 0.0, 0.0)
    return motion


MOTIONS = [turned(0.1), turned(0.5, 0.003, 0.0, 0.003), turned(1.0, 0.005, 0.005, 0.005)]


@pytest.mark.slow
@pytest.mark.parametrize("motion", MOTIONS, ids=["0.1 degrees", "0.5", "1.0"])
def test_texture_that_moves_is_no_light_and_a_line_on_it_is(rig: Rig, motion: np.ndarray) -> None:
    """In dark flashes and in the driver's check of laser-off pictures, over boxes and bright marks."""
    off, moved = rig.picture(np.eye(4)), rig.picture(motion)
    proof = FlashProof()
    proof.add_dark(3, moved, off)
    assert not proof.judge().refused
    lit = moved.copy()
    lit[120:123, :, 2] = np.minimum(lit[120:123, :, 2].astype(int) + 40, 255)
    proof = FlashProof()
    proof.add(3, bad_frame(SIZE[0], "not looked at"))
    proof.add_dark(3, lit, off)
    assert proof.judge().refused.startswith("foreign laser light")
    on = rig.picture(motion, 34)
    assert StripeProof(align=aligned).judge(0.0, on, off, reference_is_off=True)[0] is StripeVerdict.OK
    leak = off.copy()
    leak[60:63, :, 2] = np.minimum(leak[60:63, :, 2].astype(int) + 120, 255)
    assert StripeProof(align=aligned).judge(0.0, on, leak, reference_is_off=True)[0] is StripeVerdict.LEAK


@pytest.mark.slow
def test_a_picture_that_did_not_move_or_shows_nothing_is_not_aligned(rig: Rig) -> None:
    """Nor is a picture of other ground."""
    off = rig.picture(np.eye(4))
    assert aligned(off, rig.picture(np.eye(4))) is None
    flat = np.random.default_rng(0).integers(20, 24, off.shape, dtype=np.uint8)
    assert aligned(flat, flat[::-1].copy()) is None
    assert aligned(off, np.ascontiguousarray(off[::-1, ::-1])) is None


@pytest.mark.slow
@pytest.mark.parametrize("form", ["colour", "grey", "16 bits"])
def test_the_background_tells_how_far_heights_are_off(rig: Rig, form: str) -> None:
    """To half a millimetre; heights are right if the camera stands, or moves as the joints report."""
    camera = rig.standing @ rig.calibration.transform_camera_to_base
    ends = np.array([(x, y, 0.0) for x in (0.5, 0.95) for y in (-0.27, 0.27)])

    def shown(picture: np.ndarray) -> np.ndarray:
        if form == "colour":
            return picture
        return picture[:, :, 1].copy() if form == "grey" else picture.astype(np.uint16) * 257

    for motion in (np.eye(4), *MOTIONS):
        witness = BackgroundWitness(rig.calibration.camera, camera, ends)
        off = shown(rig.picture(np.eye(4)))
        # Most pictures show the body where it stood at BEGIN.
        for index in (30, 32, 36):
            witness.look(index, shown(rig.picture(np.eye(4), index)), off, (100, 140))
        witness.look(34, shown(rig.picture(motion, 34)), off, (100, 140))
        there = rig.standing @ motion @ inverse(rig.standing)
        rise = np.abs((transform_points(there, ends) - ends)[:, 2]).max()
        found = witness.moved(STRIPES, None)
        assert found.keys() <= {34} and (34 in found) == (rise > 0.003)
        assert found.get(34, rise) == pytest.approx(rise, abs=5e-4)
        places = dict.fromkeys((30, 32, 36), camera) | {34: there @ camera}
        assert not witness.moved(STRIPES, places)
        assert bool(witness.moved(STRIPES, places | {34: camera})) == (rise > 0.003)


@pytest.mark.slow
def test_dim_pictures_tell_it_too(robot: RobotModel) -> None:
    """At a mean level of 4 of 255, as behind a band-pass filter; a still scan is kept."""
    dim = Rig(robot, 0.6, brightness=0.06)
    camera = dim.standing @ dim.calibration.transform_camera_to_base
    ends = np.array([(x, y, 0.0) for x in (0.5, 0.95) for y in (-0.27, 0.27)])
    stripes = range(20, 44, 2)
    processor = gp.ScanProcessor(dim.calibration, robot, dim.stance, "coarse")
    assert dim.picture(np.eye(4)).mean() < 5
    witness = BackgroundWitness(dim.calibration.camera, camera, ends)
    for index in stripes:
        motion = turned(0.5) if index == 34 else np.eye(4)
        witness.look(index, dim.picture(motion, index), dim.picture(motion), processor.band(index))
    assert not witness.is_blind and witness.moved(stripes, None).keys() == {34}


def test_in_a_scan_that_moved_stripes_that_do_not_tell_are_not_used(rig: Rig) -> None:
    """A stripe whose laser covers all texture gives no estimate; it is used in a still scan."""
    camera = rig.standing @ rig.calibration.transform_camera_to_base
    ends = np.array([(x, y, 0.0) for x in (0.5, 0.95) for y in (-0.27, 0.27)])
    for motion in (np.eye(4), turned(0.5)):
        witness = BackgroundWitness(rig.calibration.camera, camera, ends)
        off = rig.picture(np.eye(4))
        witness.look(30, rig.picture(np.eye(4), 30), off, (100, 140))
        witness.look(32, rig.picture(motion, 32), off, (0, SIZE[1]))
        witness.look(34, rig.picture(motion, 34), off, (100, 140))
        found = witness.moved((30, 32, 34), None)
        assert found.keys() == ({32, 34} if motion[0, 2] else set())


@pytest.mark.heavy
def test_in_dim_light_a_swaying_scan_has_no_wrong_free_cell(robot: RobotModel) -> None:
    """White at 10 of 255, in pictures of 320 columns, of which a single one shows motion to 4 mm only."""
    world = load_world(DEMO_WORLD)
    light = dataclasses.replace(world.light, ambient=(10.0, 10.0, 10.0))
    known = {}
    for degrees, shift, seed in ((0.0, 0.0, 3), (0.5, 0.005, 3), (1.0, 0.010, 0), (3.0, 0.020, 201)):
        sway = Sway(math.radians(degrees), shift, 0.7 if seed == 201 else 1.0)
        (made,) = swaying_scans(robot, world, specimen(robot, SIZE, seed), sway, [Stream()], seed, light=light)
        health = made.terrain.record.health
        assert made.wrong == 0 and health is not None and (CAMERA_MOVED in health.reasons[0]) == (degrees > 0), health
        known[degrees] = int(np.isfinite(made.errors).sum())
    assert known[0.0] > 9000 > known[0.5]


@pytest.mark.slow
@pytest.mark.parametrize(("level", "has_off", "told"), [(3.0, True, True), (100.0, True, False), (100.0, False, True)])
def test_that_motion_cannot_be_seen_is_told(rig: Rig, level: float, has_off: bool, told: bool) -> None:
    """In the dark and without laser-off pictures, health says so and gives the sway that robot.toml allows."""
    light = dataclasses.replace(rig.view.world.light, ambient=(level,) * 3)
    view = SimulatedRangefinder(rig.view.world, rig.calibration, rig.robot, 0, light=light)
    view.set_pose(rig.ahead @ rig.standing)
    processor = gp.ScanProcessor(rig.calibration, rig.robot, rig.stance, "coarse")
    for index, on, off in view.frames(range(0, 70, 2)):
        processor.add(index, on, off if has_off else None)
    health = processor.finish().record.health
    assert health is not None and any("stance_sway" in reason for reason in health.reasons) == told, health
    assert any("cannot be detected" in reason for reason in health.reasons) == told


@pytest.mark.slow
def test_a_scan_whose_first_laser_off_picture_comes_late_is_blind(rig: Rig) -> None:
    """Most of its stripes come before the reference picture and have no estimate."""
    camera = rig.standing @ rig.calibration.transform_camera_to_base
    ends = np.array([(x, y, 0.0) for x in (0.5, 0.95) for y in (-0.27, 0.27)])
    off = rig.picture(np.eye(4))
    for first in (0, 6):
        witness = BackgroundWitness(rig.calibration.camera, camera, ends)
        for number, index in enumerate(range(30, 46, 2)):
            witness.look(index, rig.picture(np.eye(4), index), off if number >= first else None, (100, 140))
        assert witness.is_blind == (first > 0)


def test_without_texture_or_laser_off_picture_motion_is_not_seen(rig: Rig) -> None:
    """Nor is it in pictures of another size."""
    rng = np.random.default_rng(0)
    camera = rig.standing @ rig.calibration.transform_camera_to_base
    noise = [rng.integers(20, 24, (256, 320, 3), dtype=np.uint8) for _ in range(3)]
    for off in (None, noise[0], np.full_like(noise[0], 30)):
        witness = BackgroundWitness(rig.calibration.camera, camera, np.zeros((4, 3)) + [0.7, 0.0, 0.0])
        for index, on in enumerate((*noise[1:], noise[0][:128, :160])):
            witness.look(index, on, off, (100, 140))
        assert witness.is_blind and not witness.moved((0, 1, 2), None)


def test_ground_whose_texture_is_elsewhere_was_left(rig: Rig) -> None:
    """Its corners are too far off to be followed; not in the dark, upside down, or if the joints explain it."""
    camera = rig.standing @ rig.calibration.transform_camera_to_base
    ends = np.array([(x, y, 0.0) for x in (0.5, 0.95) for y in (-0.27, 0.27)])
    off, far = rig.picture(np.eye(4)), turned(0.0, 0.06, 0.06, 0.0)
    cases = (rig.picture(far), True), (off // 16, False), (np.full_like(off, 90), False), (off[::-1].copy(), False)
    for seen, is_other in cases:
        witness = BackgroundWitness(rig.calibration.camera, camera, ends)
        for index in STRIPES:
            witness.look(index, seen, off, (100, 140))
        found = witness.moved(STRIPES, None)
        assert found == (dict.fromkeys(STRIPES, math.inf) if is_other else {})
        # Joints that report this motion explain it; joints that report none do not.
        assert not witness.moved(STRIPES, dict.fromkeys(STRIPES, far @ camera))
        assert bool(witness.moved(STRIPES, dict.fromkeys(STRIPES, camera))) == is_other
    # The one stripe whose image shows it, and one without an estimate.
    witness = BackgroundWitness(rig.calibration.camera, camera, ends)
    for index, seen in zip(STRIPES, (off, off, cases[0][0], off // 16), strict=True):
        witness.look(index, seen, off, (100, 140))
    found = witness.moved(STRIPES, None)
    assert found[34] == math.inf and not found.keys() & {30, 32}
    assert motion_text(dict.fromkeys(STRIPES, math.inf), 0, 4, has_track=False) == (
        f"{CAMERA_MOVED}: 4 of 4 stripes not used, their images show other ground: the robot must stand still, or "
        "stream its joint positions"
    )


def test_in_the_dark_the_pattern_of_the_sensor_is_no_ground_that_stands_still(rig: Rig) -> None:
    """It is the same in all pictures, however the camera moves; in more light it is weak beside the ground."""
    rng = np.random.default_rng(0)
    camera = rig.standing @ rig.calibration.transform_camera_to_base
    pattern = rng.normal(0.5, 0.5, (256, 320, 3))
    witness = BackgroundWitness(rig.calibration.camera, camera, np.zeros((4, 3)) + [0.7, 0.0, 0.0])
    for index in range(20):
        on, off = (np.rint(np.clip(pattern + rng.normal(0.0, 0.3, pattern.shape), 0, None)) for _ in range(2))
        witness.look(index, on.astype(np.uint8), off.astype(np.uint8), (100, 140))
    assert witness.is_blind


def swaying_scan(rig: Rig, sway: Sway, *, claims: Sway | None = None) -> tuple[gp.TerrainGrid, int]:
    """A coarse scan and its free cells that are more than 5 mm wrong; with a stream, a laser-off picture a stripe.

    Args:
        rig: where it stands.
        sway: how the body moves.
        claims: what the joints say, at 200 Hz; None = no stream.
    """
    indices = range(0, 70, 2)
    track, stance = None, rig.stance
    if claims is not None:
        times = np.arange(-0.3, len(indices) * PERIOD + 0.3, 0.005)
        readings, stance = stream_of(rig.robot, claims, times, np.random.default_rng(0))
        track = BodyTrack(rig.robot, stance, transform_camera_to_base=rig.calibration.transform_camera_to_base)
        track.add(times, readings, np.ones((len(times), len(rig.robot.legs)), dtype=bool))
    processor = gp.ScanProcessor(rig.calibration, rig.robot, stance, "coarse", track=track)
    processor.expect_dark([32, 68])
    off = rig.picture(np.eye(4))
    for number, index in enumerate(indices):
        time = (number + 0.5) * PERIOD
        on, dark = rig.picture(sway.at(time), index), rig.picture(sway.at(time))
        if claims is not None:
            off = dark
        processor.add_all([FramePair(index, on, off, dark if index in (32, 68) else None, time)])
    grid = processor.finish()
    x, y = np.meshgrid(*grid.geometry.centres())
    error = np.abs(grid.elevation - rig.view.world.height(x + rig.ahead[0, 3], y))
    beside = [
        rig.view.world.height(x + rig.ahead[0, 3] + dx, y + dy) for dx in (-0.005, 0.005) for dy in (-0.005, 0.005)
    ]
    flat = np.ptp(beside, axis=0) < 0.003
    return grid, int(((grid.hazard == 0) & flat & (error > 0.005)).sum())


@pytest.mark.heavy
def test_a_scan_of_a_body_that_sways_loses_what_moved_and_says_why(rig: Rig) -> None:
    """No free cell is wrong; a still scan keeps all cells, a sway of 0.1 degrees nine tenths of them."""
    still, wrong = swaying_scan(rig, Sway(0.0, 0.0, 1.0))
    health = still.record.health
    # There is no IMU here, and a single scan has no leg odometry.
    assert wrong == 0 and health is not None and all("neither an IMU" in reason for reason in health.reasons), health
    known = np.isfinite(still.elevation).sum()
    little, wrong = swaying_scan(rig, Sway(math.radians(0.1), 0.001, 1.0))
    assert wrong == 0 and np.isfinite(little.elevation).sum() > 0.9 * known
    for degrees in (0.3, 1.0):
        grid, wrong = swaying_scan(rig, Sway(math.radians(degrees), 0.01 * degrees, 1.0))
        health = grid.record.health
        assert wrong == 0 and health is not None and CAMERA_MOVED in health.reasons[0], health
        assert not any(word in reason for reason in health.reasons for word in ("laser", "line", "flicker"))


@pytest.mark.heavy
def test_joints_that_claim_another_motion_are_contradicted(rig: Rig) -> None:
    """A stream that reports the motion keeps the scan; one that reports a still body loses what moved."""
    sway = Sway(math.radians(0.5), 0.005, 1.0)
    grid, wrong = swaying_scan(rig, sway, claims=sway)
    assert wrong == 0 and np.isfinite(grid.elevation).mean() > 0.8
    grid, wrong = swaying_scan(rig, sway, claims=Sway(0.0, 0.0, 1.0))
    health = grid.record.health
    assert wrong == 0 and health is not None and "from the motion that the joints report" in health.reasons[0]


def test_parted_stripes_are_named() -> None:
    assert motion_text({}, 0, 35, has_track=True) == ""
    text = motion_text({3: 0.004, 5: 0.0071}, 4, 35, has_track=False)
    assert text.startswith("camera moved: 2 of 35 stripes not used, off by up to 7 mm")
    assert "4 pairs of neighbouring stripes not joined" in text


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("width", [320, 640, 963, 1280])
def test_reduced_pictures_are_means_of_their_pixels(kind: type, width: int) -> None:
    """Within one level of OpenCV's, for any size, bit depth and strides."""
    picture = np.random.default_rng(width).integers(0, np.iinfo(kind).max, (101, 2 * width, 3)).astype(kind)[:, ::-2]
    factor = round(width / 320)
    size = width // factor, 101 // factor
    whole = picture[: size[1] * factor, : size[0] * factor, 1].astype(np.float32) / (257 if kind is np.uint16 else 1)
    expected = cv2.resize(np.ascontiguousarray(whole), size, interpolation=cv2.INTER_AREA)
    assert np.abs(grey(picture, 1.0) - expected).max() < 1.6
