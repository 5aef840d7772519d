"""The paper's extraction: each stage by itself, and the whole worse than precise but no worse than half a pixel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.stripes.band import Band
from guara_perception.stripes.paper import (
    binarise,
    extract_paper,
    mean_rows,
    red_enhanced_grey,
    remove_background,
    skeleton,
)
from kinematics import RobotModel
from testbed.grid_truth import figures as truth_figures
from testbed.grid_truth import load_truth
from testbed.synthetic_stripes import CASES, figures
from tests.thorough import examples


def slow_skeleton(mask: np.ndarray) -> np.ndarray:
    """Zhang and Suen as published, pixel by pixel."""
    picture = np.pad(mask.astype(int), 1)
    while True:
        changed = False
        for half in (0, 1):
            gone = []
            for r, c in zip(*np.nonzero(picture), strict=True):
                p2, p3, p4, p5, p6, p7, p8, p9 = (
                    picture[r + dr, c + dc]
                    for dr, dc in ((-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1))
                )
                ring = (p2, p3, p4, p5, p6, p7, p8, p9)
                starts = sum(ring[i] == 0 and ring[(i + 1) % 8] == 1 for i in range(8))
                triples = (p2 * p4 * p6, p4 * p6 * p8) if half == 0 else (p2 * p4 * p8, p2 * p6 * p8)
                if 2 <= sum(ring) <= 6 and starts == 1 and triples == (0, 0):
                    gone.append((r, c))
            for r, c in gone:
                picture[r, c] = 0
            changed |= bool(gone)
        if not changed:
            return picture[1:-1, 1:-1].astype(bool)


@given(seed=st.integers(0, 10_000), density=st.floats(0.2, 0.8))
@settings(max_examples=examples(40), deadline=None, derandomize=True)
def test_skeleton_is_that_of_zhang_and_suen(seed: int, density: float) -> None:
    """The quick one on lists of pixels equals the algorithm as published, also at the picture's border."""
    random = np.random.default_rng(seed)
    mask = random.random((12, 15)) < density
    np.testing.assert_array_equal(skeleton(mask), slow_skeleton(mask))


def test_skeleton_of_a_thick_line_is_its_centre_line() -> None:
    """A bar of five rows becomes one row, and thinning again changes nothing."""
    mask = np.zeros((15, 40), bool)
    mask[5:10] = True
    thin = skeleton(mask)
    assert (thin[7, 3:-3]).all()
    assert thin.sum() <= 40
    np.testing.assert_array_equal(skeleton(thin), thin)


def test_red_enhanced_grey() -> None:
    """0.05 blue + 0.15 green + 0.80 red; mono stays; 16 bits become 8."""
    assert red_enhanced_grey(np.full((2, 2, 3), (100, 0, 0), np.uint8))[0, 0] == 5
    assert red_enhanced_grey(np.full((2, 2, 3), (0, 100, 0), np.uint8))[0, 0] == 15
    assert red_enhanced_grey(np.full((2, 2, 3), (0, 0, 100), np.uint8))[0, 0] == 80
    assert red_enhanced_grey(np.full((2, 2), 77, np.uint8))[0, 0] == 77
    assert red_enhanced_grey(np.full((2, 2, 1), 77, np.uint8)).shape == (2, 2)
    assert red_enhanced_grey(np.full((2, 2), 77 * 257, np.uint16))[0, 0] == 77


def test_remove_background_stops_at_zero() -> None:
    """What is darker than the background counts as no light."""
    light = remove_background(np.array([[10, 90]], np.uint8), np.array([[30, 30]], np.uint8))
    np.testing.assert_array_equal(light, [[0, 60]])


def test_binarise_fixed_and_by_otsu() -> None:
    """A fixed threshold is kept; Otsu's lies between the two levels, and never within the noise."""
    light = np.zeros((64, 240), np.uint8)
    light[30:34] = 120
    np.testing.assert_array_equal(binarise(light, 119.5), light > 119)
    np.testing.assert_array_equal(binarise(light), light > 0)
    noise = np.random.default_rng(0).normal(0, 3, (64, 240)).clip(0).astype(np.uint8)
    assert binarise(noise).mean() < 0.01


def test_mean_rows() -> None:
    """The mean row of each column and the distance between its outermost pixels."""
    thin = np.zeros((10, 3), bool)
    thin[4, 0] = thin[2, 1] = thin[7, 1] = True
    rows, extent = mean_rows(thin)
    np.testing.assert_array_equal(rows, [4, 4.5, np.nan])
    np.testing.assert_array_equal(extent, [0, 5, 0])


def test_paper_is_right_to_half_a_pixel_and_worse_than_precise() -> None:
    """On clean stripes the skeleton finds the line, several times less exactly."""
    case = next(c for c in CASES if c.name == "clean")
    paper, precise = figures(case, "paper", count=3), figures(case, "precise", count=3)
    assert precise["mean"] * 3 < paper["mean"] < 0.5
    assert paper["false"] == 0


@pytest.mark.parametrize("threshold", [None, 40.0])
def test_two_lines_in_one_column_are_ambiguous(threshold: float | None) -> None:
    """The mean of two lines is neither: the column is not used."""
    on = np.full((60, 80), 20, np.uint8)
    off = on.copy()
    on[14:17] = 150
    on[40:43, 30:50] = 150
    profile = extract_paper(Band(on, off), threshold)
    assert (profile.status[33:47] == gp.StripeStatus.AMBIGUOUS).all()
    np.testing.assert_allclose(profile.position_px[5:25], 15, atol=0.01)


@pytest.mark.parametrize("thickness", [2, 3, 4, 6, 9])
def test_the_centre_of_a_line_has_no_bias_whatever_its_thickness(thickness: int) -> None:
    """Thinning leaves one of the two middle rows of an even thickness; the position lies between both."""
    on = np.full((60, 80), 20, np.uint8)
    off = on.copy()
    on[20 : 20 + thickness] = 150
    position = extract_paper(Band(on, off)).position_px
    np.testing.assert_allclose(position[10:-10], 20 + (thickness - 1) / 2, atol=0.01)


def test_a_weak_part_of_a_stripe_is_found_beside_a_bright_one() -> None:
    """Otsu's threshold, 94 here, lies above the weak half; the default lies below it."""
    on = np.full((60, 80), 5, np.uint8)
    off = on.copy()
    on[28:31, :60], on[28:31, 60:] = 190, 80
    assert (extract_paper(Band(on, off)).status[62:78] == gp.StripeStatus.OK).all()
    strict = gp.extract_stripe(on, off, method="paper", threshold=94)
    assert (strict.status[62:78] == gp.StripeStatus.DROPOUT).all() and (strict.status[2:58] == gp.StripeStatus.OK).all()


@pytest.mark.parametrize(
    ("method", "threshold", "message"),
    [
        ("paper", 256, r"threshold is 256, allowed: 0 \.\.\. 255 grey levels"),
        ("paper", float("nan"), "threshold is nan, allowed"),
        ("precise", 15, "threshold is 15, but method 'precise' does not use one; only the paper's method does"),
    ],
)
def test_thresholds_that_are_none_are_refused(
    robot: RobotModel, calibration: gp.Calibration, paper_scan: gp.Scan, method: str, threshold: float, message: str
) -> None:
    """In one picture and in a scan."""
    picture = np.zeros((60, 80), np.uint8)
    picture[30] = 100
    with pytest.raises(gp.InvalidInput, match=message):
        gp.extract_stripe(picture, method=method, threshold=threshold)
    with pytest.raises(gp.InvalidInput, match=message):
        gp.ScanProcessor(calibration, robot, paper_scan.stance, "coarse", method=method, threshold=threshold)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", "dark", "tilt"])
def test_paper_knows_the_ground_of_every_recorded_scan(
    data: Path, robot: RobotModel, calibration: gp.Calibration, name: str
) -> None:
    """At least 90 % of the interior cells; mean errors half of those with Otsu's threshold and marks in the corners."""
    truth = load_truth(data / "scans" / name / "truth.npz", 5)
    found = truth_figures(gp.process_scan(data / "scans" / name, calibration, robot, "paper", pictures=False), truth)
    assert found.known > 90 and found.dark_known == 0 and found.unsafe == 0
    assert found.mean < 0.55 and found.near < 0.45 and found.far < 0.75
    strict = gp.process_scan(data / "scans" / name, calibration, robot, "paper", threshold=48, pictures=False)
    assert truth_figures(strict, truth).known < found.known - 5
