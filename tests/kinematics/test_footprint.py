import numpy as np
import pytest

from kinematics import StanceError
from kinematics.footprint import fit_support_plane

FEET = np.array([[0.3, 0.18, 0.0], [0.3, -0.18, 0.0], [-0.3, 0.18, 0.0], [-0.3, -0.18, 0.0]])


def test_a_plane_is_found_exactly() -> None:
    """Coplanar soles give the coefficients and the normal of their plane, without a residual."""
    soles = FEET.copy()
    soles[:, 2] = 0.1 * soles[:, 0] - 0.05 * soles[:, 1] - 0.36
    plane = fit_support_plane(soles)
    np.testing.assert_allclose(plane.coefficients, [0.1, -0.05, -0.36], atol=1e-15)
    np.testing.assert_allclose(plane.normal, np.array([-0.1, 0.05, 1.0]) / np.sqrt(1.0125), atol=1e-15)
    assert plane.residual < 1e-15


def test_residual_is_the_rms_distance() -> None:
    """One foot 12 mm off a level rectangle leaves a residual of 3 mm at every foot."""
    soles = FEET.copy()
    soles[0, 2] = 0.012
    plane = fit_support_plane(soles)
    assert plane.residual == pytest.approx(0.003 * np.cos(np.arccos(plane.normal[2])), rel=1e-6)
    assert fit_support_plane(soles[:3]).residual == 0.0


def test_gain_is_the_derivative_of_the_plane() -> None:
    """Raising one sole slightly changes the coefficients by that sole's column of the gain."""
    soles = FEET + np.random.default_rng(1).normal(0.0, 0.01, (4, 3))
    plane = fit_support_plane(soles)
    for foot in range(4):
        raised = soles.copy()
        raised[foot, 2] += 1e-6
        change = (fit_support_plane(raised).coefficients - plane.coefficients) / 1e-6
        np.testing.assert_allclose(change, plane.gain[:, foot], atol=1e-6)


def test_too_few_feet_are_refused() -> None:
    """Two soles do not define a plane."""
    with pytest.raises(StanceError, match="support_feet: 2 given; a support plane needs three feet"):
        fit_support_plane(FEET[:2])


def test_feet_on_a_line_are_refused() -> None:
    """Three soles on one line, seen from above, do not define a plane, whatever their heights."""
    line = np.array([[0.0, 0.0, 0.0], [0.1, 0.2, 0.0], [0.2, 0.4, 0.01]])
    with pytest.raises(StanceError, match="the 3 soles lie on one line"):
        fit_support_plane(line)
