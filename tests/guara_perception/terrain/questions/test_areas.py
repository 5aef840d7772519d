"""Connected cells and depths without OpenCV, compared with OpenCV and with their definition."""

import cv2
import numpy as np
import pytest

from guara_perception.terrain.layers.hazard import with_neighbours
from guara_perception.terrain.questions.areas import Depth, connected_to
from guara_perception.terrain.questions.convex import _hull
from tests.thorough import examples


def some_cells(seed: int) -> np.ndarray:
    """Mask of any size with blobs, sometimes with all or almost no cells."""
    rng = np.random.default_rng(seed)
    ny, nx = rng.integers(1, 40, 2)
    return rng.random((ny, nx)) < rng.choice([0.02, 0.5, 0.65, 0.9, 1.0])


@pytest.mark.parametrize("seed", range(examples(100)))
def test_connected_cells_are_those_that_opencv_fills(seed: int):
    """Cells are connected by their sides, not by their corners."""
    cells = some_cells(seed)
    for iy, ix in np.argwhere(cells)[:: max(cells.sum() // 5, 1)].tolist():
        filled = cells.astype(np.uint8)
        cv2.floodFill(filled, None, (ix, iy), 2, flags=4)
        assert np.array_equal(connected_to(cells, iy, ix), filled == 2)


@pytest.mark.parametrize("seed", range(examples(100)))
def test_neighbours_are_those_of_a_dilation(seed: int):
    """All eight neighbours, and nothing across the border."""
    cells = some_cells(seed)
    assert np.array_equal(with_neighbours(cells), cv2.dilate(cells.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)


def squares_of(area: np.ndarray) -> np.ndarray:
    """Squared distances by their definition."""
    padded = np.pad(area, 1)
    outside = np.argwhere(~padded)
    iy, ix = np.indices(padded.shape)
    squares = (iy[..., None] - outside[:, 0]) ** 2 + (ix[..., None] - outside[:, 1]) ** 2
    return squares.min(axis=-1)[1:-1, 1:-1]


@pytest.mark.parametrize("seed", range(examples(60)))
def test_depth_is_the_distance_from_what_is_outside_however_much_leaves(seed: int):
    """Exact at first, and after each removal."""
    rng = np.random.default_rng(seed)
    area = some_cells(seed)
    depth = Depth(area)
    for _ in range(4):
        assert np.array_equal(depth.squares, squares_of(area))
        iy, ix, cells = depth.deepest()
        assert cells**2 == pytest.approx(squares_of(area).max()) and depth.squares[iy, ix] == squares_of(area).max()
        row, column = (int(rng.integers(0, size)) for size in area.shape)
        part = area[row : row + 7, column : column + 5]
        leaving = rng.random(part.shape) < 0.7
        depth.remove(slice(row, row + 7), slice(column, column + 5), leaving)
        part &= ~leaving


@pytest.mark.parametrize("seed", range(examples(100)))
def test_hull_is_that_of_opencv(seed: int):
    """Corners counter-clockwise around the origin, each once; duplicate and inner points are omitted."""
    rng = np.random.default_rng(seed)
    angle = np.concatenate((rng.uniform(0, 6.28, int(rng.integers(0, 30))), [0.1, 2.0, 4.5]))
    points = (rng.choice([1.0, rng.uniform(0.5, 3)], angle.size) * np.array([np.cos(angle), np.sin(angle)])).T
    points = np.concatenate((points, points[::3], 0.5 * points[::4])).astype(np.float32)
    ours = points[_hull(points.astype(np.float64))]
    opencv = cv2.convexHull(points)[:, 0]
    assert {tuple(point) for point in ours.tolist()} == {tuple(point) for point in opencv.tolist()}
    following = np.roll(ours, -1, axis=0)
    assert (ours[:, 0] * following[:, 1] > ours[:, 1] * following[:, 0]).all()
