"""The drift check on floors made by hand, and on a recorded scan."""

import dataclasses
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.calibration.drift import DRIFTING, HOLDS, PARTS, UNKNOWN, Drift, DriftWatch, _parts, check_drift
from guara_perception.scanning.process import run_scan
from kinematics import RobotModel


def floor(height: float = 0.0, slope: float = 0.0, noise: float = 5e-5) -> dict[int, np.ndarray]:
    """Forty stripes of three hundred points each on one plane."""
    random = np.random.default_rng(2)
    stripes = {}
    for index in range(40):
        x = np.full(300, 0.5 + 0.011 * index)
        y = np.linspace(-0.26, 0.26, 300)
        stripes[index] = np.column_stack((x, y, height + slope * (x - 0.7) + random.normal(0, noise, 300)))
    return stripes


def test_parts_are_means_and_medians_of_the_points_in_them() -> None:
    """For stripes of different lengths, with unknown points, and for no stripes."""
    random = np.random.default_rng(4)
    points = {index: random.normal(size=(size, 3)) for index, size in ((3, 400), (5, 0), (9, 57))}
    points[3][::7, 2] = np.nan
    known = {index: each[np.isfinite(each[:, 2])] for index, each in points.items()}
    every = np.concatenate(list(known.values()))[:, 1]
    part_of = (every.max() - every.min()) / PARTS
    index, *found = _parts(points)
    assert index.tolist() == [3, 5, 9] and np.isnan(found[2][1]).all() and np.isfinite(found[2]).any()
    for row, each in enumerate(known.values()):
        part = np.minimum((each[:, 1] - every.min()) / part_of, PARTS - 1).astype(int)
        for number in range(PARTS):
            own = each[part == number]
            expected = [*own[:, :2].mean(axis=0), np.sort(own[:, 2])[len(own) // 2]] if len(own) > 3 else 3 * [np.nan]
            np.testing.assert_allclose([values[row, number] for values in found], expected, rtol=1e-12)


def test_good_floor_holds() -> None:
    """A floor at zero holds, also with boxes on it, gaps in it and a small tilt of the body."""
    stripes = floor(0.001, 0.003)
    stripes[10][100:180, 2] += 0.050
    stripes[25][:, :] = np.nan
    stripes[30][::2] = np.nan
    drift = check_drift(stripes)
    assert (drift.verdict, drift.reasons) == (HOLDS, ())
    assert drift.floor_height == pytest.approx(0.001, abs=2e-4)
    assert drift.to_dict()["floor_tilt"] == pytest.approx(0.003, abs=2e-4)


@pytest.mark.parametrize(
    ("height", "slope", "reason"),
    [
        (0.006, 0.0, r"the floor is at \+6\.0 mm relative to the soles \(limit 3\.0 mm\)"),
        (-0.006, 0.0, r"the floor is at -6\.0 mm relative to the soles"),
        (0.0, 0.02, r"the floor is tilted by 1\.1\d degrees \(limit 0\.60 degrees\)"),
    ],
)
def test_floor_elsewhere(height: float, slope: float, reason: str) -> None:
    """A floor off the soles or tilted is drift, with both numbers; an uncertain stance excuses it."""
    drift = check_drift(floor(height, slope))
    assert drift.verdict == DRIFTING
    assert any(re.search(reason, text) for text in drift.reasons)
    unsure = np.diag([0, 0, 0.004, 0.02, 0.02, 0]) ** 2
    assert check_drift(floor(height, slope), unsure).verdict == HOLDS


def test_stripes_that_disagree() -> None:
    """Stripes that deviate from one floor, all slightly or one clearly, are drift."""
    waves = floor()
    for index, stripe in waves.items():
        stripe[:, 2] += 5e-4 * np.sin(index)
    assert "the stripes deviate by 0.3" in check_drift(waves).reasons[0]
    single = floor()
    single[17][:, 2] += 0.0014
    drift = check_drift(single)
    assert drift.worst_stripe == 17
    assert drift.reasons[0].startswith("stripe index 17 is +1.3")


def test_missed_step() -> None:
    """All later stripes off the floor of the earlier ones are a missed step."""
    stripes = floor()
    for index in range(24, 40):
        stripes[index][:, 2] -= 0.020
    drift = check_drift(stripes)
    assert drift.verdict == DRIFTING
    assert any("from stripe index 24 on, all points are -20" in reason for reason in drift.reasons)


def test_nothing_to_compare_with() -> None:
    """With rubble or few stripes the verdict is unknown, and unknown numbers are null in JSON."""
    random = np.random.default_rng(4)
    rubble = {index: stripe + random.uniform(-0.05, 0.1, 300)[:, None] for index, stripe in floor().items()}
    assert check_drift(rubble).verdict == UNKNOWN
    few = check_drift({index: stripe for index, stripe in floor().items() if index < 4})
    assert (few.verdict, few.reasons) == (UNKNOWN, ("4 stripes have points; 8 or more are needed",))
    assert few.to_dict()["floor_height"] is None and few.to_dict()["worst_stripe"] is None


def test_ground_that_undulates_shows_nothing() -> None:
    """Smooth ground of 2 mm, and rough ground with a straight stretch of 0.2 m, are no floor to compare with."""
    waves = floor()
    for stripe in waves.values():
        stripe[:, 2] += 0.002 * np.sin(14 * stripe[:, 0] + 22 * stripe[:, 1])
    assert check_drift(waves).verdict == UNKNOWN
    partly = floor()
    for index in range(18, 40):
        partly[index][:, 2] += 0.002 * np.sin(30 * partly[index][:, 1] + index)
    unseen = check_drift(partly)
    assert unseen.verdict == UNKNOWN and "18 of 40 stripes run straight" in unseen.reasons[0]


def test_a_slope_under_robot_and_stripes_is_no_drift() -> None:
    """With gravity known, a sloping floor is tilted; if the soles are on the same slope, it is no drift."""
    soles = np.array([[x, y, 0.03 * x] for x in (-0.3, 0.3) for y in (-0.18, 0.18)])
    slope = floor(0.03 * 0.7, 0.03)
    assert check_drift(slope).verdict == DRIFTING
    assert check_drift(slope, soles_in_footprint=soles).verdict == HOLDS
    level = soles * (1, 1, 0)
    assert check_drift(slope, soles_in_footprint=level).verdict == DRIFTING


def test_feet_on_things_leave_height_and_tilt_out() -> None:
    """A foot on a box moves z = 0 off the floor; the comparison of the stripes with each other still counts."""
    soles = np.array([[x, y, 0.0] for x in (-0.3, 0.3) for y in (-0.18, 0.18)])
    soles[:, 2] = (0.0225, -0.0075, -0.0075, -0.0075)
    assert check_drift(floor(-0.0075), soles_in_footprint=soles).verdict == HOLDS
    bent = floor(-0.0075)
    for stripe in bent.values():
        stripe[:, 2] += 0.004 * (stripe[:, 0] - 0.7) ** 2
    drift = check_drift(bent, soles_in_footprint=soles)
    assert drift.verdict == DRIFTING and "bent or twisted by 0.0" in drift.reasons[0]


def test_watch_warns_when_pauses_agree() -> None:
    """Of three pauses one that drifts gives no warning, two do; pauses without a floor count and change nothing."""
    holds, unknown = check_drift(floor()), check_drift({})
    drifts = check_drift(floor(0.02))
    watch = DriftWatch()
    assert watch.verdict == UNKNOWN
    verdicts = []
    for drift in (holds, drifts, unknown, drifts, holds, holds):
        assert isinstance(drift, Drift)
        watch.add(drift)
        verdicts.append(watch.verdict)
    assert verdicts == [HOLDS, HOLDS, HOLDS, DRIFTING, DRIFTING, HOLDS]
    assert watch.counts == {HOLDS: 3, DRIFTING: 2, UNKNOWN: 1}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dark", "tilt"])
def test_recorded_scans_hold(name: str, data: Path, calibration: gp.Calibration, robot: RobotModel) -> None:
    """Scans of another renderer hold with the calibration that was measured from its session."""
    drift = run_scan(gp.open_scan(data / "scans" / name), calibration, robot).drift()
    assert (drift.verdict, drift.reasons) == (HOLDS, ())


@pytest.mark.slow
def test_recorded_scan(paper_scan: gp.Scan, calibration: gp.Calibration, robot: RobotModel) -> None:
    """The recorded scan holds with its calibration; with the camera turned by one degree it does not."""
    turned = calibration.transform_camera_to_base.copy()
    turned[:3, :3] = turned[:3, :3] @ cv2.Rodrigues(np.deg2rad([1.0, 0.0, 0.0]))[0]
    moved = dataclasses.replace(calibration, transform_camera_to_base=turned)
    verdicts = []
    for candidate in (calibration, moved):
        verdicts.append(run_scan(paper_scan, candidate, robot).drift().verdict)
    assert verdicts == [HOLDS, DRIFTING]


@pytest.mark.slow
def test_mirrored_frames_are_distinguished_from_a_drift(
    paper_scan: gp.Scan, calibration: gp.Calibration, robot
) -> None:
    """Left and right swapped look like a camera that moved; the check says that they are swapped, and only then."""
    mirrored = dataclasses.replace(paper_scan, read_frame=lambda name: paper_scan.read_frame(name)[:, ::-1].copy())
    processor = run_scan(mirrored, calibration, robot)
    drift = processor.drift()
    assert drift.verdict == DRIFTING and drift.reasons[0].startswith("mirrored left to right, the frames fit")
    assert processor.finish().record.health == gp.terrain.layers.record.Health("degraded", (drift.reasons[0],))
    slipped = tuple(
        dataclasses.replace(stripe, plane=stripe.plane + [0, 0, 0, 0.002 * (stripe.index > 30)])
        for stripe in calibration.stripes
    )
    drift = run_scan(paper_scan, dataclasses.replace(calibration, stripes=slipped), robot).drift()
    assert drift.verdict == DRIFTING and not any("mirrored" in reason for reason in drift.reasons)
