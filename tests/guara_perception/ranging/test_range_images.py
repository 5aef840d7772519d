"""Range images: eqs. 20 and 21 undo the central projection, pixels lie where docs/conventions.md says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.process import run_scan
from guara_perception.ranging.paper.equations import ortho_u, ortho_v
from guara_perception.ranging.range_images import COLUMNS, ROWS, range_images, to_floor
from guara_perception.ranging.stripe_points import ColumnPoints, StripePoints
from guara_perception.ranging.surface import surface_keys, surface_of
from guara_perception.terrain.assessment.raster import merge, rasterise
from guara_perception.terrain.layers.geometry import GridGeometry
from kinematics import RobotModel

EYE = np.array([0.4, 0.02, 0.5])
X, Y = (0.50, 0.95), (-0.27, 0.27)


@given(x=st.floats(0.4, 1.0), y=st.floats(-0.3, 0.3), z=st.floats(-0.1, 0.2))
@settings(max_examples=60, deadline=None, derandomize=True)
def test_ortho_undoes_the_central_projection(x: float, y: float, z: float) -> None:
    """A point projected onto the floor from the optical centre comes back by eqs. 20 and 21, exactly."""
    u, v = to_floor(*np.array([[x], [y], [z]]), EYE)
    np.testing.assert_allclose(ortho_v(u, z, EYE[2], EYE[0]), x, atol=1e-9)
    np.testing.assert_allclose(ortho_u(v, z, EYE[2], EYE[1]), y, atol=1e-9)


def test_projection_lies_on_the_ray_from_the_eye() -> None:
    """Eye, point and its projection are on one line."""
    point = np.array([0.7, -0.1, 0.08])
    floor = np.append(np.ravel(to_floor(*point[:, None], EYE)), 0.0)
    np.testing.assert_allclose(np.cross(point - EYE, floor - EYE), 0, atol=1e-12)


def block(x0: float, x1: float, y0: float, y1: float, h: float) -> dict[int, StripePoints]:
    """Stripes every 6 mm over the area with a block of height h."""
    stripes = {}
    y = np.linspace(Y[0] - 0.02, Y[1] + 0.02, 900)
    for k, x in enumerate(np.arange(X[0] - 0.006, X[1] + 0.01, 0.006)):
        on_top = (x0 <= x <= x1) & (y >= y0) & (y <= y1)
        points = np.column_stack((np.full(y.size, x), y, np.where(on_top, h, 0.0)))
        nothing = ColumnPoints(np.empty(0, np.int32), np.empty((0, 3)))
        ok = np.zeros(y.size, np.uint8)
        stripes[k] = StripePoints(points, np.full(y.size, 1e-8), np.full(y.size, 100.0), ok, nothing, nothing)
    return stripes


def test_pixels_of_the_orthorectified_image_lie_where_they_should() -> None:
    """A block fills the pixels of its own place, rows along x and columns along y; the floor is zero."""
    images = range_images(block(0.6, 0.7, 0.1, 0.2, 0.05), range(100), EYE, X, Y, 0.008)
    ortho = images.ortho_image_mm
    assert ortho.shape == (ROWS, COLUMNS) == (512, 640) and ortho.dtype == np.float32
    row, column = int((0.65 - X[0]) / 0.45 * ROWS), int((0.15 - Y[0]) / 0.54 * COLUMNS)
    np.testing.assert_allclose(ortho[row - 20 : row + 20, column - 20 : column + 20], 50, atol=1e-3)
    assert ortho[row, COLUMNS - 1 - column] == 0
    assert ortho[ROWS - 20, column] == 0


def test_perspective_image_shows_the_block_larger_and_away_from_the_nadir() -> None:
    """50 mm of 500: the block's far edge moves out by 1 / 0.9 about the nadir, as in Fig. 16."""
    images = range_images(block(0.6, 0.7, 0.1, 0.2, 0.05), range(100), EYE, X, Y, 0.008)
    perspective = images.range_image_mm
    y = 0.02 + (0.15 - 0.02) / 0.9
    column = int((y - Y[0]) / 0.54 * COLUMNS)
    x = X[0] + (np.flatnonzero(perspective[:, column] > 25) + 0.5) * 0.45 / ROWS
    assert abs(x.max() - (0.4 + (0.696 - 0.4) / 0.9)) < 0.007
    assert (images.ortho_image_mm > 25).sum() < (perspective > 25).sum()


def test_nothing_seen_gives_unknown_pictures() -> None:
    """No stripe: every pixel is NaN, and nobody can write the pictures."""
    images = range_images({}, range(3), EYE, X, Y, 0.008)
    assert np.isnan(images.ortho_image_mm).all() and np.isnan(images.range_image_mm).all()
    assert not images.ortho_image_mm.flags.writeable


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", "dark", "tilt"])
def test_pictures_are_those_of_all_samples_at_once(
    name: str, data: Path, calibration: gp.Calibration, robot: RobotModel
) -> None:
    """Recorded scans: the same pixels known, and the same heights, as from one cloud rasterised like a grid."""
    processor = run_scan(gp.open_scan(data / "scans" / name), calibration, robot)
    pattern, eye = processor.settings.pattern(processor.mode), processor.camera_position
    images = range_images(processor.points, pattern, eye, X, Y, processor.settings.join_height)
    keys = surface_keys(processor.points, pattern)
    pixel = min((X[1] - X[0]) / ROWS, (Y[1] - Y[0]) / COLUMNS)
    cloud = surface_of(processor.points, keys, pattern, processor.settings.join_height, pixel).points
    floor = np.stack([*to_floor(*cloud, eye), cloud[2]])
    for picture, points in ((images.ortho_image_mm, cloud), (images.range_image_mm, floor)):
        scale = np.array([ROWS / (X[1] - X[0]), COLUMNS / (Y[1] - Y[0]), 1.0])
        unit = GridGeometry((0.0, 0.0), 1.0, (COLUMNS, ROWS))
        scaled = (points.T - (X[0], Y[0], 0.0)) * scale
        whole = merge([rasterise(scaled, np.zeros(len(scaled)), unit)], unit).elevation.T * 1e3
        np.testing.assert_array_equal(np.isnan(picture), np.isnan(whole))
        np.testing.assert_allclose(picture, whole, atol=1e-5)
        assert np.isfinite(picture).mean() > 0.3
