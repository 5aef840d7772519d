"""A ChArUco board is found whole or cut, distinguished from another, and counts as a checkerboard does."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.calibration.board import CHARUCO, MIRRORED, BoardSpec
from guara_perception.calibration.charuco import CELLS_PER_SQUARE, MIN_CORNERS, MIN_LINES
from guara_perception.calibration.find_board import board_ink, find_board
from guara_perception.calibration.intrinsics import calibrate_intrinsics
from guara_perception.simulation.specimen import rotation, specimen
from guara_perception.simulation.target_pictures import TargetCamera

BOARD = BoardSpec(9, 7, 0.03, CHARUCO)
SIZE = (640, 512)
# Centre as shares of width and height, distance [m], tilts and turn [rad]; the last four are cut by the picture's rim.
POSES = (
    (0.50, 0.50, 0.42, 0.0, 0.0, 0.0),
    (0.36, 0.38, 0.50, 0.5, 0.0, 0.1),
    (0.64, 0.62, 0.50, 0.0, -0.5, 1.5),
    (0.50, 0.50, 0.45, 0.4, 0.4, 3.0),
    (0.10, 0.10, 0.30, 0.0, 0.0, 0.3),
    (0.90, 0.80, 0.35, 0.3, 0.3, 0.0),
    (0.50, 0.50, 0.20, 0.0, 0.0, 0.2),
    (0.50, 0.95, 0.50, 0.6, 0.0, 0.0),
)


@pytest.fixture(scope="module")
def targets(robot) -> TargetCamera:
    """A camera with its lens errors."""
    return TargetCamera.of(specimen(robot, SIZE, 3).camera)


def pose_of(targets: TargetCamera, u, v, distance, about_x=0.0, about_y=0.0, turn=0.0) -> np.ndarray:
    """Transform of a board whose centre appears at a share of width and height."""
    ray = targets.camera.rays(np.array([[u * SIZE[0], v * SIZE[1]]]))[0]
    lean = rotation([about_x, 0, 0]) @ rotation([0, about_y, 0]) @ rotation([0, 0, turn])
    pose = np.eye(4)
    pose[:3, :3] = lean
    pose[:3, 3] = ray / ray[2] * distance - lean @ BOARD.points.mean(axis=0)
    return pose


def seen(targets: TargetCamera, pose: np.ndarray) -> np.ndarray:
    """True pixels of all corners (63, 2)."""
    return targets.camera.project(BOARD.points @ pose[:3, :3].T + pose[:3, 3])


@pytest.fixture(scope="module")
def pictures(targets) -> list[np.ndarray]:
    """The board in each of POSES."""
    return [targets.board(BOARD, pose_of(targets, *pose)) for pose in POSES]


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(POSES)))
def test_corners_are_where_the_lens_puts_them(targets, pictures, number):
    """Each corner found lies where its number says, to a tenth of a pixel; of cut boards only some are found."""
    view = find_board(pictures[number], BOARD)
    assert view.is_usable, view.reason
    error = view.corners_px - seen(targets, pose_of(targets, *POSES[number]))[view.corners]
    assert np.sqrt((error**2).mean()) < 0.1 and np.abs(error).max() < 0.35
    assert (np.diff(view.corners) > 0).all()
    assert len(view.corners) == 63 if number < 4 else MIN_CORNERS <= len(view.corners) < 40
    assert np.allclose(view.points(BOARD), BOARD.points[view.corners])


@pytest.mark.slow
def test_a_covered_board_counts(targets, pictures):
    """A hand over its centre takes away what it covers and nothing else."""
    picture = pictures[0].copy()
    picture[200:330, 250:400] = 120
    view = find_board(picture, BOARD)
    assert view.is_usable and 25 <= len(view.corners) < 60
    error = view.corners_px - seen(targets, pose_of(targets, *POSES[0]))[view.corners]
    assert np.abs(error).max() < 0.35


@pytest.mark.slow
@pytest.mark.parametrize("kept", range(20, 64, 4))
def test_what_is_cut_away_is_never_made_up(targets, pictures, kept):
    """The same corners as in the whole picture, or fewer, however much of the board the rim cuts."""
    truth = seen(targets, pose_of(targets, *POSES[0]))
    cut = pictures[0][:, : int(truth[:, 0].min() + (kept - 20) / 44 * np.ptp(truth[:, 0])) + 30]
    view = find_board(cut, BOARD)
    if view.is_usable:
        assert truth[view.corners, 0].max() < cut.shape[1]
        assert np.abs(view.corners_px - truth[view.corners]).max() < 0.35
        lines = {len(set((view.corners // 9).tolist())), len(set((view.corners % 9).tolist()))}
        assert len(view.corners) >= MIN_CORNERS and min(lines) >= MIN_LINES
    else:
        assert "show more of the board" in view.reason or "no marker" in view.reason


@pytest.mark.slow
def test_a_marker_beside_the_board_does_not_matter(targets, pictures):
    """One of the board's own markers on a card beside it: every corner is where it was."""
    picture = pictures[1].copy()
    marker = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), 7, 48)
    picture[420:500, 540:620] = 190
    picture[436:484, 556:604] = marker[..., None]
    view, before = find_board(picture, BOARD), find_board(pictures[1], BOARD)
    assert view.is_usable
    shared = np.isin(view.corners, before.corners)
    assert shared.all() and len(view.corners) >= 55
    assert np.abs(view.corners_px - before.corners_px[np.isin(before.corners, view.corners)]).max() < 1e-3


@pytest.mark.slow
def test_reasons(pictures):
    """What cannot be used says why."""
    whole = pictures[0]
    checkerboard = dataclasses.replace(BOARD, pattern="checkerboard")
    assert find_board(np.full_like(whole, 100), BOARD).reason.startswith("the picture is blank")
    assert find_board(whole[:, ::-1], BOARD).reason == MIRRORED
    assert find_board(whole[::-1], BOARD).reason == MIRRORED
    assert find_board(whole[:120, :160], BOARD).reason.startswith("no marker of a ChArUco board of 9x7 inner corners")
    assert (
        find_board(whole[:150, :250], BOARD).reason
        == "1 marker found, but no corner between them: show more of the board"
    )
    assert find_board(whole[:200, :270], BOARD).reason == (
        "2 of 63 corners are visible; 12 or more in 3 rows and 3 columns are needed: show more of the board"
    )
    for other in (BoardSpec(8, 7, 0.03, CHARUCO), BoardSpec(7, 9, 0.03, CHARUCO), BoardSpec(12, 7, 0.03, CHARUCO)):
        assert "not where a board of" in find_board(whole, other).reason
    assert find_board(cv2.GaussianBlur(pictures[6], (0, 0), 3), BOARD).reason.startswith("blurred: black-white edges")
    assert not find_board(pictures[4], checkerboard).is_usable


@pytest.mark.heavy
@pytest.mark.slow
def test_the_edge_width_is_that_of_a_checkerboard(targets):
    """For the same blur, the measured widths of both patterns are about equal."""
    pose = pose_of(targets, 0.5, 0.5, 0.3, 0.1, 0.1)
    for blur in (0.0, 1.0, 1.5):
        width = []
        for pattern in ("checkerboard", CHARUCO):
            board = BoardSpec(5, 4, 0.03, pattern)
            picture = targets.board(board, pose)
            picture = cv2.GaussianBlur(picture, (0, 0), blur) if blur else picture
            width.append(find_board(picture, board).edge_width_px)
        assert width[1] == pytest.approx(width[0], rel=0.2)


def test_ink_is_opencvs_own_pattern():
    """Square by square what OpenCV generates; a board without markers for all its squares is refused."""
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    layout = cv2.aruco.CharucoBoard((10, 8), 0.03, 0.0225, markers)
    drawn = layout.generateImage((10 * 40, 8 * 40), marginSize=0)
    fine = np.kron(board_ink(BOARD), np.ones((40 // CELLS_PER_SQUARE,) * 2))
    assert np.array_equal(drawn == 0, fine == 1)
    with pytest.raises(gp.InvalidInput, match="44x44 inner corners needs 1012 markers; allowed: up to 1000: use fewer"):
        board_ink(BoardSpec(44, 44, 0.01, CHARUCO))


@pytest.mark.heavy
@pytest.mark.slow
def test_a_lens_from_parts_of_a_board(targets):
    """Views none of which shows the whole board give the lens, near the picture's corners too."""
    centres = [(u, v) for u in (0.15, 0.5, 0.85) for v in (0.15, 0.5, 0.85)]
    tilts = [(0.4, 0.0), (-0.4, 0.1), (0.0, 0.5), (0.1, -0.5), (0.3, 0.3)]
    views = []
    for number, (u, v) in enumerate(centres):
        pose = pose_of(targets, u, v, 0.28, *tilts[number % 5], 0.4 * number)
        view = find_board(targets.board(BOARD, pose), BOARD, f"view {number}")
        assert view.is_usable and len(view.corners) < 63
        views.append(view)
    lens = calibrate_intrinsics(views, BOARD, SIZE)
    truth = targets.camera
    assert np.allclose(lens.camera.matrix, truth.matrix, rtol=4e-3, atol=2.0)
    grid = np.stack(np.meshgrid(np.linspace(0, 639, 9), np.linspace(0, 511, 7)), axis=-1).reshape(-1, 2)
    across = truth.project(lens.camera.rays(grid)) - grid
    assert np.abs(across - across.mean(axis=0)).max() < 1.0 and lens.rms_px < 0.15
