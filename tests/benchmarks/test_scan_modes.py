"""Coarse scans of an empty floor stay coarse, those of a low box are refined, and no unsafe cell is free in either."""

from __future__ import annotations

import pytest

from benchmarks.scan_modes import scanned
from testbed.random_world import BOX_HEIGHTS_M, floor


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2, 3, 5])
def test_an_empty_floor_stays_coarse_and_a_box_is_refined(seed: int) -> None:
    """Specimens whose last coarse stripe ends at or before the far edge of the area among them."""
    stripes, unsafe, coarse = scanned(seed, floor(seed, 0, with_box=False))
    assert (stripes, unsafe) == (35, 0)
    ground = floor(seed, 0, with_box=True)
    assert ground.features[0].height >= BOX_HEIGHTS_M[0] == 0.02
    stripes, unsafe, refined = scanned(seed, ground)
    assert (stripes, unsafe) == (70, 0)
    assert 35 / 30 < coarse < 0.6 * refined
