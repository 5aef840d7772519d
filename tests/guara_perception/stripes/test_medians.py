"""Medians."""

from __future__ import annotations

import numpy as np

from guara_perception.stripes.band import upper_median


def test_the_upper_median_of_an_odd_number_of_values_is_the_median() -> None:
    """For an even number, it is the larger of the two in the middle."""
    values = np.random.default_rng(1).normal(7, 3, 10001).astype(np.float32)
    assert upper_median(values) == np.median(values)
    assert upper_median(np.array([1, 4, 2, 3], np.float32)) == 3
