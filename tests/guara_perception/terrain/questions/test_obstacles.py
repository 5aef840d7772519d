"""Planes through points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.terrain.questions.obstacles import fit_plane
from tests.thorough import examples


@given(
    a=st.floats(-2, 2),
    b=st.floats(-2, 2),
    c=st.floats(-1, 1),
    x=st.floats(-3, 3),
    y=st.floats(-3, 3),
    seed=st.integers(0, 99),
)
@settings(max_examples=examples(60), deadline=None, derandomize=True)
def test_plane_is_that_of_least_squares(a: float, b: float, c: float, x: float, y: float, seed: int) -> None:
    """The fit equals that of `numpy.linalg.lstsq`, also far from the origin."""
    random = np.random.default_rng(seed)
    px, py = x + random.uniform(-0.3, 0.3, 50), y + random.uniform(-0.2, 0.2, 50)
    z = a * px + b * py + c + random.normal(0, 0.001, 50)
    expected = np.linalg.lstsq(np.column_stack((px, py, np.ones(50))), z, rcond=None)[0]
    found = fit_plane(px, py, z)
    assert found is not None
    np.testing.assert_allclose(found, expected, atol=1e-8)


@pytest.mark.parametrize("count", [0, 1, 2, 40])
def test_no_plane_through_too_few_points_or_a_line(count: int) -> None:
    """Two points, and any number of collinear points, determine no plane."""
    along = np.linspace(0, 1, count)
    assert fit_plane(0.5 * along, along, along) is None
