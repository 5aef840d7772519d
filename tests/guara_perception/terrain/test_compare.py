"""`compare` counts the differences between two grids."""

from __future__ import annotations

import numpy as np
import pytest

import guara_perception as gp


def test_a_grid_equals_itself(make_scan):
    """No difference, and no cell known or free in one grid only."""
    terrain = make_scan(0.01)
    same = gp.compare(terrain, terrain)
    assert (same.mean, same.rms, same.largest) == (0.0, 0.0, 0.0)
    assert same.known_in_both == terrain.hazard.size
    assert same.known_only_in_a == same.known_only_in_b == same.free_only_in_a == same.free_only_in_b == 0


def test_differences_are_counted_by_side(make_scan):
    """Heights over common cells, cells known or free in one grid only, and NaN where either is unknown."""
    flags = np.zeros((108, 90), np.uint16)
    flags[:, :5] = gp.Hazard.DROPOUT
    a, b = make_scan(0.0), make_scan(0.002, flags=flags)
    reported = gp.compare(a, b)
    assert reported.mean == pytest.approx(0.002, abs=1e-8) and reported.largest == pytest.approx(0.002, abs=1e-8)
    assert reported.known_only_in_a == 5 * 108 and reported.known_only_in_b == 0
    assert reported.free_only_in_a > 0 and reported.free_only_in_b == 0
    assert np.isnan(reported.difference[:, :5]).all() and np.isfinite(reported.difference[:, 5:]).all()
    assert "mean +2.000 mm" in repr(reported) and f"only in a {5 * 108}, only in b 0" in repr(reported)
    with pytest.raises(ValueError):
        reported.difference[0, 0] = 0.0


def test_nothing_in_common_has_no_mean(make_scan):
    """NaN, not zero, because an error that was not measured is unknown."""
    reported = gp.compare(make_scan(0.0), make_scan(0.0, flags=int(gp.Hazard.UNSCANNED)))
    assert np.isnan(reported.rms) and reported.known_in_both == 0


def test_other_cells_are_refused(make_scan):
    """The message names both geometries."""
    fine = make_scan(0.0)
    with pytest.raises(gp.InvalidInput, match="b is NoneType; allowed: a grid"):
        gp.compare(fine, None)
    with pytest.raises(gp.InvalidInput, match=r"a has \(108, 90\) cells .* allowed: grids of the same cells"):
        gp.compare(fine, fine.coarser(2))
