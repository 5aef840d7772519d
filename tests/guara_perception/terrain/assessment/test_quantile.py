"""Quantiles by sorting."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.terrain.assessment.quantile import quantile
from tests.thorough import examples


@given(st.integers(1, 40), st.floats(0.0, 1.0), st.integers(0, 1000))
@settings(max_examples=examples(60), derandomize=True)
def test_as_numpy_to_the_last_bit(size: int, share: float, seed: int) -> None:
    """Quantiles of rows and of single arrays, at any share."""
    values = np.random.default_rng(seed).normal(size=(3, size))
    np.testing.assert_array_equal(quantile(values, share), np.quantile(values, share, axis=-1))
    assert quantile(values[0], share) == np.quantile(values[0], share)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_the_ends_are_the_extremes(share: float) -> None:
    """Nothing lies below the smallest nor above the largest."""
    values = np.array([3.0, -1.0, 2.5])
    assert quantile(values, share) == (values.min() if share == 0 else values.max())
