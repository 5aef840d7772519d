"""Medians."""

from __future__ import annotations

import numpy as np
import pytest

from guara_perception.stripes.peaks import robust_sigma, upper_median, upper_medians


def test_medians_and_robust_sigma() -> None:
    """The upper median of an odd number of values is the median; the robust sigma of normal noise is its sigma."""
    values = np.random.default_rng(1).normal(7, 3, 10001).astype(np.float32)
    assert upper_median(values) == np.median(values)
    assert robust_sigma(values) == pytest.approx(3, rel=0.05)
    rows = values[:9996].reshape(4, -1)
    np.testing.assert_array_equal(upper_medians(rows), [upper_median(row) for row in rows])
