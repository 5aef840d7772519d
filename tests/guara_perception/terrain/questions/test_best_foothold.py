"""Best foothold near a nominal position: safe, near, and deterministic."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import guara_perception as gp
from tests.guara_perception.terrain.questions.ground import PROPERTY, world


def test_on_perfect_ground_the_wish_itself_is_best() -> None:
    """On uniform ground the nominal position is the best, at a cell centre or not."""
    terrain = gp.assess_terrain(np.zeros((300, 300)), 0.005)
    best = terrain.best_foothold(0.7512, 0.7498, 0.05)
    assert best is not None
    assert (best.x, best.y) == (0.7512, 0.7498)
    assert best.z == 0.0
    np.testing.assert_allclose(best.normal, [0, 0, 1])
    assert best.score == 1.0


@pytest.mark.slow
@PROPERTY
@given(st.integers(0, 500), st.floats(0.45, 0.95), st.floats(-0.25, 0.25), st.floats(0.0, 0.12))
def test_the_best_foothold_is_allowed_near_and_the_same_every_time(
    seed: int, x: float, y: float, radius: float
) -> None:
    """It passes check_foothold, is within the radius, and is the same again; None if no position passes."""
    terrain = world(seed)
    best = terrain.best_foothold(x, y, radius)
    cx, cy = (a.ravel() for a in np.meshgrid(*terrain.geometry.centres()))
    near = np.hypot(cx - x, cy - y) <= radius
    any_ok = terrain.check_foothold(cx[near], cy[near]).ok.any() if near.any() else False
    if best is None:
        assert not any_ok
        return
    assert terrain.check_foothold(best.x, best.y).ok
    assert np.hypot(best.x - x, best.y - y) <= radius + 1e-9
    again = terrain.best_foothold(x, y, radius)
    assert again is not None
    assert (again.x, again.y, again.value) == (best.x, best.y, best.value)


def test_where_there_is_none_the_best_refused_place_says_why(paper_terrain: gp.TerrainGrid) -> None:
    """Hazards and reach are distinguished; None if every position is a foothold."""
    assert paper_terrain.best_foothold(0.6, 0.2, 0.02) is None
    refused = paper_terrain.best_refused(0.6, 0.2, 0.02)
    assert refused is not None and np.hypot(refused.x - 0.6, refused.y - 0.2) <= 0.02
    assert {reason.test for reason in refused.verdict.reasons} and "refused: " in repr(refused)
    assert repr(refused.verdict) == repr(paper_terrain.check_foothold(refused.x, refused.y))
    # A hind leg does not reach the ground ahead.
    place = paper_terrain.best_foothold(0.79, 0.0, 0.1)
    assert place is not None and paper_terrain.best_foothold(place.x, place.y, 0.01, leg="lh") is None
    beyond = paper_terrain.best_refused(place.x, place.y, 0.01, leg="lh")
    assert beyond is not None and [reason.test for reason in beyond.verdict.reasons] == ["reach"]
    assert gp.assess_terrain(np.zeros((300, 300)), 0.005).best_refused(0.75, 0.75, 0.05) is None
    with pytest.raises(gp.InvalidInput, match=r"radius is 2\.0; it must be 0 \.\.\. 1 m"):
        paper_terrain.best_refused(0.6, 0.2, 2.0)


def test_ties_go_to_the_smaller_x_then_y() -> None:
    """Of four equal positions, the first by x, then by y."""
    heights = np.full((121, 121), np.nan)
    for iy, ix in ((60, 30), (60, 90), (30, 60), (90, 60)):
        heights[iy - 12 : iy + 13, ix - 14 : ix + 15] = 0.0
    terrain = gp.assess_terrain(heights, 0.005)
    centre = 60.5 * 0.005
    best = terrain.best_foothold(centre, centre, 0.16)
    assert best is not None
    assert best.x < centre
    assert best.y == pytest.approx(centre)


def test_the_previous_choice_is_kept_until_another_is_worth_a_third_more() -> None:
    """Two ledges beside a gap: as the nominal position crosses the gap, the choice changes once."""
    heights = np.zeros((120, 160))
    heights[:, 78:82] = np.nan
    terrain = gp.assess_terrain(heights, 0.005)
    wishes = np.linspace(0.33, 0.47, 29)
    free = [terrain.best_foothold(x, 0.3, 0.1) for x in wishes]
    previous, chosen = None, []
    for x in wishes:
        previous = terrain.best_foothold(x, 0.3, 0.1, previous=previous)
        assert previous is not None
        chosen.append(previous.x > 0.4)
    sides = [bool(foothold is not None and foothold.x > 0.4) for foothold in free]
    assert sides != chosen
    assert chosen == sorted(chosen)
    assert chosen[-1]
    # A position that is no longer safe, or outside the radius, is not kept.
    gap = terrain.best_foothold(0.33, 0.3, 0.1, previous=(0.4, 0.3))
    assert gap is not None
    assert gap.x < 0.38


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.nan, 0.0, 0.1), "the nominal position is"),
        ((0.0, 0.0, -0.1), "radius is -0.1; it must be 0 ... 1 m"),
        ((0.0, 0.0, 50.0), "radius is 50.0"),
        ((0.0, 0.0, np.inf), "radius is inf"),
    ],
)
def test_bad_questions_are_refused(arguments: tuple[float, float, float], message: str) -> None:
    """NaN, a negative or too large radius, and an invalid previous choice."""
    with pytest.raises(gp.InvalidInput, match=message):
        world(0).best_foothold(*arguments)
    with pytest.raises(gp.InvalidInput, match="must be a Foothold or a pair"):
        world(0).best_foothold(0.6, 0.0, 0.1, previous="left")  # type: ignore[arg-type]
