"""Patterns of stripes."""

import math

import pytest

from drivers.errors import BadPattern
from drivers.pattern import check_pattern


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
