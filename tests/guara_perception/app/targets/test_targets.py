"""`guara targets`: every drawing in the PDF has the right size and position."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pypdfium2
import pytest

import guara_perception as gp
from guara_perception.app.targets.drawings import calibration_board, cross_points, mat, ruler, write_targets
from guara_perception.app.targets.sheet import OVERLAP_MM, PAPERS_MM, pages_of
from guara_perception.calibration.board import CHARUCO, BoardSpec
from guara_perception.calibration.crosses import ARM_M, BAR_M
from guara_perception.calibration.find_board import find_board

DOTS_PER_MM = 8.0


@pytest.fixture(scope="module")
def printed(robot, tmp_path_factory):
    """Targets on A3: the pages, and their grey pixels."""
    path = tmp_path_factory.mktemp("targets") / "targets.pdf"
    pages = write_targets(path, robot, paper="a3")
    document = pypdfium2.PdfDocument(path)
    assert len(document) == len(pages)
    pictures = [np.asarray(page.render(scale=DOTS_PER_MM * 25.4 / 72, grayscale=True).to_numpy()) for page in document]
    return pages, [picture.reshape(picture.shape[:2]) for picture in pictures]


def sheet_position(page, picture, pixel):
    """Position of a pixel on the sheet of its page [mm], from the bottom left."""
    width, height = page.paper_mm
    left, bottom = (width - page.size_mm[0]) / 2, (height - page.size_mm[1]) / 2
    u, v = (np.asarray(pixel, float) + 0.5) / (picture.shape[1], picture.shape[0])
    return np.array([u * width - left + page.corner_mm[0], (1 - v) * height - bottom + page.corner_mm[1]])


@pytest.mark.slow
def test_pages_have_the_size_of_the_paper(printed):
    """Rendered at a whole number of dots per millimetre, each page has the size of A3 to a dot."""
    for page, picture in zip(*printed, strict=True):
        assert sorted(page.paper_mm) == sorted(PAPERS_MM["a3"])
        assert np.allclose(picture.shape[::-1], np.array(page.paper_mm) * DOTS_PER_MM, atol=1.0)


@pytest.mark.slow
def test_board_is_found_and_its_squares_measure_30_mm(printed):
    """The calibration's detector finds it on one page; every square is right to a fiftieth of a millimetre."""
    (index,) = [i for i, page in enumerate(printed[0]) if page.sheet.title.startswith("Checkerboard")]
    view = find_board(printed[1][index], BoardSpec(9, 7, 0.03))
    assert view.is_usable, view.reason
    corners = view.corners_px.reshape(7, 9, 2) / DOTS_PER_MM
    for axis in (0, 1):
        edges = np.linalg.norm(np.diff(corners, axis=axis), axis=2)
        assert np.abs(edges - 30.0).max() < 0.05 and abs(edges.mean() - 30.0) < 0.02


@pytest.mark.heavy
@pytest.mark.parametrize("paper", PAPERS_MM)
def test_a_charuco_board_is_found_page_by_page(robot, tmp_path: Path, paper):
    """Each page shows its part of the board: every detected corner is the right one, in the right position."""
    board = BoardSpec(9, 7, 0.03, CHARUCO)
    path = tmp_path / "targets.pdf"
    pages = write_targets(path, robot, board=board, paper=paper)
    document, found = pypdfium2.PdfDocument(path), set()
    for number, page in enumerate(pages):
        if not page.sheet.title.startswith("ChArUco board, 9 x 7 inner corners, 30 mm squares"):
            continue
        rendered = document[number].render(scale=DOTS_PER_MM * 25.4 / 72, grayscale=True).to_numpy()
        picture = np.asarray(rendered).reshape(rendered.shape[:2])
        view = find_board(picture, board)
        assert view.is_usable, view.reason
        # From the top left of the drawing, with a white border before the first square.
        border = (page.sheet.width_mm - 300.0) / 2
        expected = view.points(board)[:, :2] * 1e3 + border + 30.0
        expected[:, 1] = page.sheet.height_mm - expected[:, 1]
        drawn = [sheet_position(page, picture, corner) for corner in view.corners_px]
        assert np.abs(drawn - expected).max() < 0.1
        found |= set(view.corners.tolist())
    # Near the edge between two pages, neither shows all markers of a corner.
    assert len(found) == 63 if paper == "a3" else len(found) >= 40


@pytest.mark.slow
def test_crosses_of_the_mat_lie_where_they_are_said_to_lie(printed, robot):
    """Ink at each cross: centre to a tenth of a millimetre, arms and bars as the calibration expects them."""
    found = []
    for page, picture in zip(*printed, strict=True):
        if not page.sheet.title.startswith("Floor mat"):
            continue
        count, _, stats, centres = cv2.connectedComponentsWithStats((picture < 60).astype(np.uint8))
        for k in range(1, count):
            if stats[k, cv2.CC_STAT_WIDTH] > 20 * DOTS_PER_MM:
                assert np.allclose(stats[k, 2:4] / DOTS_PER_MM, 2e3 * ARM_M, atol=0.2)
                area = 4e6 * ARM_M * BAR_M * 2 - (2e3 * BAR_M) ** 2
                # Bars are rasterized to whole dots, 24 across.
                assert stats[k, cv2.CC_STAT_AREA] / DOTS_PER_MM**2 == pytest.approx(area, rel=0.05)
                found.append(sheet_position(page, picture, centres[k]))
    sheet = mat(robot)
    points = cross_points(robot)
    # x up and y to the left: distances between crosses are those in base_footprint.
    expected = np.column_stack((-points[:, 1], points[:, 0])) * 1e3
    offset = np.mean(found, axis=0) - expected.mean(axis=0)
    nearest = [np.abs(np.array(found) - offset - e).max(axis=1).min() for e in expected]
    assert len({tuple(np.rint(f / 5)) for f in found}) == 5 and max(nearest) < 0.1
    assert sheet.height_mm > sheet.width_mm


def test_soles_on_the_mat_are_those_of_the_scan_posture(robot):
    """Their mean is the origin: `base_footprint` is below the body, as the stance pose defines it."""
    pose = robot.stance_pose(gp.Stance(robot.posture(robot.config.scan_posture), robot.legs, None))
    assert np.abs(pose.soles_in_footprint[:, 2]).max() < 1e-9
    assert mat(robot).height_mm == pytest.approx(
        1e3 * (cross_points(robot)[:, 0].max() - pose.soles_in_footprint[:, 0].min() + robot.sole[0] / 2 + 0.06)
    )


@pytest.mark.slow
def test_ruler_is_150_mm_both_ways(printed):
    """The first and the last mark are 150 mm apart, along and across."""
    index = next(i for i, page in enumerate(printed[0]) if page.sheet.title == "Ruler")
    ink = printed[1][index] < 200
    rows, columns = np.flatnonzero(ink.mean(axis=1) > 0.3), np.flatnonzero(ink.mean(axis=0) > 0.2)
    edge = ink[rows[0] - 2 : rows[-1] + 3].any(axis=0)
    across = np.flatnonzero(edge)
    along = np.flatnonzero(ink[:, columns[0] - 2 : columns[-1] + 3].any(axis=1))
    assert (across[-1] - across[0]) / DOTS_PER_MM == pytest.approx(150.0, abs=0.4)
    assert (along[-1] - along[0]) / DOTS_PER_MM == pytest.approx(150.0, abs=0.4)
    assert len(pages_of(ruler(), "a4")) == 1


@pytest.mark.parametrize("paper", PAPERS_MM)
def test_pages_of_a_sheet_cover_it_and_overlap(paper, robot):
    """Each page fits the paper, adjacent pages share the overlap, and together they cover the drawing."""
    for sheet in (mat(robot), calibration_board(BoardSpec(9, 7, 0.03))):
        pages = pages_of(sheet, paper)
        assert max(page.corner_mm[0] + page.size_mm[0] for page in pages) == pytest.approx(sheet.width_mm)
        assert max(page.corner_mm[1] + page.size_mm[1] for page in pages) == pytest.approx(sheet.height_mm)
        for page in pages:
            assert np.all(np.add(page.size_mm, 20.0) <= np.add(page.paper_mm, 1e-6))
            if page.column:
                before = next(p for p in pages if p.row == page.row and p.column == page.column - 1)
                assert before.corner_mm[0] + before.size_mm[0] - page.corner_mm[0] == pytest.approx(OVERLAP_MM)


@pytest.mark.slow
def test_command_says_what_it_printed(guara, tmp_path: Path):
    """Number of pages per drawing, and positions of the crosses."""
    said = guara("targets", "-o", tmp_path / "t.pdf", "--board", "6x5", "--square", "0.025")
    assert said.code == 0 and "Checkerboard, 6 x 5 inner corners, 25 mm squares: 1 page\n" in said.out
    assert "(0.520, 0.250), (0.520, -0.250)" in said.out and (tmp_path / "t.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("arguments", "reported"),
    [
        (["-o", "t.txt"], "t.txt: it must end in .pdf"),
        (["-o", "t.pdf", "--board", "nine"], "--board is 'nine'; it must be COLUMNSxROWS"),
        (["-o", "t.pdf", "--board", "2x7"], "board has 2x7 inner corners and squares of 0.03 m; allowed: 3 ... 40"),
        (["-o", "t.pdf", "--pattern", "circles"], "'circles' is not one of 'checkerboard', 'charuco'"),
        (["-o", "t.pdf", "--square", "30"], "squares of 0.005 ... 0.1 m"),
        (["-o", "t.pdf", "--plates", "0;1"], "--plates is '0;1'; it must be heights in metres"),
        (["-o", "none/t.pdf"], "the folder none does not exist"),
        (["-o", "t.pdf", "--robot", "dog"], "dog"),
    ],
)
def test_wrong_options_are_refused(guara, tmp_path: Path, monkeypatch, arguments, reported):
    """Exit 2, one line, nothing written."""
    monkeypatch.chdir(tmp_path)
    said = guara("targets", *arguments)
    assert said.code == 2 and reported in said.err and said.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
