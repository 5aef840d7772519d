"""Which of several peaks of each column is the stripe: the one on the cheapest path, with the margin to the next."""

from __future__ import annotations

import numpy as np

from guara_perception.stripes.choose import follow_candidates


def test_path_goes_straight_on_past_a_brighter_spot() -> None:
    """The path does not jump to another peak and back where that is higher in one column only."""
    rows = np.tile([[20], [50]], (1, 9))
    heights = np.tile(np.array([[100.0], [0.0]], np.float32), (1, 9))
    heights[:, 4] = 80, 100
    choice, margin = follow_candidates(rows, heights)
    np.testing.assert_array_equal(choice, 0)
    assert (margin > 0).all()


def test_path_may_jump_at_an_edge() -> None:
    """Where the peaks end in one row and go on in another, the path follows: an occluding edge breaks a stripe."""
    rows = np.tile([[20], [50]], (1, 10))
    heights = np.zeros((2, 10), np.float32)
    heights[0, :5], heights[1, 5:] = 100, 100
    choice, _ = follow_candidates(rows, heights)
    np.testing.assert_array_equal(choice, [0] * 5 + [1] * 5)


def test_columns_without_a_peak_have_no_stripe() -> None:
    """The path goes on after them."""
    heights = np.array([[100, 100, 0, 0, 100, 100]], np.float32)
    choice, _ = follow_candidates(np.full((1, 6), 30), heights)
    np.testing.assert_array_equal(choice, [0, 0, -1, -1, 0, 0])


def test_a_stray_peak_far_from_the_stripe_is_left_out() -> None:
    """A column whose only peak is weak and far from the stripe on both sides is a dropout."""
    rows = np.array([[20, 20, 20, 300, 20, 20, 20], [300] * 7])
    heights = np.array([[100, 100, 100, 0, 100, 100, 100], [0, 0, 0, 100, 0, 0, 0]], np.float32)
    choice, _ = follow_candidates(rows, heights)
    np.testing.assert_array_equal(choice, [0, 0, 0, -1, 0, 0, 0])


def test_two_equal_paths_have_no_margin() -> None:
    """Two rows of equal peaks: the second best path costs the same."""
    _, margin = follow_candidates(np.tile([[20], [50]], (1, 8)), np.full((2, 8), 70, np.float32))
    np.testing.assert_allclose(margin, 0, atol=1e-9)
