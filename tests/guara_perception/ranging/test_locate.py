"""Triangulation and the paper's chain: exact where they should be, with known errors of the literal forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.calibration.calibration import CameraModel
from guara_perception.ranging.locate import TOLERANCE_PX, Locator, Triangulator, locator
from guara_perception.ranging.paper import Literal, PaperRangefinder, radial_coefficient
from guara_perception.ranging.scan_geometry import laser_origin
from tests.thorough import examples

SIZE = (640, 512)
MATRIX = np.array([[590.0, 0, 322.0], [0, 588.0, 250.0], [0, 0, 1]])
AREA = ((0.50, 0.95), (-0.27, 0.27))
MIRROR = np.array([0.60, 0.0, 0.47])
SMALL = (320, 256)
SMALL_MATRIX = np.array([[295.0, 0, 161.0], [0, 294.0, 125.0], [0, 0, 1]])


def camera(k1: float = -0.15, k2: float = 0.0) -> CameraModel:
    return CameraModel(SIZE, MATRIX, np.array([k1, k2, 0, 0, 0]))


def pose(pitch: float = 31.0) -> np.ndarray:
    """Camera half a metre above the floor, 0.4 m ahead of the origin."""
    c, s = np.cos(np.radians(pitch)), np.sin(np.radians(pitch))
    transform = np.eye(4)
    # Eq. 5: image right is the robot's left, image down forward and up, the axis forward and down.
    transform[:3] = [[0.0, c, s, 0.4], [1.0, 0.0, 0.0, 0.01], [0.0, s, -c, 0.5]]
    return transform


def laser_plane(lean: float, turn: float, transform: np.ndarray) -> np.ndarray:
    """Plane in the camera frame through the mirror, leaning forward by `lean`, turned about the vertical by `turn`."""
    across = np.array([np.cos(turn), np.sin(turn), 0.0])
    normal = np.cos(lean) * across + np.array([0, 0, np.sin(lean)])
    in_camera = transform[:3, :3].T @ normal
    return np.append(in_camera, -normal @ (MIRROR - transform[:3, 3]))


def seen(plane: np.ndarray, transform: np.ndarray, h: np.ndarray, lens: CameraModel) -> tuple[np.ndarray, np.ndarray]:
    """Points of a laser plane at heights h across the area, and where the camera sees them."""
    normal = transform[:3, :3] @ plane[:3]
    offset = plane[3] - normal @ transform[:3, 3]
    y = np.linspace(-0.2, 0.2, h.size)
    x = -(normal[1] * y + normal[2] * h + offset) / normal[0]
    points = np.column_stack((x, y, h))
    return points, lens.project((points - transform[:3, 3]) @ transform[:3, :3])


def points_of(method: Locator, plane: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Points (3, w) of a stripe at a row of every column."""
    return method.measure(plane, rows, np.zeros_like(rows))[0]


def locate_at(method: Locator, plane: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Points at sub-pixel columns: between the points of the two neighbouring columns on the same image line."""
    found = []
    for u, v in pixels:
        rows = np.full(SIZE[0], v)
        points = points_of(method, plane, rows).T
        low = int(np.floor(u))
        found.append(points[low] * (low + 1 - u) + points[low + 1] * (u - low))
    return np.array(found)


@given(lean=st.floats(-0.15, 0.5), turn=st.floats(-0.03, 0.03), pitch=st.floats(25, 38))
@settings(max_examples=examples(25), deadline=None, derandomize=True)
def test_triangulation_gives_the_point_back(lean: float, turn: float, pitch: float) -> None:
    """A point of the laser plane, projected with distortion, is found again to a hundredth of a millimetre."""
    transform, lens = pose(pitch), camera()
    plane = laser_plane(lean, turn, transform)
    points, pixels = seen(plane, transform, np.linspace(-0.02, 0.1, 7), lens)
    inside = (pixels > 2).all(axis=1) & (pixels[:, 0] < SIZE[0] - 3) & (pixels[:, 1] < SIZE[1] - 3)
    found = locate_at(Triangulator(lens, transform), plane, pixels[inside])
    np.testing.assert_allclose(found, points[inside], atol=1e-5)


@given(lean=st.floats(-0.15, 0.5), turn=st.floats(-0.03, 0.03), pitch=st.floats(25, 38))
@settings(max_examples=examples(25), deadline=None, derandomize=True)
def test_the_papers_chain_is_exact_where_its_lens_is(lean: float, turn: float, pitch: float) -> None:
    """With one radial coefficient, eqs. 7 to 21 about the nadir equal triangulation, also for a turned stripe."""
    transform, lens = pose(pitch), camera()
    plane = laser_plane(lean, turn, transform)
    rows = np.linspace(60, 450, SIZE[0])
    paper = PaperRangefinder(lens, transform, AREA, Literal())
    exact = points_of(Triangulator(lens, transform), plane, rows).T
    usable = np.isfinite(exact[:, 2]) & (exact[:, 2] > -0.1) & (exact[:, 2] < 0.2)
    np.testing.assert_allclose(paper.points(plane, rows).T[usable], exact[usable], atol=2e-6)


def test_one_radial_coefficient_is_found() -> None:
    """The fitted k is the lens' own k1 when it has no other coefficient."""
    assert radial_coefficient(camera(-0.15)) == pytest.approx(-0.15, abs=1e-5)
    assert radial_coefficient(camera(0.0)) == pytest.approx(0.0, abs=1e-9)


def test_literal_lens_and_literal_ortho_miss_by_millimetres() -> None:
    """One step of eq. 8 costs height at the picture's edge; the image centre moves an object by h tan(alpha)."""
    transform, lens = pose(), camera(-0.2)
    plane = laser_plane(-0.15, 0.0, transform)
    points, pixels = seen(plane, transform, np.full(5, 0.05), lens)
    right = locate_at(PaperRangefinder(lens, transform, AREA, Literal()), plane, pixels)
    lens_only = locate_at(PaperRangefinder(lens, transform, AREA, Literal(lens=True)), plane, pixels)
    ortho_only = locate_at(PaperRangefinder(lens, transform, AREA, Literal(ortho=True)), plane, pixels)
    np.testing.assert_allclose(right, points, atol=2e-5)
    assert np.abs(lens_only[:, 2] - 0.05).max() > 5e-4
    centre_ahead_of_nadir = 0.725 - 0.4
    np.testing.assert_allclose(ortho_only[:, 0] - points[:, 0], 0.05 / 0.5 * centre_ahead_of_nadir, atol=1e-4)


@pytest.mark.parametrize("literal", [None, Literal()])
def test_sigma_of_the_height_is_its_finite_difference(literal: Literal | None) -> None:
    """Moving the stripe by a tenth of a pixel changes the height by a tenth of the stated sigma for one pixel."""
    transform, lens = pose(), camera()
    plane = laser_plane(0.3, 0.01, transform)
    method = locator(literal, lens, transform, AREA)
    rows = np.full(SIZE[0], 300.0)
    points, sigma = method.measure(plane, rows, np.ones(SIZE[0]))
    np.testing.assert_array_equal(points, points_of(method, plane, rows))
    moved = np.abs(points_of(method, plane, rows + 0.05)[2] - points_of(method, plane, rows - 0.05)[2]) / 0.1
    np.testing.assert_allclose(sigma, moved, rtol=0.06)


def test_no_position_no_point_and_no_grazing_ray() -> None:
    """NaN rows give NaN points; a laser plane through the camera's own rays gives none."""
    transform, lens = pose(), camera()
    rows = np.full(SIZE[0], np.nan)
    rows[7] = 200.0
    points = points_of(Triangulator(lens, transform), laser_plane(0.2, 0, transform), rows).T
    assert np.isfinite(points[7]).all() and np.isnan(np.delete(points, 7, axis=0)).all()
    ray = lens.rays([[7.0, 200.0]])[0]
    along = np.cross(ray, [1.0, 0, 0])
    plane_of_ray = np.append(along / np.linalg.norm(along), -0.001)
    grazing, sigma = Triangulator(lens, np.eye(4)).measure(plane_of_ray, rows, np.ones(SIZE[0]))
    assert np.isnan(grazing).all() and np.isnan(sigma).all()


def test_laser_plane_behind_the_camera_gives_no_point() -> None:
    """A negative depth is no point."""
    lens = camera()
    points = points_of(Triangulator(lens, np.eye(4)), np.array([0.0, 0, 1.0, 1.0]), np.full(SIZE[0], 200.0))
    assert np.isnan(points).all()


def test_laser_plane_origin_is_on_the_mirror_axis() -> None:
    """All laser planes pass through the mirror: the point of its axis nearest to the camera is found."""
    transform = pose()
    planes = []
    for lean in np.linspace(-0.1, 0.4, 9):
        normal = np.array([np.cos(lean), 0, np.sin(lean)])
        planes.append(np.append(normal, -normal @ MIRROR))
    np.testing.assert_allclose(laser_origin(np.array(planes), transform[:3, 3]), [0.6, 0.01, 0.47], atol=1e-9)


@pytest.mark.parametrize("literal", [None, Literal()])
def test_stripes_together_are_the_stripes_alone(literal: Literal | None) -> None:
    """Several laser planes together: each gives what it gives alone, bit for bit."""
    transform, lens = pose(), camera()
    method = locator(literal, lens, transform, AREA)
    planes = np.array([laser_plane(lean, turn, transform) for lean, turn in ((-0.1, 0.0), (0.2, 0.01), (0.4, -0.02))])
    rows = np.random.default_rng(4).uniform(100, 400, (3, SIZE[0]))
    rows[1, 30:60] = np.nan
    points, sigma = method.measure(planes, rows, np.full(rows.shape, 0.1))
    for k in range(3):
        alone, sigma_alone = method.measure(planes[k], rows[k], np.full(SIZE[0], 0.1))
        np.testing.assert_array_equal(points[:, k], alone)
        np.testing.assert_array_equal(sigma[k], sigma_alone)


def rays_of(camera: CameraModel, rows: np.ndarray) -> np.ndarray:
    """Rays (2, w) of a triangulator at a row of every column: where they meet the plane z = 1 of the camera."""
    return points_of(Triangulator(camera, np.eye(4)), np.array([0.0, 0.0, 1.0, -1.0]), rows)[:2]


def worst_error_px(camera: CameraModel, seed: int = 0) -> float:
    """Largest difference from the exact rays at a random row of every column."""
    rows = np.random.default_rng(seed).uniform(0, SMALL[1] - 1, SMALL[0])
    exact = camera.rays(np.column_stack((np.arange(SMALL[0]), rows)))[:, :2].T
    return float(np.abs(rays_of(camera, rows) - exact).max() * SMALL_MATRIX[0, 0])


@given(
    k1=st.floats(-0.26, 0.2),
    k2=st.floats(0.0, 0.08),
    p=st.tuples(st.floats(-2e-3, 2e-3), st.floats(-2e-3, 2e-3)),
    seed=st.integers(0, 1000),
)
@settings(max_examples=examples(40), deadline=None, derandomize=True)
def test_rays_are_those_of_the_camera(k1: float, k2: float, p: tuple[float, float], seed: int) -> None:
    """Any typical lens: within a few millionths of a pixel, fitted or not."""
    assert worst_error_px(CameraModel(SMALL, SMALL_MATRIX, np.array([k1, k2, *p, 0.0])), seed) < 3 * TOLERANCE_PX


@pytest.mark.parametrize("k1", [0.0, -0.22, -0.6])
def test_lens_that_no_polynomial_fits_is_computed_exactly(k1: float) -> None:
    """Polynomials fit typical lenses; rays of a strong one, which folds inside the picture, are computed exactly."""
    camera = CameraModel(SMALL, SMALL_MATRIX, np.array([k1, 0, 0, 0, 0]))
    assert (Triangulator(camera, np.eye(4))._coefficients is None) == (k1 == -0.6)
    assert worst_error_px(camera) < TOLERANCE_PX


@pytest.mark.parametrize("k1", [-0.2, -0.6])
def test_missing_rows(k1: float) -> None:
    """A NaN row has no ray, with or without polynomials."""
    rows = np.linspace(100.0, 140.0, SMALL[0])
    rows[40:50] = np.nan
    rays = rays_of(CameraModel(SMALL, SMALL_MATRIX, np.array([k1, 0, 0, 0, 0])), rows)
    assert np.isnan(rays[:, 40:50]).all() and np.isfinite(np.delete(rays, np.s_[40:50], axis=1)).all()
