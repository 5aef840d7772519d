"""Lines that the scene is drawn with, and the camera's picture for the page."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from guara_perception.images import for_screen, to_rgb
from guara_perception.view.controls import PICTURE_WIDTH_PX
from guara_perception.view.scene_drawing import OUTLINE_M, outline, prism, simplify, track


def test_a_prism_has_all_its_edges() -> None:
    """Of a triangle: its outline at both heights, and the three upright edges."""
    outline = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]])
    edges = prism(outline, -1.0, 3.0)
    assert edges.shape == (9, 2, 3)
    lengths = np.sort(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1))
    np.testing.assert_allclose(lengths, [1, 1, 2, 2, np.sqrt(5), np.sqrt(5), 4, 4, 4], rtol=1e-6)
    assert set(edges[..., 2].ravel()) == {-1.0, 3.0}


def test_the_staircase_of_an_outline_is_left_out() -> None:
    """A diagonal that follows the edges of cells becomes a straight line near them; a square stays a square."""
    cell = 0.005
    staircase = np.array([*((i * cell, j * cell) for i in range(20) for j in (i, i + 1)), (0.0, 20 * cell)])
    corners = simplify(staircase)
    assert len(corners) <= 5
    polygon = corners.astype(np.float32)[:, None]
    assert max(abs(cv2.pointPolygonTest(polygon, point, True)) for point in staircase.tolist()) <= OUTLINE_M + 1e-6
    square = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]])
    np.testing.assert_allclose(simplify(square), square, atol=1e-7)
    tiny = square * cell
    assert len(simplify(tiny)) == 4


def test_an_outline_is_closed_and_lies_over_the_ground() -> None:
    """As many sides as corners, each from one corner to the next and above both."""
    corners = np.array([[0.0, 0.0, 0.1], [0.2, 0.0, 0.1], [0.1, 0.3, 0.2]])
    sides = outline(corners)
    assert sides.shape == (3, 2, 3)
    np.testing.assert_allclose(sides[:, 1], np.roll(sides[:, 0], -1, axis=0))
    np.testing.assert_allclose(sides[:, 0, :2], corners[:, :2])
    assert (sides[:, 0, 2] > corners[:, 2]).all() and (sides[:, 1, 2] > np.roll(corners[:, 2], -1)).all()


def test_the_way_has_a_tick_at_each_pause() -> None:
    """Two lines between three poses, and one across at each."""
    poses = [np.eye(4) for _ in range(3)]
    for number, pose in enumerate(poses):
        pose[0, 3] = 0.1 * number
    lines = track(poses)
    assert lines.shape == (5, 2, 3)
    np.testing.assert_allclose(np.linalg.norm(lines[:2, 1] - lines[:2, 0], axis=1), 0.1, rtol=1e-5)
    np.testing.assert_allclose(lines[2:, 1, 1] - lines[2:, 0, 1], 0.03, rtol=1e-5)


@pytest.mark.parametrize("shape", [(512, 640, 3), (512, 640), (50, 60, 3)])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_pictures_of_every_camera_are_shown(shape: tuple[int, ...], kind: type) -> None:
    """BGR becomes RGB, grey stays grey, of 16 bits the upper 8 are kept, and none is wider than the panel."""
    image = np.zeros(shape, kind)
    image[..., 0 if len(shape) == 3 else slice(None)] = np.iinfo(kind).max
    shown = to_rgb(for_screen(image, PICTURE_WIDTH_PX))
    assert shown.dtype == np.uint8 and shown.shape[1] == min(PICTURE_WIDTH_PX, shape[1]) and shown.shape[2] == 3
    assert tuple(shown[5, 5]) == ((0, 0, 255) if len(shape) == 3 else (255, 255, 255))
