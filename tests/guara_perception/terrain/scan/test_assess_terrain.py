"""`assess_terrain` as a user calls it: meaning of NaN, and all refusals."""

from __future__ import annotations

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.terrain.layers.hazard import Hazard


def test_nan_becomes_unscanned_and_origin_is_the_corner() -> None:
    """An unknown height is UNSCANNED; cell (0, 0) is the corner at minimum x and y; x is fastest."""
    heights = np.arange(12, dtype=float).reshape(3, 4) / 1000
    heights[2, 1] = np.nan
    terrain = gp.assess_terrain(heights, 0.01, origin=(0.5, -0.2))
    assert terrain.hazard[2, 1] & Hazard.UNSCANNED
    assert terrain.height_at(0.505, -0.195) == 0.0
    assert terrain.height_at(0.535, -0.195) == pytest.approx(0.003)
    assert terrain.height_at(0.505, -0.185) == pytest.approx(0.004)
    assert np.isnan(terrain.height_at(0.515, -0.175))
    assert terrain.age[2, 1] == 255
    assert terrain.looks[2, 1] == 0
    assert terrain.looks[0, 0] == 1


def test_masked_heights_are_unknown() -> None:
    """For any number under the mask."""
    heights = np.ma.masked_array(np.zeros((40, 40)), mask=np.zeros((40, 40), bool))
    assert (gp.assess_terrain(heights, 0.005).hazard == 0).any()
    heights[20, 20] = np.ma.masked
    terrain = gp.assess_terrain(heights, 0.005)
    assert np.isnan(terrain.elevation[20, 20]) and terrain.hazard[20, 20] & Hazard.UNSCANNED
    assert terrain.hazard[20, 22] & Hazard.EDGE


def test_its_input_is_not_kept() -> None:
    """Changing the array afterwards has no effect."""
    heights = np.zeros((30, 30))
    terrain = gp.assess_terrain(heights, 0.005)
    heights[:] = 1.0
    assert terrain.height_at(0.05, 0.05) == 0.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"elevation": np.zeros(5)}, r"shape \(5,\); it must be \(ny, nx\)"),
        ({"elevation": np.zeros((0, 3))}, r"shape \(0, 3\)"),
        ({"elevation": np.zeros((2, 2, 2))}, r"shape \(2, 2, 2\)"),
        ({"elevation": [["a"]]}, "elevation: an array of numbers is needed"),
        ({"elevation": [[0.0, 1.0], [0.0]]}, "elevation: an array of numbers is needed"),
        ({"elevation": np.zeros((2, 2), complex)}, "elevation: an array of numbers is needed"),
        ({"elevation": [[np.inf, 0.0]]}, "infinite heights: use NaN"),
        ({"elevation": [[2e4, 0.0]]}, "at most 10000 m is allowed"),
        ({"resolution": 0.0}, "resolution is 0.0; it must be a positive"),
        ({"resolution": -0.01}, "resolution is -0.01"),
        ({"resolution": np.nan}, "resolution is nan"),
        ({"resolution": [0.01, 0.01]}, "one number"),
        ({"resolution": None}, "resolution is None, .*: one number and a pair"),
        ({"resolution": "fine"}, "resolution is 'fine'"),
        ({"origin": 5}, "origin is 5: one number and a pair"),
        ({"origin": None}, "origin is None"),
        ({"limits": {"slope": 0.3}}, "limits is {'slope': 0.3}, allowed: TraversabilityLimits"),
        ({"origin": (0.0, np.nan)}, "two finite numbers"),
        ({"origin": (0.0,)}, "pair"),
        ({"variance": np.zeros((2, 3))}, r"variance has shape \(2, 3\), elevation has \(2, 2\)"),
        ({"variance": np.full((2, 2), np.nan)}, "NaN, infinite or negative at a known height"),
        ({"variance": np.full((2, 2), -1.0)}, "NaN, infinite or negative"),
        ({"variance": np.full((2, 2), np.inf)}, "NaN, infinite or negative"),
        ({"lowest": np.zeros((2, 3))}, r"lowest has shape \(2, 3\); allowed: the shape of elevation, \(2, 2\)"),
        ({"lowest": np.full((2, 2), 0.01)}, "lowest .* heights at or below elevation"),
        ({"highest": np.full((2, 2), np.inf)}, "highest .* finite heights at or above elevation"),
        ({"highest": np.full((2, 2), -0.01)}, "highest .* heights at or above elevation"),
        ({"highest": np.full((2, 2), np.nan)}, "highest .* in known cells finite heights at or above elevation"),
    ],
)
def test_bad_input_is_refused(arguments: dict[str, object], message: str) -> None:
    """The error is named with what is allowed; no error of numpy reaches the caller."""
    given: dict[str, object] = {"elevation": np.zeros((2, 2)), "resolution": 0.005, **arguments}
    with pytest.raises(gp.InvalidInput, match=message):
        gp.assess_terrain(**given)


def test_variance_may_be_nan_where_the_height_is() -> None:
    """An unknown cell needs no variance; a given one is ignored."""
    heights, variance = np.zeros((30, 30)), np.zeros((30, 30))
    heights[3, 3], variance[3, 3] = np.nan, np.nan
    assert np.isnan(gp.assess_terrain(heights, 0.005, variance=variance).variance[3, 3])


def test_a_grid_without_a_height_is_a_grid() -> None:
    """With all cells unknown, nothing is traversable, and queries work."""
    terrain = gp.assess_terrain(np.full((40, 40), np.nan), 0.005)
    assert not (terrain.traversability > 0).any()
    assert (terrain.to_occupancy() == 100).all()
    assert terrain.obstacles() == []
    assert terrain.best_foothold(0.1, 0.1, 0.1) is None
    assert not terrain.check_path([[0.05, 0.05, 0.3], [0.1, 0.1, 0.3]], 0.02).ok


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"slope": 20.0}, "limit slope is 20.0"),
        ({"step": 0.0}, "limit step is 0.0"),
        ({"sigma": -1.0}, "limit sigma is -1.0"),
        ({"disc_radius": 15.0}, "limit disc_radius is 15.0"),
        ({"sole_length": np.nan}, "limit sole_length is nan"),
        ({"confidence": "2"}, "limit confidence is '2'"),
    ],
)
def test_absurd_limits_are_refused(limits: gp.TraversabilityLimits, change: dict[str, float], message: str) -> None:
    """Degrees for radians, millimetres for metres, zero and NaN are rejected with what is allowed."""
    import dataclasses

    with pytest.raises(gp.InvalidInput, match=message):
        dataclasses.replace(limits, **change)


def test_confidence_may_be_zero(limits: gp.TraversabilityLimits) -> None:
    """A user who trusts the values can set this."""
    import dataclasses

    assert dataclasses.replace(limits, confidence=0).confidence == 0


@pytest.mark.parametrize("cell", [0.02, 0.025, 0.03])
@pytest.mark.parametrize("fraction", [0.05, 0.5, 0.95])
def test_edges_within_coarse_cells_are_a_cell_from_every_free_sole(cell: float, fraction: float) -> None:
    """The lowest points of a cell reveal a pit that ends within it, although its highest points are level."""
    heights = np.zeros((40, 40))
    lowest = heights.copy()
    # One line of cells contains the near half of a gap that fills no cell completely.
    lowest[:, 20] = -0.2
    edge = (20 + fraction) * cell
    assert (gp.assess_terrain(heights, cell).hazard[:, 20] == 0).any()
    terrain = gp.assess_terrain(heights, cell, lowest=lowest)
    free = np.nonzero((terrain.hazard == 0).any(axis=0))[0]
    assert free.size
    to_edge = np.abs(terrain.geometry.centres()[0][free] - edge) - terrain.record.required_limits.sole_length / 2
    assert to_edge.min() > 0
