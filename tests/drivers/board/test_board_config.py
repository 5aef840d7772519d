"""Validation of the board's configuration."""

import math

import pytest

from drivers import BoardConfig


@pytest.mark.parametrize(
    ("changes", "expected_text"),
    [
        ({"vendor_id": -1}, "vendor_id is -1, allowed: 0 ... 65535"),
        ({"product_id": 70000}, "product_id is 70000"),
        ({"timeout": 0.0}, "timeout is 0.0 s"),
        ({"motion_timeout": math.nan}, "motion_timeout is nan s"),
        ({"home_timeout": -2.0}, "home_timeout is -2.0 s"),
        ({"attempts": 0}, "attempts is 0, allowed: 1 ... 10"),
    ],
)
def test_a_bad_value_is_refused_with_what_is_allowed(changes: dict, expected_text: str) -> None:
    """Each field is checked, and the message contains the value."""
    with pytest.raises(ValueError, match=expected_text):
        BoardConfig(**changes)
