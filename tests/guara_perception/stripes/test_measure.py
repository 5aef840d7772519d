"""Positions of a stripe, smoothed along its run."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.stripes.measure import smooth_line
from tests.thorough import examples


@given(slope=st.floats(-0.4, 0.4), offset=st.floats(0, 100), seed=st.integers(0, 99))
@settings(max_examples=examples(30), deadline=None, derandomize=True)
def test_smoothing_leaves_a_straight_line_where_it_is(slope: float, offset: float, seed: int) -> None:
    """Pairs of neighbours with equal weight: no bias, whatever the weights."""
    rows = (offset + slope * np.arange(50)).astype(np.float32)
    weights = np.random.default_rng(seed).uniform(0.1, 10, 50).astype(np.float32)
    smooth, shrink = smooth_line(rows, weights)
    np.testing.assert_allclose(smooth, rows, atol=1e-3)
    assert (shrink <= 1 + 1e-6).all()


def test_smoothing_never_bridges_a_gap_or_a_jump() -> None:
    """A gap stays NaN, both sides of a jump stay where they are, and noise within a run shrinks."""
    rows = np.where(np.arange(60) < 30, 10.0, 30.0).astype(np.float32)
    rows[45:48] = np.nan
    smooth, _ = smooth_line(rows, np.ones(60, np.float32))
    np.testing.assert_array_equal(np.isnan(smooth), np.isnan(rows))
    np.testing.assert_allclose(smooth[np.isfinite(rows)], rows[np.isfinite(rows)], atol=1e-5)
    noisy = (20 + np.random.default_rng(0).normal(0, 0.1, 2000)).astype(np.float32)
    smooth, shrink = smooth_line(noisy, np.ones(2000, np.float32))
    assert np.std(smooth[5:-5]) == pytest.approx(0.1 * float(np.median(shrink)), rel=0.15)


def test_lines_are_smoothed_each_by_itself() -> None:
    """Several lines at once give what each gives alone: nothing is averaged from one line into the next."""
    random = np.random.default_rng(3)
    lines = random.normal(20, 0.2, (4, 50)).astype(np.float32)
    lines[1, 10:20] = np.nan
    weights = random.uniform(1, 9, (4, 50)).astype(np.float32)
    together = smooth_line(lines, weights)
    for index in range(4):
        for one, several in zip(smooth_line(lines[index], weights[index]), together, strict=True):
            np.testing.assert_array_equal(one, several[index])
