"""Pose of the body at any instant of a pause, from streamed joints with noise and bias and the standing feet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from guara_perception.simulation.sway import Sway, stream_of
from kinematics import ArgumentError, BodyTrack, RobotModel, Stance, StanceError, body_track, load_robot
from testbed.altered_robot import telescopic_guara

GROUND = np.array([(x, y, -0.36) for x in (0.5, 0.95) for y in (-0.27, 0.27)])
SWAY = Sway(turn=np.radians(0.5), shift=0.005, frequency=1.0)
TIMES = np.linspace(0.05, 1.95, 39)


def tracked(robot: RobotModel, sway: Sway, rate: float, seed: int = 0, **changes: float) -> BodyTrack:
    """Track that covers two seconds and the smoothing windows around them, with BEGIN at 0."""
    times = np.arange(-0.2, 2.2, 1.0 / rate)
    readings, begin = stream_of(robot, sway, times, np.random.default_rng(seed), **changes)
    track = BodyTrack(robot, begin)
    track.add(times, readings, np.ones((len(times), len(robot.legs))))
    return track


def errors(track: BodyTrack, sway: Sway) -> np.ndarray:
    """Errors (instants, corners) of ground heights due to the pose of the body [m]; NaN without a pose."""
    found = np.full((len(TIMES), len(GROUND)), np.nan)
    for row, time in enumerate(TIMES.tolist()):
        place = track.at(time)
        if place is not None:
            moved = np.linalg.inv(sway.at(time)) @ place.transform_base_to_begin
            found[row] = (GROUND @ moved[:3, :3].T + moved[:3, 3] - GROUND)[:, 2]
    return found


@pytest.mark.parametrize(("rate", "most"), [(50.0, 1.5e-4), (200.0, 1e-4), (1000.0, 1e-4)])
def test_the_body_is_placed_to_a_tenth_of_a_millimetre(robot: RobotModel, rate: float, most: float) -> None:
    """With joint biases of 0.2 degrees and noise of 0.05 degrees, errors that stripes do not share stay small."""
    for seed in range(3):
        found = errors(tracked(robot, SWAY, rate, seed), SWAY)
        assert np.isfinite(found).all()
        assert np.std(found - found.mean(axis=0), axis=0).max() < most
        assert np.abs(found).max() < 5e-4


def test_the_covariance_is_that_of_the_places(robot: RobotModel) -> None:
    """Over 12 pauses of a standing robot, ground heights scatter as the covariance predicts."""
    still = Sway(0.0, 0.0, 1.0)
    x, y = (GROUND[:, :2] - np.asarray(robot.transform_camera_to_base)[:2, 3]).T
    lever = np.stack([0 * x, 0 * x, 0 * x + 1, y, -x, 0 * x], axis=1)
    scatter, claimed = [], []
    for seed in range(12):
        track = tracked(robot, still, 200.0, seed, bias=0.0)
        found = errors(track, still)
        scatter.append(np.var(found - found.mean(axis=0), axis=0))
        place = track.at(1.0)
        assert place is not None
        claimed.append(np.einsum("ij,jk,ik->i", lever, place.covariance, lever))
    ratio = np.mean(scatter, axis=0) / np.mean(claimed, axis=0)
    assert (ratio > 0.5).all() and (ratio < 1.5).all()


def test_an_instant_that_is_not_sure_adds_to_the_covariance(robot: RobotModel) -> None:
    """An uncertain instant adds the motion of the body during its sigma to the covariance."""
    track = tracked(robot, SWAY, 200.0)
    sure, unsure = track.at(1.0), track.at(1.0, time_sigma=0.01)
    assert sure is not None and unsure is not None
    camera = np.append(np.asarray(robot.transform_camera_to_base)[:3, 3], 1.0)
    speed = ((SWAY.at(1.01) - SWAY.at(0.99)) @ camera)[:3] / 0.02
    added = np.sqrt(np.diag(unsure.covariance - sure.covariance)[:3])
    # Along the axes of the body at BEGIN, from smoothed joints with noise.
    assert np.linalg.norm(added) == pytest.approx(0.01 * np.linalg.norm(speed), rel=0.2)


def test_no_place_where_the_samples_do_not_tell_it(robot: RobotModel) -> None:
    """No pose is given outside the samples, in a gap, or if feet lift or move apart, or joints move too fast."""
    times = np.arange(0.0, 2.0, 0.005)
    readings, begin = stream_of(robot, SWAY, times, np.random.default_rng(1))
    ones = np.ones((len(times), len(robot.legs)), dtype=bool)

    def at(time: float, joints: np.ndarray = readings, supports: np.ndarray = ones, kept: np.ndarray | None = None):
        track = BodyTrack(robot, begin)
        rows = np.ones(len(times), dtype=bool) if kept is None else kept
        track.add(times[rows], joints[rows], supports[rows])
        assert track.covers(1.0) and not track.covers(1.95)
        return track.at(time)

    assert at(1.0) is not None
    assert at(-0.01) is None and at(2.01) is None
    assert at(1.0, kept=np.abs(times - 1.0) > 0.05) is None
    two = ones.copy()
    two[times > 0.9, :2] = False
    assert at(0.5, supports=two) is not None and at(1.0, supports=two) is None
    three = ones.copy()
    three[:, 0] = False
    assert at(1.0, supports=three) is not None
    slipped = readings.copy()
    knee = robot.tree.joint_index(robot.tree.leg(robot.legs[0]).joints[2])
    slipped[times > 0.7, knee] += 0.05
    assert at(0.5, slipped) is not None and at(1.0, slipped) is None
    kicked = readings + 0.02 * np.sin(2 * np.pi * 40.0 * times)[:, None]
    assert at(1.0, kicked) is None


def test_batches_place_the_body_as_one_and_the_oldest_go(robot: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """Samples added in batches of four give the same poses; at least the last second of 16 s is kept."""
    monkeypatch.setattr(body_track, "MOST_SAMPLES", 200)
    times = np.arange(0.0, 16.0, 0.005)
    readings, begin = stream_of(robot, SWAY, times[-400:], np.random.default_rng(2))
    readings = np.tile(readings, (8, 1))
    supports = np.ones((len(times), len(robot.legs)))
    track, whole = BodyTrack(robot, begin), BodyTrack(robot, begin)
    for rows in np.split(np.arange(len(times)), len(times) // 4):
        track.add(times[rows], readings[rows], supports[rows])
    whole.add(times[-400:], readings[-400:], supports[-400:])
    for time in (15.1, 15.5, 15.9):
        one, other = track.at(time), whole.at(time)
        assert one is not None and other is not None
        np.testing.assert_array_equal(one.transform_base_to_begin, other.transform_base_to_begin)
    assert track.at(1.0) is None and track.covers(15.9) and not track.covers(15.95)


def test_what_is_no_track_is_refused(robot: RobotModel) -> None:
    posture = robot.posture("scan")
    with pytest.raises(StanceError, match="three are needed"):
        BodyTrack(robot, Stance(posture, ("lf", "rf"), None))
    track = BodyTrack(robot, Stance(posture, robot.legs, None))
    joints, supports = np.zeros((2, len(posture))), np.ones((2, 4))
    for times, text in (
        ([0.0, 0.0], "must ascend"),
        ([0.0, np.nan], "must be finite"),
        ([0.0], "have shapes"),
        (0.0, "have shapes"),
    ):
        with pytest.raises(ArgumentError, match=text):
            track.add(times, joints, supports)
    track.add([0.0, 0.1], joints, supports)
    with pytest.raises(ArgumentError, match="must ascend"):
        track.add([0.1, 0.2], joints, supports)


def test_a_gap_is_found_between_two_times_and_what_their_places_need(robot: RobotModel) -> None:
    """The longest gap includes the smoothing windows: samples every 10 ms, with a gap from 1.0 to 1.3 s."""
    times = np.arange(0.0, 2.001, 0.01)
    times = times[(times <= 1.0) | (times >= 1.3)]
    readings, begin = stream_of(robot, SWAY, times, np.random.default_rng(0))
    track = BodyTrack(robot, begin)
    assert track.latest == -np.inf and track.longest_gap(0.5, 0.6) == np.inf
    track.add(times, readings, np.ones((len(times), len(robot.legs))))
    assert track.latest == pytest.approx(2.0)
    assert track.longest_gap(0.1, 0.9) == pytest.approx(0.01) == track.longest_gap(1.4, 1.9)
    assert track.longest_gap(0.1, 0.95) == pytest.approx(0.3) == track.longest_gap(1.2, 1.25)
    assert track.longest_gap(0.05, 0.5) == np.inf == track.longest_gap(1.5, 1.95)


def test_an_instant_that_is_not_known_has_no_place(robot: RobotModel) -> None:
    """The sigma of an instant enters the covariance through the speed of the body; a large sigma gives no pose."""
    track = tracked(robot, SWAY, 200.0)
    sharp, doubtful = track.at(1.0), track.at(1.0, 0.01)
    assert sharp is not None and doubtful is not None
    grown = np.linalg.eigvalsh(doubtful.covariance - sharp.covariance)
    assert grown.max() > 1e-8 and grown.min() > -1e-12
    assert track.at(1.0, 0.02) is None and track.at(1.0, np.nan) is None


def test_noise_of_prismatic_joints_is_metres(tmp_path: Path) -> None:
    """Prismatic knees: noise of 0.2 m times that of a revolute joint is accepted, noise far above it is not."""
    robot = load_robot(telescopic_guara(tmp_path))
    begin, times = Stance(robot.posture("scan"), robot.legs), np.arange(-0.2, 0.2, 0.005)
    for factor, is_placed in ((1.0, True), (5.0 * body_track.MOST_NOISE, False)):
        noise = factor * robot.noise.encoder_noise * robot.tree.joint_scales * robot.tree.is_prismatic
        joints = [begin.joint_positions[name] for name in robot.joint_names]
        joints = joints + noise * np.random.default_rng(0).standard_normal((len(times), len(joints)))
        track = BodyTrack(robot, begin)
        track.add(times, joints, np.ones((len(times), len(robot.legs)), dtype=bool))
        assert (track.at(0.0) is not None) == is_placed
