"""Stripes of a body that sways, where the stream of its joints has gaps, or its instants are not known."""

from __future__ import annotations

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.simulation.sway import Sway, joints_of, stream_of
from guara_perception.stripes.band import FramePair
from kinematics import BodyTrack, RobotModel

pytestmark = pytest.mark.slow
STILL = Sway(0.0, 0.0, 1.0)
PERIOD = 0.025


def tracked(robot: RobotModel, scan: gp.Scan, times: np.ndarray) -> BodyTrack:
    """Track of a robot that stands as in a recorded scan."""
    readings, _ = stream_of(robot, STILL, times, np.random.default_rng(0), bias=0.0)
    joints = [scan.stance.joint_positions[name] for name in robot.tree.joint_names]
    track = BodyTrack(robot, scan.stance)
    track.add(times, np.array(joints) + readings - readings.mean(axis=0), np.ones((len(times), len(robot.legs))))
    return track


def scanned(
    robot: RobotModel, scan: gp.Scan, calibration: gp.Calibration, track: BodyTrack, sigma: float = 0.001
) -> gp.ScanProcessor:
    processor = gp.ScanProcessor(calibration, robot, scan.stance, scan.mode, track=track)
    for number, (stripe, on, off) in enumerate(scan.frames()):
        processor.add_all([FramePair(stripe.index, on, off, None, PERIOD * number, sigma)])
    return processor


def test_a_place_does_not_change_when_more_samples_come(
    robot: RobotModel, paper_scan: gp.Scan, calibration: gp.Calibration
) -> None:
    """Bit for bit: samples arrive one by one in a live scan, and all at once from a recording."""
    times = np.arange(-0.2, PERIOD * len(paper_scan.stripes) + 0.2, 0.005)
    whole = tracked(robot, paper_scan, times)
    live = BodyTrack(robot, paper_scan.stance)
    processor = scanned(robot, paper_scan, calibration, live)
    rows = whole._rows[: whole._end]
    for some in np.array_split(rows, 12):
        live.add(some[:, 0], some[:, 1:-4], some[:, -4:])
        processor.finish()
    assert processor.track_fault == ""
    grid = scanned(robot, paper_scan, calibration, whole).finish()
    np.testing.assert_array_equal(processor.finish().elevation, grid.elevation)
    np.testing.assert_array_equal(processor.finish().hazard, grid.hazard)


def test_pairs_are_where_the_stripes_would_fall_now(
    robot: RobotModel, paper_scan: gp.Scan, calibration: gp.Calibration
) -> None:
    """After the last flash the body moves on by two cells: each pair lies two cells farther on."""
    times = np.arange(-0.2, PERIOD * len(paper_scan.stripes) + 0.2, 0.005)
    track = tracked(robot, paper_scan, times)
    processor = scanned(robot, paper_scan, calibration, track)
    still = gp.ScanProcessor(calibration, robot, paper_scan.stance, paper_scan.mode).pairs
    assert (processor.pairs == still).mean() > 0.9
    forward = np.eye(4)
    forward[0, 3] = 2 * processor.grid.resolution
    walked = joints_of(robot, forward) - joints_of(robot, np.eye(4))
    last = np.array([paper_scan.stance.joint_positions[name] for name in robot.tree.joint_names])
    later = times[-1] + 0.005 * np.arange(1, 60)
    track.add(later, np.tile(last + walked, (len(later), 1)), np.ones((len(later), len(robot.legs))))
    assert (processor.pairs[:, 2:] == still[:, :-2]).mean() > 0.9 > (processor.pairs == still).mean()


def test_a_gap_makes_a_scan_one_without_a_stream_if_asked_for(
    robot: RobotModel, paper_scan: gp.Scan, calibration: gp.Calibration
) -> None:
    """Before that, its stripes are not used; then the grid is that of a still body, and its health says so."""
    times = np.arange(-0.2, PERIOD * len(paper_scan.stripes) + 0.2, 0.005)
    track = tracked(robot, paper_scan, times[(times < 0.3) | (times > 0.5)])
    processor = scanned(robot, paper_scan, calibration, track)
    assert "has a gap of 0.21 s during the scan" in processor.track_fault
    still = gp.process_scan(paper_scan, calibration, robot)
    assert np.isfinite(processor.finish().elevation).sum() < 0.95 * np.isfinite(still.elevation).sum()
    processor.leave_track()
    grid = processor.finish()
    np.testing.assert_array_equal(grid.hazard, still.hazard)
    np.testing.assert_array_equal(grid.elevation, still.elevation)
    assert grid.record.health is not None and processor.track_fault in grid.record.health.reasons[0]
    early = scanned(robot, paper_scan, calibration, tracked(robot, paper_scan, times[times < 0.5]))
    assert "begins or ends during the scan" in early.track_fault


def test_where_instants_are_doubtful_nothing_is_known(
    robot: RobotModel, paper_scan: gp.Scan, calibration: gp.Calibration
) -> None:
    times = np.arange(-0.2, PERIOD * len(paper_scan.stripes) + 0.2, 0.005)
    processor = scanned(robot, paper_scan, calibration, tracked(robot, paper_scan, times), 0.02)
    assert not np.isfinite(processor.finish().elevation).any() and processor.track_fault == ""
