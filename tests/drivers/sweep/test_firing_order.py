"""Firing orders that are rejected."""

import math

import pytest

from drivers.errors import BadFiringOrder
from drivers.sweep.firing_order import check_firing_order


@pytest.mark.parametrize(
    ("firing_order", "expected_text"),
    [
        ([], "the firing order is empty"),
        ([(1, 0.0), (1, 0.1)], "stripe index 1 in the firing order"),
        ([(-1, 0.0)], "stripe index -1"),
        ([(3, math.nan)], "stripe 3 has mirror angle nan"),
    ],
)
def test_bad_firing_orders_are_refused(firing_order: list, expected_text: str) -> None:
    """The message names the invalid stripe, or says that there is none."""
    with pytest.raises(BadFiringOrder, match=expected_text):
        check_firing_order(firing_order)
