"""Tests of the lines of the scene, and of the camera's picture for the page."""

from __future__ import annotations

import numpy as np
import pytest

from guara_perception.view.controls import PICTURE_WIDTH_PX, for_page
from guara_perception.view.scene_drawing import outline, plain, prism, way


def test_a_prism_has_all_its_edges() -> None:
    """Outline at both levels and the uprights between, of a triangle."""
    outline = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]])
    edges = prism(outline, -1.0, 3.0)
    assert edges.shape == (9, 2, 3)
    lengths = np.sort(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1))
    np.testing.assert_allclose(lengths, [1, 1, 2, 2, np.sqrt(5), np.sqrt(5), 4, 4, 4], rtol=1e-6)
    assert set(edges[..., 2].ravel()) == {-1.0, 3.0}


def test_the_steps_of_an_outline_are_left_out() -> None:
    """A slope along cells becomes a line that stays within a cell and a bit; a square stays one."""
    cell = 0.005
    steps = [(i * cell, j * cell) for i in range(20) for j in (i, i + 1)]
    corners = plain(np.array([*steps, (0.0, 20 * cell)]))
    assert len(corners) <= 5
    square = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]])
    np.testing.assert_allclose(plain(square), square, atol=1e-7)
    tiny = square * cell
    assert len(plain(tiny)) == 4


def test_an_outline_is_closed_and_lies_over_the_ground() -> None:
    """As many sides as corners, each from one corner to the next."""
    corners = np.array([[0.0, 0.0, 0.1], [0.2, 0.0, 0.1], [0.1, 0.3, 0.2]])
    sides = outline(corners)
    assert sides.shape == (3, 2, 3)
    np.testing.assert_allclose(sides[:, 1], np.roll(sides[:, 0], -1, axis=0))
    np.testing.assert_allclose(sides[:, 0, :2], corners[:, :2])
    assert (sides[:, 0, 2] > corners[:, 2]).all()


def test_the_way_has_a_tick_at_each_pause() -> None:
    """Two lines between three places, and one across at each."""
    poses = [np.eye(4) for _ in range(3)]
    for number, pose in enumerate(poses):
        pose[0, 3] = 0.1 * number
    lines = way(poses)
    assert lines.shape == (5, 2, 3)
    np.testing.assert_allclose(np.linalg.norm(lines[:2, 1] - lines[:2, 0], axis=1), 0.1, rtol=1e-5)
    np.testing.assert_allclose(lines[2:, 1, 1] - lines[2:, 0, 1], 0.03, rtol=1e-5)


@pytest.mark.parametrize("shape", [(512, 640, 3), (512, 640), (50, 60, 3)])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_pictures_of_every_camera_are_shown(shape: tuple[int, ...], kind: type) -> None:
    """Colour from BGR, grey as grey, 16 bits by their upper ones, no wider than the panel."""
    image = np.zeros(shape, kind)
    image[..., 0 if len(shape) == 3 else slice(None)] = np.iinfo(kind).max
    shown = for_page(image)
    assert shown.dtype == np.uint8 and shown.shape[1] == min(PICTURE_WIDTH_PX, shape[1]) and shown.shape[2] == 3
    assert tuple(shown[5, 5]) == ((0, 0, 255) if len(shape) == 3 else (255, 255, 255))
