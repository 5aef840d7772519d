"""Range images: eqs. 20 and 21 undo the central projection, pixels lie where docs/conventions.md says."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.arrays import Float
from guara_perception.ranging.paper import ortho_u, ortho_v
from guara_perception.ranging.stripe_points import ColumnPoints, StripePoints
from guara_perception.ranging.surface import OPEN_END_M, surface_keys, surface_lines
from guara_perception.scanning.pictures import COLUMNS, LARGEST_STRETCH, MOST_BETWEEN, ROWS, range_images
from guara_perception.scanning.process import run_scan
from guara_perception.terrain.assessment.raster import ROUNDING, TOP_LAYER_M
from kinematics import RobotModel
from tests.thorough import examples, further

OPTICAL_CENTRE = np.array([0.4, 0.02, 0.5])
X, Y = (0.50, 0.95), (-0.27, 0.27)


def to_floor(x: Float, y: Float, height: Float, optical_centre: Float) -> tuple[Float, Float]:
    """Points at which rays from the optical centre through points meet the floor, by the inverse of eqs. 20 and 21.

    With the nadir (u0', v0') below the optical centre and H its height they read
    ortho = (perspective - nadir) (H - h) / H + nadir.
    """
    stretch = optical_centre[2] / (optical_centre[2] - height)
    return (x - optical_centre[0]) * stretch + optical_centre[0], (y - optical_centre[1]) * stretch + optical_centre[1]


@given(x=st.floats(0.4, 1.0), y=st.floats(-0.3, 0.3), z=st.floats(-0.1, 0.2))
@settings(max_examples=examples(60), deadline=None, derandomize=True)
def test_ortho_undoes_the_central_projection(x: float, y: float, z: float) -> None:
    """A point projected onto the floor from the optical centre comes back by eqs. 20 and 21, exactly."""
    u, v = to_floor(*np.array([[x], [y], [z]]), OPTICAL_CENTRE)
    np.testing.assert_allclose(ortho_v(u, z, OPTICAL_CENTRE[2], OPTICAL_CENTRE[0]), x, atol=1e-9)
    np.testing.assert_allclose(ortho_u(v, z, OPTICAL_CENTRE[2], OPTICAL_CENTRE[1]), y, atol=1e-9)


def test_projection_lies_on_the_ray_from_the_optical_centre() -> None:
    """Optical centre, point and projection are on one line."""
    point = np.array([0.7, -0.1, 0.08])
    floor = np.append(np.ravel(to_floor(*point[:, None], OPTICAL_CENTRE)), 0.0)
    np.testing.assert_allclose(np.cross(point - OPTICAL_CENTRE, floor - OPTICAL_CENTRE), 0, atol=1e-12)


def block(x0: float, x1: float, y0: float, y1: float, h: float) -> dict[int, StripePoints]:
    """Stripes every 6 mm over the area with a block of height h."""
    stripes = {}
    y = np.linspace(Y[0] - 0.02, Y[1] + 0.02, 900)
    for k, x in enumerate(np.arange(X[0] - 0.006, X[1] + 0.01, 0.006)):
        on_top = (x0 <= x <= x1) & (y >= y0) & (y <= y1)
        points = np.column_stack((np.full(y.size, x), y, np.where(on_top, h, 0.0)))
        nothing = ColumnPoints(np.empty(0, np.int32), np.empty((0, 3), np.float32))
        ok = np.zeros(y.size, np.uint8)
        single, ones = points.astype(np.float32), np.ones(y.size, np.float32)
        stripes[k] = StripePoints(single, 1e-8 * ones, 100 * ones, ok, nothing, nothing)
    return stripes


def test_pixels_of_the_orthorectified_image_lie_where_they_should() -> None:
    """A block fills the pixels of its own position, rows along x and columns along y; the floor is zero."""
    images = range_images(block(0.6, 0.7, 0.1, 0.2, 0.05), range(100), OPTICAL_CENTRE, X, Y, 0.008)
    ortho = images["ortho_image_mm"]
    assert ortho.shape == (ROWS, COLUMNS) == (512, 640) and ortho.dtype == np.float32
    row, column = int((0.65 - X[0]) / 0.45 * ROWS), int((0.15 - Y[0]) / 0.54 * COLUMNS)
    np.testing.assert_allclose(ortho[row - 20 : row + 20, column - 20 : column + 20], 50, atol=1e-3)
    assert ortho[row, COLUMNS - 1 - column] == 0
    assert ortho[ROWS - 20, column] == 0


def test_perspective_image_shows_the_block_larger_and_away_from_the_nadir() -> None:
    """50 mm of 500: the block's far edge moves out by 1 / 0.9 about the nadir, as in Fig. 16."""
    images = range_images(block(0.6, 0.7, 0.1, 0.2, 0.05), range(100), OPTICAL_CENTRE, X, Y, 0.008)
    perspective = images["range_image_mm"]
    y = 0.02 + (0.15 - 0.02) / 0.9
    column = int((y - Y[0]) / 0.54 * COLUMNS)
    x = X[0] + (np.flatnonzero(perspective[:, column] > 25) + 0.5) * 0.45 / ROWS
    assert abs(x.max() - (0.4 + (0.696 - 0.4) / 0.9)) < 0.007
    assert (images["ortho_image_mm"] > 25).sum() < (perspective > 25).sum()


def test_nothing_seen_gives_unknown_pictures() -> None:
    """Without stripes, every pixel is NaN."""
    images = range_images({}, range(3), OPTICAL_CENTRE, X, Y, 0.008)
    assert np.isnan(images["ortho_image_mm"]).all() and np.isnan(images["range_image_mm"]).all()


def test_ground_between_neighbouring_image_columns_is_filled_and_a_gap_is_not() -> None:
    """Columns three pixels apart: all pixels between them are known and lie on the slope; those in a gap are not."""
    y = np.arange(Y[0] - 0.01, Y[1] + 0.01, 0.0025)
    is_gap = np.abs(y - 0.1) < 0.006
    nothing = ColumnPoints(np.empty(0, np.int32), np.empty((0, 3), np.float32))
    stripes = {}
    for k, x in enumerate(np.arange(X[0] - 0.006, X[1] + 0.01, 0.006)):
        points = np.column_stack((np.full(y.size, x), y, np.where(is_gap, np.nan, 0.1 * (x - X[0]) + 0.05 * y)))
        ok = np.zeros(y.size, np.uint8)
        single, ones = points.astype(np.float32), np.ones(y.size, np.float32)
        stripes[k] = StripePoints(single, 1e-8 * ones, 100 * ones, ok, nothing, nothing)
    ortho = range_images(stripes, range(100), OPTICAL_CENTRE, X, Y, 0.008)["ortho_image_mm"][2:-8]
    row, column = np.mgrid[2 : ROWS - 8, :COLUMNS] + 0.5
    pixel_x, pixel_y = X[0] + row * (X[1] - X[0]) / ROWS, Y[0] + column * (Y[1] - Y[0]) / COLUMNS
    in_gap = (pixel_y > y[is_gap].min() - 0.0015) & (pixel_y < y[is_gap].max() + 0.0015)
    assert np.isnan(ortho[in_gap]).all()
    beside = np.abs(pixel_y - 0.1) > 0.0105
    slope = 1e3 * (0.1 * (pixel_x - X[0]) + 0.05 * pixel_y)
    np.testing.assert_allclose(ortho[beside], slope[beside], atol=0.05)


def plain(
    stripes: Mapping[int, StripePoints], pattern: range, optical_centre: Float, join_height: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Both pictures (ROWS, COLUMNS) [mm] by the definition: every sample at once, those of the top layer averaged.

    Between the lines of neighbouring image columns lie others, so near that no pixel is left out.
    """
    pixel_size = min((X[1] - X[0]) / ROWS, (Y[1] - Y[0]) / COLUMNS)
    apart = max(
        (float(abs(step)) for s in stripes.values() for step in np.diff(s.points[:, 1]) if step == step), default=0.0
    )
    parts = min(max(math.ceil(apart / ((Y[1] - Y[0]) / COLUMNS / LARGEST_STRETCH)), 1), MOST_BETWEEN + 1)
    samples = []
    for lines, followed in surface_lines(stripes, surface_keys(stripes, pattern), pattern, join_height, pixel_size):
        both = np.stack((lines.first, lines.difference)).transpose(2, 0, 1)
        share = (np.arange(lines.number) + 0.5) / lines.number
        between = [(k, k + 1, part / parts) for k in followed for part in range(1, parts)]
        for one, other, way in [(k, k, 0.0) for k in range(len(both))] + between:
            begin, vector = both[one] * (1 - way) + both[other] * way
            cut = min(OPEN_END_M / max(np.hypot(*vector[:2]), 1e-9), 0.5)
            low = cut if lines.opens[one] or lines.opens[other] else 0.0
            high = 1 - cut if lines.closes[one] or lines.closes[other] else 1.0
            kept = share[(share >= low) & (share <= high), None]
            samples.append(begin + kept * vector)
    cloud = np.concatenate([np.empty((0, 3)), *samples]).T
    pictures = []
    for x, y in (cloud[:2], to_floor(*cloud, optical_centre)):
        row = np.floor((x - X[0]) / (X[1] - X[0]) * ROWS + ROUNDING).astype(int)
        column = np.floor((y - Y[0]) / (Y[1] - Y[0]) * COLUMNS + ROUNDING).astype(int)
        inside = (row >= 0) & (row < ROWS) & (column >= 0) & (column < COLUMNS)
        pixel, height = row[inside] * COLUMNS + column[inside], cloud[2, inside]
        highest = np.full(ROWS * COLUMNS, -np.inf)
        np.maximum.at(highest, pixel, height)
        is_top = height > highest[pixel] - TOP_LAYER_M
        total, count = np.zeros((2, ROWS * COLUMNS))
        np.add.at(total, pixel[is_top], height[is_top])
        np.add.at(count, pixel[is_top], 1)
        with np.errstate(invalid="ignore"):
            pictures.append((total / count * 1e3).reshape(ROWS, COLUMNS))
    return pictures[0], pictures[1]


def assert_plain(
    images: Mapping[str, npt.NDArray[np.float32]], reference: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
) -> None:
    """The same pixels known, and the same heights; a sample on the border of two pixels falls into either."""
    for picture, whole in zip((images["ortho_image_mm"], images["range_image_mm"]), reference, strict=True):
        alike = np.isclose(picture, whole, rtol=0, atol=1e-5, equal_nan=True)
        assert np.count_nonzero(~alike) <= 20


@given(
    seed=st.integers(0, 10_000),
    roughness=st.sampled_from([0.0, 0.0005, 0.002]),
    step=st.sampled_from([0.0, 0.003, 0.06, -0.05]),
    first_x=st.floats(0.42, 0.9),
    spacing=st.sampled_from([-0.002, 0.001, 0.006, 0.03]),
    optical_centre=st.tuples(st.floats(0.2, 0.6), st.floats(-0.4, 0.4), st.sampled_from([0.08, 0.3, 0.6])),
    lost=st.frozensets(st.integers(0, 8), max_size=3),
)
@settings(max_examples=examples(25), deadline=None, derandomize=True)
def test_pictures_of_any_ground_are_those_by_the_definition(
    seed: int,
    roughness: float,
    step: float,
    first_x: float,
    spacing: float,
    optical_centre: tuple[float, float, float],
    lost: frozenset[int],
) -> None:
    """Rough ground, walls, overhangs, gaps, weak returns and lost stripes, seen from anywhere, beyond the edges too."""
    random = np.random.default_rng(seed)
    stripes = {}
    for k in sorted(set(range(9)) - lost):
        y = np.linspace(Y[0] - random.uniform(-0.1, 0.2), Y[1] + random.uniform(-0.1, 0.2), 300)
        x = first_x + k * spacing + 0.02 * y
        z = np.where((y > -0.1) & (y < 0.1) & (k > 2), step, 0.0) + random.normal(0, roughness + 1e-12, y.size)
        points = np.column_stack((x, y, z))
        points[random.random(y.size) < 0.1] = np.nan
        nothing = ColumnPoints(np.empty(0, np.int32), np.empty((0, 3), np.float32))
        strength = random.uniform(20, 100, y.size)
        single, variance = points.astype(np.float32), np.full(y.size, 1e-8, np.float32)
        ok = np.zeros(y.size, np.uint8)
        stripes[k] = StripePoints(single, variance, strength.astype(np.float32), ok, nothing, nothing)
    images = range_images(stripes, range(9), np.array(optical_centre), X, Y, 0.008)
    assert_plain(images, plain(stripes, range(9), np.array(optical_centre), 0.008))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tilt", *further("paper", "dark")])
def test_pictures_of_recorded_scans_are_those_by_the_definition(
    name: str, data: Path, calibration: gp.Calibration, robot: RobotModel
) -> None:
    """Recorded scans: the same pixels known, and the same heights, and enough of them."""
    processor = run_scan(gp.open_scan(data / "scans" / name), calibration, robot)
    pattern, optical_centre, join_height = (
        processor.settings.pattern(processor.mode),
        processor.camera_position,
        processor.settings.join_height,
    )
    images = range_images(processor.points, pattern, optical_centre, X, Y, join_height)
    assert_plain(images, plain(processor.points, pattern, optical_centre, join_height))
    assert np.isfinite(images["ortho_image_mm"]).mean() > 0.3 and np.isfinite(images["range_image_mm"]).mean() > 0.3
