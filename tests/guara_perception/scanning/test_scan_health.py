"""Reports of scans with faults: no laser-off frames, a camera that moved, few returns; and the paper's method."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.scanning.coverage_diagnosis import advice
from guara_perception.scanning.scan_report import regional_coverage
from guara_perception.scanning.stripe_finder import METHODS
from kinematics import Stance
from testbed.grid_truth import figures, load_truth
from tests.thorough import examples


def safe(terrain: gp.TerrainGrid) -> np.ndarray:
    return np.asarray(terrain.traversability) > 0


def without_off(scan: gp.Scan, calibration, robot, lost=(), **more) -> gp.TerrainGrid:
    processor = gp.ScanProcessor(calibration, robot, scan.stance, scan.mode, **more)
    for stripe, on, _ in scan.frames():
        if stripe.index not in lost:
            processor.add(stripe.index, on, None)
    return processor.finish()


@pytest.fixture(scope="module")
def whole_without_off(paper_scan, calibration, robot) -> gp.TerrainGrid:
    """The scan of all frames but those with the laser off."""
    return without_off(paper_scan, calibration, robot)


@pytest.mark.slow
def test_scan_without_off_frames_is_nearly_as_good(whole_without_off, data) -> None:
    """Earlier frames serve as background: interior cells known and right, unseen ones unknown."""
    found = figures(whole_without_off, load_truth(data / "scans/paper/truth.npz", 5))
    assert found.known > 98 and found.mean < 0.14
    assert found.unseen_known <= 1 and found.unseen_wrong == 0 and found.unsafe == 0


@pytest.mark.slow
@given(lost=st.frozensets(st.integers(0, 34).map(lambda k: 2 * k), min_size=1, max_size=5))
@settings(max_examples=examples(5), deadline=None, derandomize=True)
def test_losing_frames_without_off_frames_makes_nothing_safe_or_known(
    paper_scan, calibration, robot, whole_without_off, lost
) -> None:
    """A lost frame takes with it the stripes that it served as background: nothing else changes.

    The first stripe is kept: which stripes come first decides which need no background.
    """
    terrain = without_off(paper_scan, calibration, robot, lost - {0})
    assert not (safe(terrain) & ~safe(whole_without_off)).any()
    assert not (np.isfinite(terrain.elevation) & ~np.isfinite(whole_without_off.elevation)).any()


@pytest.mark.slow
def test_lost_background_is_reported(paper_scan, calibration, robot) -> None:
    """The report names the frame that would have served."""
    terrain = without_off(paper_scan, calibration, robot, lost=(20,))
    assert terrain.metadata["frames_bad"] == {
        str(index): "no laser-off frame, and the frame of stripe 20, one of the two earlier frames that replace it, is "
        "missing or unusable"
        for index in (26, 32)
    }


@pytest.mark.slow
@pytest.mark.parametrize("method", ["paper", "paper-literal-lens", "paper-literal-ortho"])
def test_paper_methods_give_a_safe_grid(paper_scan, calibration, robot, paper_terrain, data, method) -> None:
    """The paper's chain, right and literal, ends in the same terrain code; precise is several times better."""
    terrain = gp.process_scan(paper_scan, calibration, robot, method=method)
    truth = load_truth(data / "scans/paper/truth.npz", 5)
    found = figures(terrain, truth)
    assert terrain.metadata["method"] == method
    assert 4 * figures(paper_terrain, truth).mean < found.mean < 2.5
    assert (found.unseen_wrong > 20) == (method == "paper-literal-ortho")
    assert terrain.pictures["ortho_image_mm"].shape == (512, 640)


@pytest.fixture(scope="module")
def papers_frames(paper_scan) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Index, laser-on and laser-off frame of every stripe, read once."""
    return [(stripe.index, on, off) for stripe, on, off in paper_scan.frames()]


@pytest.fixture(scope="module")
def whole_by_the_paper(paper_scan, calibration, robot, papers_frames) -> gp.TerrainGrid:
    """The whole scan by the paper's method."""
    processor = gp.ScanProcessor(calibration, robot, paper_scan.stance, paper_scan.mode, method="paper")
    for frames in papers_frames:
        processor.add(*frames)
    return processor.finish()


@pytest.mark.slow
@given(lost=st.frozensets(st.integers(0, 34).map(lambda k: 2 * k), min_size=1, max_size=10))
@settings(max_examples=examples(6), deadline=None, derandomize=True)
def test_losing_stripes_with_the_papers_method_makes_nothing_safe(
    paper_scan, calibration, robot, papers_frames, whole_by_the_paper, lost
) -> None:
    """The safety invariant does not depend on the method."""
    processor = gp.ScanProcessor(calibration, robot, paper_scan.stance, paper_scan.mode, method="paper")
    for index, on, off in papers_frames:
        if index not in lost:
            processor.add(index, on, off)
    assert not (safe(processor.finish()) & ~safe(whole_by_the_paper)).any()


def test_unknown_method_lists_all(paper_scan, calibration, robot) -> None:
    """The message holds every name that is allowed."""
    with pytest.raises(gp.InvalidInput, match=f"method is 'best', allowed: {', '.join(METHODS)}"):
        gp.ScanProcessor(calibration, robot, paper_scan.stance, "coarse", method="best")


def moved(stance: Stance, angle: float) -> Stance:
    """The stance with both front knees turned by an angle [rad]."""
    content = stance.to_dict()
    joints = dict(content["joint_positions"])
    for leg in ("lf", "rf"):
        joints[f"{leg}_kfe_joint"] += angle
    return Stance.from_dict({**content, "joint_positions": joints})


def test_scan_whose_camera_moved_is_rejected(paper_scan, calibration, robot) -> None:
    """If the stance after the scan differs by more than robot.toml allows, the message asks for another scan."""
    scan = dataclasses.replace(paper_scan, stance_end=moved(paper_scan.stance, 0.02))
    with pytest.raises(gp.InvalidInput, match="stance_end: the camera moved by .* scan again"):
        gp.process_scan(scan, calibration, robot)


def test_scan_whose_camera_stood_still_is_processed(paper_scan, calibration, robot, paper_terrain) -> None:
    """The same stance again changes nothing."""
    scan = dataclasses.replace(paper_scan, stance_end=moved(paper_scan.stance, 1e-5))
    terrain = gp.process_scan(scan, calibration, robot, pictures=False)
    np.testing.assert_array_equal(terrain.elevation, paper_terrain.elevation)


@pytest.mark.parametrize(
    ("counts", "expected_texts"),
    [
        ([0, 1000, 0, 0, 0, 0, 0], ["laser is on", "mirror turns"]),
        ([100, 300, 400, 200, 0, 0, 0], ["polarising filter", "expose less"]),
        ([300, 700, 0, 0, 0, 0, 0], ["narrow band-pass filter", "stronger laser"]),
    ],
)
def test_advice_fits_what_happened(counts: list[int], expected_texts: list[str]) -> None:
    """No light, too much light, too little light: one sentence each, with what to do."""
    sentence = advice(0.31, np.array(counts))
    assert sentence.startswith("only 31 % of the ground that should be visible returned laser light")
    assert all(text in sentence for text in expected_texts)
    assert "\n" not in sentence and ". " not in sentence


@pytest.mark.slow
def test_scan_in_the_dark_says_so(paper_scan, calibration, robot) -> None:
    """All frames without laser light: the health is degraded and the last reason is the advice."""
    processor = gp.ScanProcessor(calibration, robot, paper_scan.stance, paper_scan.mode)
    for stripe, _, off in paper_scan.frames():
        processor.add(stripe.index, off, off)
    health = processor.finish().metadata["health"]
    assert health["level"] == "degraded"
    assert "check that the laser is on" in health["reasons"][-1]


def test_coverage_of_each_region() -> None:
    """Ninths of the area by name; a region in which nothing was expected has none."""
    seen = np.zeros((9, 9), bool)
    seen[:3, :3] = True
    expected = np.ones((9, 9), bool)
    expected[6:, 6:] = False
    regions = regional_coverage(seen, expected)
    assert regions["near right"] == 1.0 and regions["near left"] == 0.0 and regions["far left"] is None
    assert len(regions) == 9


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        ("on_000.jpg", "the frame is of type str; it must be a numpy array"),
        (
            np.zeros((512, 640, 4), np.uint8),
            "the frame is uint8 of shape (512, 640, 4); it must be uint8 or uint16 of shape (h, w) or (h, w, 3)",
        ),
        (np.zeros((100, 640), np.uint8), "the frame is 640x100 px, the calibration is for 640x512 px"),
        (np.zeros((512, 640), np.float32), "the frame is float32"),
        (np.zeros((512, 640), np.uint8), "the searched rows of the frame are blank: every pixel is 0"),
    ],
)
def test_frames_that_cannot_be_used_are_marked_and_the_scan_goes_on(
    paper_scan, calibration, robot, frame: object, message: str
) -> None:
    """The stripe is unknown, the reason is in profile and report."""
    processor = gp.ScanProcessor(calibration, robot, paper_scan.stance, "coarse")
    profile = processor.add(30, frame)  # type: ignore[arg-type]
    assert message in profile.reason
    report = processor.finish().metadata
    assert message in report["frames_bad"]["30"] and report["health"]["level"] == "degraded"
