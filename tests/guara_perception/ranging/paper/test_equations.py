"""Every equation of the paper against values worked out by hand, and the corrections against exact geometry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.ranging.paper import equations
from tests.thorough import examples

ALPHA = np.radians(30.0)


def test_eq_1_projects() -> None:
    """A = [[100, 0, 50], [0, 200, 40], [0, 0, 1]], P = (1, 2, 4): u = 100 / 4 + 50 = 75, v = 400 / 4 + 40 = 140."""
    matrix = equations.intrinsic_matrix(100, 200, 0, 50, 40)
    np.testing.assert_allclose(equations.project(matrix, np.array([1.0, 2.0, 4.0])), [75, 140])


def test_eq_1_skew() -> None:
    """Skew 10 adds 10 y / z to u."""
    matrix = equations.intrinsic_matrix(100, 200, 10, 50, 40)
    np.testing.assert_allclose(equations.project(matrix, np.array([1.0, 2.0, 4.0])), [80, 140])


def test_eqs_2_and_4_give_a_point_in_the_robots_frame() -> None:
    """The (4, 4) of eq. 4 does what eq. 2 does."""
    rotation, translation = equations.rotation_of_pitch(ALPHA), equations.translation_of_mount(0.4)
    point = np.array([0.1, -0.2, 0.5])
    by_matrix = equations.extrinsic_matrix(rotation, translation) @ np.append(point, 1)
    np.testing.assert_allclose(by_matrix[:3], equations.to_robot(rotation, translation, point))


def test_eq_3_undoes_eq_1_and_2() -> None:
    """A point projected and brought back at its own depth is itself, seen from the robot."""
    rotation, translation = equations.rotation_of_pitch(ALPHA), equations.translation_of_mount(0.4)
    matrix = equations.intrinsic_matrix(1000, 990, 0, 640, 512)
    point = np.array([0.1, -0.2, 0.5])
    back = equations.pixel_to_robot(rotation, translation, matrix, equations.project(matrix, point), rho=0.5)
    np.testing.assert_allclose(back, equations.to_robot(rotation, translation, point), atol=1e-12)


def test_eq_5_image_axes() -> None:
    """At 30 degrees: image right is the robot's left, image down forward and up, the axis forward and down."""
    rotation = equations.rotation_of_pitch(ALPHA)
    np.testing.assert_allclose(rotation @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(rotation @ [0, 1, 0], [np.cos(ALPHA), 0, np.sin(ALPHA)], atol=1e-12)
    np.testing.assert_allclose(rotation @ [0, 0, 1], [np.sin(ALPHA), 0, -np.cos(ALPHA)], atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_eq_6_translation() -> None:
    """The camera stands d ahead, at the height of the frame's origin."""
    np.testing.assert_array_equal(equations.translation_of_mount(0.2), [0.2, 0, 0])


def test_eq_7_distorts() -> None:
    """k = -0.2 at (0.3, 0.4), r^2 = 0.25: factor 0.95."""
    u, v = equations.distort(np.array(0.3), np.array(0.4), -0.2)
    np.testing.assert_allclose([u, v], [0.285, 0.38])


def test_eq_8_one_step_by_hand() -> None:
    """Literal: (0.285, 0.38) has r^2 = 0.225625, factor 1 - 0.045125."""
    u, v = equations.undistort(np.array(0.285), np.array(0.38), -0.2, literal=True)
    np.testing.assert_allclose([u, v], [0.285 / 0.954875, 0.38 / 0.954875])


@given(u=st.floats(-0.45, 0.45), v=st.floats(-0.45, 0.45), k=st.floats(-0.3, 0.2))
@settings(max_examples=examples(60), deadline=None, derandomize=True)
def test_eq_8_iterated_undoes_eq_7(u: float, v: float, k: float) -> None:
    """Iterated it is exact; one step is not, by up to 10 px at the corner for k = -0.2 and f = 1100."""
    distorted = equations.distort(np.array(u), np.array(v), k)
    np.testing.assert_allclose(equations.undistort(*distorted, k), (u, v), atol=1e-4)


def test_eq_8_in_one_step_misses_by_pixels() -> None:
    """r = 0.64, k = -0.2, f = 1100: 9.7 px."""
    distorted = equations.distort(np.array(0.64), np.array(0.0), -0.2)
    one_step, _ = equations.undistort(*distorted, -0.2, literal=True)
    assert abs(float(one_step) - 0.64) * 1100 == pytest.approx(9.7, abs=0.3)


COEFFICIENTS = np.array([2.0, 0.5, 10.0, -0.25, 3.0, 20.0, 0.001, 0.002, 1.0])


def test_eqs_9_and_10_by_hand() -> None:
    """u = 100, v = 50: below 1.2; x = (200 + 25 + 10) / 1.2, y = (-25 + 150 + 20) / 1.2."""
    u, v = np.array(100.0), np.array(50.0)
    assert equations.surface_x(COEFFICIENTS, u, v) == pytest.approx(235 / 1.2)
    assert equations.surface_y(COEFFICIENTS, u, v) == pytest.approx(145 / 1.2)


def test_eqs_11_and_12_hold_for_the_point_of_eqs_9_and_10() -> None:
    """The rows times a ... h give x and y."""
    x, y = 235 / 1.2, 145 / 1.2
    assert equations.x_row(100, 50, x) @ COEFFICIENTS[:8] == pytest.approx(x)
    assert equations.y_row(100, 50, y) @ COEFFICIENTS[:8] == pytest.approx(y)


def test_eq_13_finds_the_coefficients() -> None:
    """Four marks through eqs. 9 and 10 give the coefficients back."""
    pixels = np.array([(0.0, 0.0), (640.0, 10.0), (630.0, 500.0), (20.0, 480.0)])
    u, v = pixels.T
    points = np.column_stack((equations.surface_x(COEFFICIENTS, u, v), equations.surface_y(COEFFICIENTS, u, v)))
    np.testing.assert_allclose(equations.surface_coefficients(pixels, points), COEFFICIENTS, rtol=1e-8, atol=1e-9)


def test_eq_13_refuses_what_has_no_solution() -> None:
    """Marks on a line, or not four of them."""
    line = np.array([(0.0, 0.0), (1.0, 1.0), (2.0, 2.0), (0.0, 3.0)])
    with pytest.raises(gp.InvalidInput, match="on one line"):
        equations.surface_coefficients(line, line)
    with pytest.raises(gp.InvalidInput, match=r"four marks: pixels are \(3, 2\)"):
        equations.surface_coefficients(line[:3], line[:3])


def test_eqs_14_to_16_on_a_line() -> None:
    """f = 2, line through (y, z) = (1, 4) and (3, 2): halfway at z = 3 lies y = 2, seen at v = f y / z."""
    assert equations.focal_length(0.5, 4.0, 1.0) == equations.focal_length(3.0, 2.0, 3.0) == 2.0
    assert equations.line_y(3.0, 1.0, 4.0, 3.0, 2.0) == 2.0
    assert equations.line_residual(2 * 2.0 / 3.0, 3.0, 0.5, 4.0, 3.0, 2.0) == pytest.approx(0)
    assert equations.line_residual(1.0, 3.0, 0.5, 4.0, 3.0, 2.0) != pytest.approx(0)


def test_eqs_17_and_18_agree_and_give_the_point_of_the_line() -> None:
    """v = 4/3 is seen at z = 3; n = -20, d = -2, k = 4."""
    constants = equations.stripe_constants(0.5, 4.0, 3.0, 2.0)
    assert (constants.n, constants.d, constants.k) == (-20.0, -2.0, 4.0)
    assert equations.depth(4 / 3, 0.5, 4.0, 3.0, 2.0) == pytest.approx(3.0)
    np.testing.assert_allclose(equations.depth_from_constants(np.array([4 / 3, 0.5, 3.0]), constants), [3, 4, 2])


def test_eq_17_is_invariant_to_a_shift_of_v() -> None:
    """No principal point is needed: shifting all v changes no depth."""
    for shift in (-700.0, 33.0):
        assert equations.depth(4 / 3 + shift, 0.5 + shift, 4, 3 + shift, 2) == pytest.approx(3.0)


def test_eq_18_has_no_depth_at_its_singular_position() -> None:
    """At v d = k, and beyond it, where the depth would be negative."""
    constants = equations.stripe_constants(0.5, 4.0, 3.0, 2.0)
    assert np.isnan(equations.depth_from_constants(np.array([-2.0, -3.0]), constants)).all()


@pytest.mark.parametrize("arguments", [(1.0, 2.0, 3.0, 2.0), (1.0, 2.0, 1.0, 4.0)])
def test_eq_17_refuses_equal_heights_and_positions(arguments: tuple[float, float, float, float]) -> None:
    """Singular: one height twice, or a stripe that does not move."""
    with pytest.raises(gp.InvalidInput, match="two depths and two positions"):
        equations.stripe_constants(*arguments)


def test_eq_19_by_hand() -> None:
    """h_m = 0.5, z = 0.4: 0.1 when level, 0.3 when pitched by 60 degrees."""
    assert equations.height(np.array(0.4), 0.5) == pytest.approx(0.1)
    assert equations.height(np.array(0.4), 0.5, np.radians(60)) == pytest.approx(0.3)


def test_eqs_20_and_21_by_hand() -> None:
    """H = 500, h = 100, nadir (10, 20): a point at (110, 220) moves to (90, 180); on the floor nothing moves."""
    assert equations.ortho_u(np.array(110.0), np.array(100.0), 500, 10) == pytest.approx(90)
    assert equations.ortho_v(np.array(220.0), np.array(100.0), 500, 20) == pytest.approx(180)
    assert equations.ortho_u(np.array(110.0), np.array(0.0), 500, 10) == 110


@pytest.mark.parametrize(("h", "error"), [(20, 11.5), (50, 28.9), (100, 57.7)])
def test_eqs_20_and_21_about_the_image_centre_are_wrong_by_h_tan_alpha(h: float, error: float) -> None:
    """The image centre lies H tan(alpha) ahead of the nadir: every height is moved by h tan(alpha), at any v."""
    centre = 500 * np.tan(ALPHA)
    for v in (100.0, 400.0):
        about_nadir = equations.ortho_v(np.array(v), np.array(h), 500, 0.0)
        about_centre = equations.ortho_v(np.array(v), np.array(h), 500, centre)
        assert about_centre - about_nadir == pytest.approx(error, abs=0.06)
