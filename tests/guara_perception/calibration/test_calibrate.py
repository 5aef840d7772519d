"""A whole calibration of the recorded session, against the truth it was rendered from."""

import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.calibration.bundle import fit_camera
from guara_perception.calibration.calibrate_session import calibrate_session
from guara_perception.calibration.calibration import floor_pixels, plane_in_frame
from guara_perception.calibration.calibration_input import CalibrationSession, Fiducials, Plate
from guara_perception.calibration.checks import mount_checks
from guara_perception.calibration.faults import suspect_plate
from guara_perception.calibration.height_sigma import HeightUncertainty
from guara_perception.calibration.laser import LeaveOneOut, fit_laser
from guara_perception.calibration.mirror_model import nominal_mirror
from guara_perception.calibration.mount import locate_camera
from guara_perception.calibration.plates import PlateLine
from guara_perception.calibration.result import CalibrationResult
from guara_perception.images import to_grey
from kinematics import RobotModel
from testbed.calibration_errors import BEYOND_MM, IN_RANGE_MM, height_errors, worst_rms
from tests.guara_perception.calibration.breaking import with_frames, with_pictures, with_plate
from tests.thorough import further


def test_camera_and_mount(result: CalibrationResult, calibration: gp.Calibration) -> None:
    """Errors of lens and mount are at most twice the limits of the full-size specimen (half the resolution)."""
    found, true = result.calibration, calibration
    assert np.abs(found.camera.matrix[[0, 1], [0, 1]] / true.camera.matrix[[0, 1], [0, 1]] - 1).max() < 0.002
    assert np.abs(found.camera.matrix[:2, 2] - true.camera.matrix[:2, 2]).max() < 2.0
    change = np.linalg.inv(true.transform_camera_to_base) @ found.transform_camera_to_base
    shift = found.transform_camera_to_base[:3, 3] - true.transform_camera_to_base[:3, 3]
    assert np.linalg.norm(shift) < 0.8e-3
    assert np.rad2deg(np.linalg.norm(cv2.Rodrigues(change[:3, :3])[0])) < 0.06


def test_sigmas_of_the_camera_are_right(result: CalibrationResult, calibration: gp.Calibration) -> None:
    """Errors of lens and mount are a few predicted standard deviations at most, all together and one by one."""
    fit = result.fit
    lens = calibration.camera
    true_lens = np.r_[lens.matrix[[0, 1], [0, 1]], lens.matrix[:2, 2], lens.distortion[:2]]
    true_to_camera = np.linalg.inv(result.transform_base_to_footprint @ calibration.transform_camera_to_base)
    true_pose = np.r_[np.ravel(cv2.Rodrigues(true_to_camera[:3, :3])[0]), true_to_camera[:3, 3]]
    error = np.r_[fit.lens, fit.pose] - np.r_[true_lens, true_pose]
    assert np.abs(error / np.sqrt(np.diag(fit.covariance))).max() < 4.0
    mahalanobis = float(error @ np.linalg.solve(fit.covariance, error))
    # 99.9 % of a chi-square of 12 is 33: corners share a little of their error, so half as much again is allowed.
    assert mahalanobis < 50


@pytest.mark.parametrize(("heights", "limit"), [(IN_RANGE_MM, 0.20), (BEYOND_MM, 0.40)])
def test_heights_of_the_worst_stripe(
    result: CalibrationResult, calibration: gp.Calibration, heights: np.ndarray, limit: float
) -> None:
    """True laser planes seen by the true camera give true heights through our calibration, beyond the plates too."""
    errors = height_errors(calibration, result.calibration, result.transform_base_to_footprint, heights)
    assert len(errors) == 35
    assert worst_rms(errors)[0] < limit


def test_predicted_height_sigma_is_right(result: CalibrationResult, calibration: gp.Calibration) -> None:
    """Height errors of the calibration itself, over the area from 0 to 110 mm, are as large as it predicts."""
    uncertainty = HeightUncertainty.of(result.calibration)
    assert uncertainty is not None
    true_pose = result.transform_base_to_footprint @ calibration.transform_camera_to_base
    our_pose = result.transform_base_to_footprint @ result.calibration.transform_camera_to_base
    y = np.linspace(-0.25, 0.25, 9)
    errors, variances = [], []
    for stripe, true in zip(result.calibration.stripes, calibration.stripes, strict=True):
        plane = plane_in_frame(true.plane, true_pose)
        for height in (0.0, 0.04, 0.08, 0.11):
            points = np.column_stack((-(plane[1] * y + plane[2] * height + plane[3]) / plane[0], y, np.full(9, height)))
            pixels = calibration.camera.project((points - true_pose[:3, 3]) @ true_pose[:3, :3])
            rays = result.calibration.camera.rays(pixels)
            points = rays * (-stripe.plane[3] / (rays @ stripe.plane[:3]))[:, None]
            errors.append(points @ our_pose[2, :3] + our_pose[2, 3] - height)
            found = (points @ our_pose[:3, :3].T + our_pose[:3, 3]).T[:, None]
            mount = result.calibration.transform_camera_to_base
            variances.append(uncertainty.variance([stripe.index], stripe.plane[None], found, our_pose, mount)[0])
    ratio = np.concatenate(errors) / np.sqrt(np.concatenate(variances))
    assert 0.6 < np.sqrt(np.mean(ratio**2)) < 1.6


def test_verdict_and_record(result: CalibrationResult, tmp_path: Path) -> None:
    """A good session gives the verdict good, and a file that loads again with the same hash and content."""
    assert (result.verdict, result.reasons) == ("good", ())
    saved = gp.save_calibration(result.calibration, tmp_path / "calibration.json")
    loaded = gp.load_calibration(tmp_path / "calibration.json")
    assert loaded.hash == saved.hash
    content = json.loads((tmp_path / "calibration.json").read_text())
    assert [stripe["index"] for stripe in content["stripes"]] == list(range(0, 70, 2))
    assert content["paper"]["height"] == pytest.approx(0.5013, abs=1e-3)
    assert len(content["paper"]["stripes"]) == 35
    assert {figure["verdict"] for figure in content["quality"]["figures"]} == {"good"}


def test_paper_constants_measure_the_plates(result: CalibrationResult) -> None:
    """n, d, k of eqs. 17 to 19 give back the heights of the plates to a tenth of a millimetre."""
    assert result.calibration.paper is not None
    assert max(stripe["residual"] for stripe in result.calibration.paper["stripes"]) < 1e-4


def test_order_of_fiducials_does_not_matter(result: CalibrationResult, robot: RobotModel) -> None:
    """Crosses are found by position: another order of the points gives the same mount."""
    session = result.session
    grey = to_grey(session.read_picture(session.fiducials.image))
    points = session.fiducials.points_in_footprint[[2, 0, 3, 1]]
    nominal = result.transform_base_to_footprint @ robot.transform_camera_to_base
    shuffled = locate_camera(grey, result.intrinsics.camera, Fiducials(session.fiducials.image, points), nominal)
    expected = result.floor.transform_camera_to_footprint
    np.testing.assert_allclose(shuffled.transform_camera_to_footprint, expected, atol=1e-6)


def test_given_pixels_replace_the_search(result: CalibrationResult, robot: RobotModel) -> None:
    """With points_px no cross needs to be visible; pixels clicked to a third of a pixel still give the mount."""
    given = result.session.fiducials
    pixels = np.array([mark.centre_px for mark in result.floor.marks]) + [[0.3, 0.2], [-0.2, 0.3], [0.1, -0.3], [0, 0]]
    fiducials = Fiducials(given.image, given.points_in_footprint, pixels)
    nominal = result.transform_base_to_footprint @ robot.transform_camera_to_base
    nothing_to_see = np.full((512, 640), 90, np.uint8)
    floor = locate_camera(nothing_to_see, result.intrinsics.camera, fiducials, nominal)
    ground = result.session.ground_board_image
    fit = fit_camera(result.intrinsics, result.session.board, ground, floor, given.points_in_footprint)
    expected = result.fit.transform_camera_to_footprint
    assert np.linalg.norm(fit.transform_camera_to_footprint[:3, 3] - expected[:3, 3]) < 2e-3


@pytest.mark.heavy
def test_upright_mount(few_stripes: CalibrationSession, robot: RobotModel, result: CalibrationResult) -> None:
    """A camera mounted upright, half a turn about its axis, is recognised; everything else stays where it is."""

    def turned(picture: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(picture[::-1, ::-1])

    upright = with_pictures(few_stripes, lambda name, picture: turned(picture))
    for number in range(len(few_stripes.plates)):
        upright = with_frames(upright, number, turned)
    found = calibrate_session(upright, robot)
    assert (found.floor.mount, result.floor.mount) == ("upright", "eq5")
    assert found.verdict == "usable" and "rolled by 180 degrees" in found.reasons[0]
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    expected = result.calibration.transform_camera_to_base @ turn
    np.testing.assert_allclose(found.calibration.transform_camera_to_base, expected, atol=5e-4)


@pytest.mark.heavy
@pytest.mark.slow
def test_stripe_with_too_few_points(
    session: CalibrationSession, robot: RobotModel, calibration: gp.Calibration
) -> None:
    """A stripe hidden over most of its length is named, filled in by the mirror model, and still close to the truth."""
    broken = session
    for number in range(len(session.plates)):
        scan = session.plates[number].scan
        hidden = scan.stripes[10]

        def read(name: str, scan: gp.Scan = scan, on: str = hidden.on, off: str = str(hidden.off)) -> np.ndarray:
            frame = scan.read_frame(name)
            if name == on:
                frame = frame.copy()
                frame[:, : frame.shape[1] * 2 // 3] = scan.read_frame(off)[:, : frame.shape[1] * 2 // 3]
            return frame

        broken = with_plate(broken, number, read_frame=read)
    found = calibrate_session(broken, robot)
    assert found.verdict == "usable"
    text = "; ".join(found.reasons)
    assert "stripe index 20 on plate plate_00: visible on" in text
    assert "stripe index 20: filled in by the mirror model" in text
    assert found.calibration.mirror is not None and found.calibration.mirror["filled_in"] == [20]
    errors = height_errors(calibration, found.calibration, found.transform_base_to_footprint, IN_RANGE_MM)
    assert 1e3 * np.sqrt(np.mean(errors[20] ** 2)) < 0.4


def test_two_plates_are_usable(few_stripes: CalibrationSession, robot: RobotModel) -> None:
    """Two heights calibrate, but nothing can be left out, and the verdict says so."""
    found = calibrate_session(dataclasses.replace(few_stripes, plates=few_stripes.plates[::2]), robot)
    assert found.verdict == "usable"
    assert found.reasons[0].startswith("plate left out could not be computed: scan three or more plates")


@pytest.mark.parametrize("wrong", [1, *further(0, 2)])
def test_wrong_plate_is_named(result: CalibrationResult, robot: RobotModel, wrong: int) -> None:
    """A plate that is said to be 2 mm higher than it is contradicts the others; it is named with its true height."""
    plates = list(result.session.plates)
    plates[wrong] = dataclasses.replace(plates[wrong], height=plates[wrong].height + 0.002)
    lines = [
        dataclasses.replace(line, height=plates[line.plate].height) for line in result.lines if line.index % 6 == 0
    ]
    to_footprint = result.transform_base_to_footprint
    mirror = nominal_mirror((to_footprint @ robot.transform_laser_to_base)[:3, 3])
    laser = fit_laser(lines, plates, result.fit, mirror, np.linalg.inv(to_footprint))
    assert max(one.rms for one in laser.leave_one_out) > 0.5e-3
    true = 1e3 * result.session.plates[wrong].height
    text = suspect_plate(laser.leave_one_out, plates)
    assert text.startswith(f"plate {plates[wrong].name} contradicts the others: they put its top at {true:.1f} mm")


def test_slipped_mount_is_refused(few_stripes: CalibrationSession, robot: RobotModel) -> None:
    """A camera that slipped by one row for one plate scan is refused, naming the plate; progress is complete."""
    heard: list[tuple[int, int]] = []
    slipped = with_frames(few_stripes, 1, lambda picture: np.roll(picture, 1, axis=0))
    found = calibrate_session(slipped, robot, progress=lambda done, total: heard.append((done, total)))
    assert found.verdict == "refused"
    assert found.reasons[0].startswith("plate plate_40 contradicts the others")
    assert "mount slipped between the scans" in found.reasons[0]
    pictures = 14 + 1 + 3 * 12
    assert heard == [(done, pictures) for done in range(1, pictures + 1)]


def five_plates(result: CalibrationResult, wrong: int, error: float) -> tuple[list[PlateLine], list[Plate]]:
    """Lines of every third stripe on plates at 0 ... 80 mm as the fitted rangefinder sees them, one height wrong."""
    rng = np.random.default_rng(wrong)
    heights = (0.0, 0.02, 0.04, 0.06, 0.08)
    given_heights = [height + error * (plate == wrong) for plate, height in enumerate(heights)]
    y = np.linspace(-0.2, 0.2, 40)
    lines = []
    for plate, height in enumerate(heights):
        for k, index in list(enumerate(result.laser.stripes.indices))[::3]:
            plane = result.laser.stripes.planes[k]
            crossing = np.column_stack((-(plane[1] * y + plane[2] * height + plane[3]) / plane[0], y))
            pixels = floor_pixels(result.fit.camera, result.fit.transform_camera_to_footprint, crossing, height)
            pixels[:, 1] += 0.03 * rng.standard_normal(len(y))
            angle = result.calibration.stripe(index).mirror_angle
            line = next(line for line in result.lines if line.index == index)
            given = {"plate": plate, "height": given_heights[plate], "index": index, "mirror_angle": angle}
            lines.append(dataclasses.replace(line, **given, pixels=pixels, weights=np.ones(40)))
    scan = result.session.plates[0].scan
    names = [Plate(f"plate_{1e3 * height:.0f}", h, scan) for height, h in zip(heights, given_heights, strict=True)]
    return lines, names


@pytest.mark.parametrize(
    ("wrong", "error"),
    [
        (0, 0.005),
        *(
            pytest.param(*case, marks=pytest.mark.heavy)
            for case in ((1, -0.005), (2, 0.005), (2, -0.005), (3, 0.005), (4, -0.005))
        ),
    ],
)
def test_wrong_one_of_five_plates_is_named(
    result: CalibrationResult, robot: RobotModel, wrong: int, error: float
) -> None:
    """Also one between the others, where leaving out a good plate turns the mirror just as much."""
    lines, plates = five_plates(result, wrong, error)
    to_footprint = result.transform_base_to_footprint
    mirror = nominal_mirror((to_footprint @ robot.transform_laser_to_base)[:3, 3])
    laser = fit_laser(lines, plates, result.fit, mirror, np.linalg.inv(to_footprint))
    text = suspect_plate(laser.leave_one_out, plates)
    true = 1e3 * (plates[wrong].height - error)
    assert text.startswith(f"plate {plates[wrong].name} contradicts the others: they put its top at {true:.1f} mm")


def test_plates_that_cannot_be_distinguished_are_both_named(result: CalibrationResult) -> None:
    """Where the rest agrees equally well without either, the report names both."""
    entry = LeaveOneOut(0, 1e-3, 1e-4, 1e-3, 1e-3, 1e-5, 0.4e-3)
    disagreements = (0.4e-3, 0.9e-3, 0.5e-3, 1.2e-3)
    entries = [dataclasses.replace(entry, plate=k, disagreement=rms) for k, rms in enumerate(disagreements)]
    scan = result.session.plates[0].scan
    plates = [Plate(f"p{k}", 0.02 * k, scan) for k in range(4)]
    text = suspect_plate(entries, plates)
    assert text == (
        "plates p0 and p2 contradict each other or the rest, and it cannot be decided which is wrong: measure both "
        "again (0.0 and 40.0 mm were given)"
    )


@pytest.mark.heavy
@pytest.mark.parametrize(("shift", "turn"), [(0.020, 0.0), (0.0, 3.0)])
def test_crosses_misplaced_as_a_whole_are_not_good(
    session: CalibrationSession, robot: RobotModel, shift: float, turn: float
) -> None:
    """The crosses fit one another perfectly; the mount in the robot's URDF contradicts them, and the report says so."""
    angle = np.deg2rad(turn)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    points = session.fiducials.points_in_footprint @ rotation.T + np.array([shift, 0.0])
    fiducials = dataclasses.replace(session.fiducials, points_in_footprint=points)
    moved = dataclasses.replace(session, fiducials=fiducials)
    found = calibrate_session(moved, robot)
    assert found.verdict != "good"
    assert "an offset common to all of them has the same effect" in "; ".join(found.reasons)


def test_an_upright_mount_is_compared_with_its_own_nominal(robot: RobotModel) -> None:
    """Half a turn about the optical axis is a mount of its own, not an error of 180 degrees."""
    upright = robot.transform_camera_to_base @ np.diag([-1.0, -1.0, 1.0, 1.0])
    for mount, fitted in (("upright", upright), ("eq5", robot.transform_camera_to_base)):
        shift, turn = mount_checks(fitted, robot.transform_camera_to_base, mount)
        assert shift.value == 0.0 and turn.value < 1e-4 and shift.verdict == turn.verdict == "good"
    assert mount_checks(upright, robot.transform_camera_to_base, "eq5")[1].verdict == "refused"


@pytest.mark.heavy
def test_a_floor_that_is_not_level_is_not_good(
    session: CalibrationSession, result: CalibrationResult, robot: RobotModel
) -> None:
    """Gravity is one degree off the soles' normal: too little for the comparison with the URDF, which allows two."""
    angle = np.deg2rad(1.0)
    gravity = (float(np.sin(angle)), 0.0, -float(np.cos(angle)))
    stance = dataclasses.replace(session.stance, gravity_in_base=gravity)
    found = calibrate_session(dataclasses.replace(session, stance=stance), robot)
    reported = [reason for reason in found.reasons if reason.startswith("mount by joints and gravity")]
    assert reported == [
        "mount by joints and gravity is 1 degrees, above 0.5: level the floor; check that all soles lie flat on it, "
        "and check the joints' zeros and the mount of the IMU"
    ]
    assert found.verdict == "usable"
    assert not any("joints and gravity" in reason or reason.startswith("mount turned") for reason in result.reasons)
    assert not any(reason.startswith("mount turned") for reason in found.reasons)
