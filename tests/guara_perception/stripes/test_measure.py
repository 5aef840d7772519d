"""Positions of a stripe, smoothed along its run."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.stripes.kernel.library import address
from tests.guara_perception.stripes.kernel_parts import part
from tests.thorough import examples


def smooth_line(position: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed positions (n,) of a stripe, and factors by which independent noise is reduced."""
    position, weight = (np.ascontiguousarray(array, np.float32) for array in (position, weight))
    smooth, shrink = np.empty((2, position.size), np.float32)
    part("smooth_line")(*map(address, (position, weight)), position.size, *map(address, (smooth, shrink)))
    return smooth, shrink


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


def plain_line(position: np.ndarray, weight: np.ndarray) -> tuple[list[float], list[float]]:
    """The same by plain Python."""
    smooth, shrink, n = [], [], len(position)
    for column in range(n):
        pairs = []
        for far in (1, 2, 3):
            if not (far <= column < n - far):
                break
            left, right = position[column - far], position[column + far]
            steepest = 0.5 * far
            pair = min(weight[column - far], weight[column + far])
            if not (abs(left - position[column]) < steepest and abs(right - position[column]) < steepest and pair > 0):
                break
            pairs.append((pair, left + right))
        own = weight[column]
        total = own + 2 * sum(pair for pair, _ in pairs)
        smooth.append((own * position[column] + sum(pair * both for pair, both in pairs)) / total)
        shrink.append((own**2 + 2 * sum(pair**2 for pair, _ in pairs)) ** 0.5 / total)
    return smooth, shrink


def test_lines_are_smoothed_as_by_plain_python() -> None:
    """With noise, gaps, jumps and weights of any size."""
    random = np.random.default_rng(3)
    for n in (1, 2, 5, 60):
        line = (20 + random.normal(0, 0.4, n) + 9 * (np.arange(n) > 30)).astype(np.float32)
        line[10:14] = np.nan
        weight = random.uniform(1, 9, n).astype(np.float32)
        smooth, shrink = smooth_line(line, weight)
        expected, factor = plain_line(line.astype(float), weight.astype(float))
        np.testing.assert_allclose(smooth, expected, rtol=1e-6)
        known = np.isfinite(line)
        np.testing.assert_allclose(shrink[known], np.array(factor)[known], rtol=1e-6)
