"""Patterns of stripes."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import coarse, coarse_first
from drivers.errors import BadPattern
from drivers.pattern import check_pattern

PATTERN = [(index, 0.01 * index) for index in range(9)]


def test_coarse_takes_every_second_index() -> None:
    """The even ones, with their own angles."""
    assert [index for index, _ in coarse(PATTERN)] == [0, 2, 4, 6, 8]
    assert dict(coarse(PATTERN)).items() <= dict(PATTERN).items()


@given(st.lists(st.integers(0, 200), min_size=1, unique=True))
@settings(max_examples=50, derandomize=True)
def test_coarse_first_takes_all_and_the_coarse_before_the_rest(indices: list[int]) -> None:
    """The same stripes in another order; both halves keep the direction of the sweep."""
    pattern = [(index, 0.01 * index) for index in sorted(indices)]
    order = coarse_first(pattern)
    assert sorted(order) == pattern
    even = [pair for pair in pattern if pair[0] % 2 == 0]
    assert list(order[: len(even)]) == even
    assert list(order[len(even) :]) == [pair for pair in pattern if pair[0] % 2]


@pytest.mark.parametrize(
    ("pattern", "words"),
    [
        ([], "holds no stripe"),
        ([(1, 0.0), (1, 0.1)], "stripe index 1 in the pattern"),
        ([(-1, 0.0)], "stripe index -1"),
        ([(3, math.nan)], "stripe 3 has mirror angle nan"),
    ],
)
def test_bad_patterns_are_refused(pattern: list, words: str) -> None:
    """Each with the stripe concerned."""
    with pytest.raises(BadPattern, match=words):
        check_pattern(pattern)
