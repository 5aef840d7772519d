"""Equations of the paper's chain against values worked out by hand, and the corrections against exact geometry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.ranging import paper
from tests.thorough import examples

ALPHA = np.radians(30.0)


def distort(u: float, v: float, k: float) -> tuple[np.ndarray, np.ndarray]:
    """Radial distortion with one coefficient, eq. 7: distortion-free to distorted."""
    factor = 1 + k * (u**2 + v**2)
    return np.asarray(u * factor), np.asarray(v * factor)


def test_eq_8_one_step_by_hand() -> None:
    """Literal: (0.285, 0.38) has r^2 = 0.225625, factor 1 - 0.045125."""
    u, v = paper.undistort(np.array(0.285), np.array(0.38), -0.2, literal=True)
    np.testing.assert_allclose([u, v], [0.285 / 0.954875, 0.38 / 0.954875])


@given(u=st.floats(-0.45, 0.45), v=st.floats(-0.45, 0.45), k=st.floats(-0.3, 0.2))
@settings(max_examples=examples(60), deadline=None, derandomize=True)
def test_eq_8_iterated_undoes_eq_7(u: float, v: float, k: float) -> None:
    """Iterated it is exact; one step is not, by up to 10 px at the corner for k = -0.2 and f = 1100."""
    distorted = distort(u, v, k)
    np.testing.assert_allclose(paper.undistort(*distorted, k), (u, v), atol=1e-4)


def test_eq_8_in_one_step_misses_by_pixels() -> None:
    """r = 0.64, k = -0.2, f = 1100: 9.7 px."""
    distorted = distort(0.64, 0.0, -0.2)
    one_step, _ = paper.undistort(*distorted, -0.2, literal=True)
    assert abs(float(one_step) - 0.64) * 1100 == pytest.approx(9.7, abs=0.3)


COEFFICIENTS = np.array([2.0, 0.5, 10.0, -0.25, 3.0, 20.0, 0.001, 0.002, 1.0])


def test_eqs_9_and_10_by_hand() -> None:
    """u = 100, v = 50: below 1.2; x = (200 + 25 + 10) / 1.2, y = (-25 + 150 + 20) / 1.2."""
    u, v = np.array(100.0), np.array(50.0)
    assert paper.surface_x(COEFFICIENTS, u, v) == pytest.approx(235 / 1.2)
    assert paper.surface_y(COEFFICIENTS, u, v) == pytest.approx(145 / 1.2)


def test_eq_18_gives_the_point_of_the_line() -> None:
    """f = 2, line through (y, z) = (1, 4) and (3, 2): v = 4/3 is seen at z = 3; n = -20, d = -2, k = 4."""
    constants = paper.stripe_constants(0.5, 4.0, 3.0, 2.0)
    assert (constants.n, constants.d, constants.k) == (-20.0, -2.0, 4.0)
    np.testing.assert_allclose(paper.depth_from_constants(np.array([4 / 3, 0.5, 3.0]), constants), [3, 4, 2])


def test_eq_18_has_no_depth_at_its_singular_position() -> None:
    """At v d = k, and beyond it, where the depth would be negative."""
    constants = paper.stripe_constants(0.5, 4.0, 3.0, 2.0)
    assert np.isnan(paper.depth_from_constants(np.array([-2.0, -3.0]), constants)).all()


@pytest.mark.parametrize("arguments", [(1.0, 2.0, 3.0, 2.0), (1.0, 2.0, 1.0, 4.0)])
def test_eq_17_refuses_equal_heights_and_positions(arguments: tuple[float, float, float, float]) -> None:
    """Singular: one height twice, or a stripe that does not move."""
    with pytest.raises(gp.InvalidInput, match="two depths and two positions"):
        paper.stripe_constants(*arguments)


def test_eq_19_by_hand() -> None:
    """h_m = 0.5, z = 0.4: 0.1 when level, 0.3 when pitched by 60 degrees."""
    assert paper.height(np.array(0.4), 0.5) == pytest.approx(0.1)
    assert paper.height(np.array(0.4), 0.5, np.radians(60)) == pytest.approx(0.3)


def test_eqs_20_and_21_by_hand() -> None:
    """H = 500, h = 100, nadir (10, 20): a point at (110, 220) moves to (90, 180); on the floor nothing moves."""
    assert paper.ortho_u(np.array(110.0), np.array(100.0), 500, 10) == pytest.approx(90)
    assert paper.ortho_v(np.array(220.0), np.array(100.0), 500, 20) == pytest.approx(180)
    assert paper.ortho_u(np.array(110.0), np.array(0.0), 500, 10) == 110


@pytest.mark.parametrize(("h", "error"), [(20, 11.5), (50, 28.9), (100, 57.7)])
def test_eqs_20_and_21_about_the_image_centre_are_wrong_by_h_tan_alpha(h: float, error: float) -> None:
    """The image centre lies H tan(alpha) ahead of the nadir: every height is moved by h tan(alpha), at any v."""
    centre = 500 * np.tan(ALPHA)
    for v in (100.0, 400.0):
        about_nadir = paper.ortho_v(np.array(v), np.array(h), 500, 0.0)
        about_centre = paper.ortho_v(np.array(v), np.array(h), 500, centre)
        assert about_centre - about_nadir == pytest.approx(error, abs=0.06)
