"""A scan of a body that sways, rendered from where it is at each flash: with a stream of its joints, and without."""

from __future__ import annotations

import numpy as np
import pytest

import guara_perception as gp
from benchmarks.sway import BLOCKS, MUST, P95_M, STILL, WALKS, figures
from guara_perception.app.node.simulated import DEMO_WORLD
from guara_perception.exceptions import InvalidInput
from guara_perception.simulation.sway import stream_of
from guara_perception.simulation.world import load_world
from guara_perception.stripes.band import FramePair
from kinematics import BodyTrack, RobotModel

SIZE = (320, 256)


@pytest.mark.heavy
def test_a_body_that_sways_or_goes_on_is_scanned_as_one_that_stands(robot: RobotModel) -> None:
    """0.5 degrees, 5 mm, 1 Hz, or 20 mm/s, 200 samples a second; without them what moved is left out."""
    world, block = load_world(DEMO_WORLD), BLOCKS["guara"]
    still = block.scans(robot, world, STILL, ["-"], 0, SIZE)
    streamed, blind = block.scans(robot, world, MUST, ["200", "-"], 0, SIZE)
    for made in (streamed, *block.scans(robot, world, WALKS, ["200"], 0, SIZE)):
        p95, wrong, kept = figures([made], still)
        assert p95 < P95_M / 2 and wrong == 0 and kept > 0.95
    _, wrong, kept = figures([blind], still)
    assert wrong == 0 and kept < 0.5


@pytest.mark.heavy
def test_a_body_that_sways_in_mujoco_leaves_no_wrong_free_cell(robot: RobotModel) -> None:
    """Its soles rock: what the feet contradict is not used."""
    world, block = load_world(DEMO_WORLD), BLOCKS["physical"]
    for made in block.scans(robot, world, MUST, ["200", "-"], 0, SIZE):
        assert made.wrong == 0


@pytest.mark.slow
def test_a_stripe_whose_place_is_not_known_is_not_used(
    robot: RobotModel, paper_scan: gp.Scan, calibration: gp.Calibration
) -> None:
    """A recorded still scan: with samples about half of its stripes the other half is as if lost, and told."""
    times = np.arange(-0.2, 0.6, 0.005)
    readings, _ = stream_of(robot, STILL, times, np.random.default_rng(0), bias=0.0)
    track = BodyTrack(robot, paper_scan.stance)
    processor = gp.ScanProcessor(calibration, robot, paper_scan.stance, paper_scan.mode, track=track)
    for number, (stripe, on, off) in enumerate(paper_scan.frames()):
        processor.add_all([FramePair(stripe.index, on, off, instant=0.025 * number)])
    assert not np.isfinite(processor.finish().elevation).any()
    joints = [paper_scan.stance.joint_positions[name] for name in robot.tree.joint_names]
    noise = readings - readings.mean(axis=0)
    track.add(times, np.array(joints) + noise, np.ones((len(times), len(robot.legs)), dtype=bool))
    grid, whole = processor.finish(), gp.process_scan(paper_scan, calibration, robot)
    known = np.isfinite(grid.elevation)
    assert 0.1 < known.sum() / np.isfinite(whole.elevation).sum() < 1.0
    # The noise of the stream moves points over the borders of cells.
    assert (known & ~np.isfinite(whole.elevation)).sum() < 0.01 * known.sum()
    both = known & np.isfinite(whole.elevation)
    assert np.percentile(np.abs(grid.elevation - whole.elevation)[both], 99) < 0.001
    assert any("the body's pose at the flash is unknown" in profile.reason for profile in processor.profiles.values())


def test_methods_that_assume_one_pose_take_no_track(
    robot: RobotModel, paper_scan: gp.Scan, calibration: gp.Calibration
) -> None:
    track = BodyTrack(robot, paper_scan.stance)
    with pytest.raises(InvalidInput, match="takes one pose for all stripes; allowed with a track: 'precise'"):
        gp.ScanProcessor(calibration, robot, paper_scan.stance, "coarse", method="paper", track=track)
