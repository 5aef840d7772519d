"""Clearance of a leg above the ground: bounds count as heights, unknown ground without a bound gives NaN."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.app.messages import message_to_terrain, terrain_to_message
from guara_perception.terrain.layers.layers import CEILING_SIGMA_M
from guara_perception.terrain.layers.record import ScanRecord
from kinematics import RobotModel, Stance, UnknownName, foothold_clearance, load_robot
from tests.thorough import examples
from transport import decode_terrain
from transport.messages.terrain_message import encode_compact

SIGMA_M = 3e-4
# Under the knee of a leg of the Guará in its scan posture, beside its sole.
UNDER_LEG = (0.07, 0.13)


def standing(heights: np.ndarray, ceiling: float | None = None) -> gp.TerrainGrid:
    """Ground around a standing Guará; unknown cells may have a ceiling."""
    robot = load_robot("guara")
    stance = Stance(robot.posture("scan"), robot.legs, (0, 0, -1))
    pose = robot.stance_pose(stance)
    terrain = gp.assess_terrain(heights, 0.005, (-0.6, -0.4), np.full(heights.shape, SIGMA_M**2))
    record = ScanRecord.from_json(
        {
            **terrain.metadata,
            "robot": robot.name,
            "stance": stance.to_dict(),
            "support_feet_used": list(robot.legs),
            "transform_base_to_footprint": pose.transform_base_to_footprint.tolist(),
        }
    )
    layers = dict(terrain.layers)
    if ceiling is not None:
        layers["ceiling"] = np.where(np.isnan(terrain.elevation), np.float32(ceiling), np.float32(np.nan))
    return dataclasses.replace(terrain, record=record, layers=layers)


def level() -> np.ndarray:
    return np.zeros((160, 260))


def with_patch(height: float, sole: np.ndarray) -> np.ndarray:
    """Level ground with a patch of another or unknown height beside a sole, on both sides."""
    heights = level()
    y, x = (np.mgrid[:160, :260] + 0.5) * 0.005 + np.array([-0.4, -0.6])[:, None, None]
    beside = (np.abs(x - sole[0]) > UNDER_LEG[0]) & (np.abs(x - sole[0]) < UNDER_LEG[1])
    heights[beside & (np.abs(y - sole[1]) < 0.06)] = height
    return heights


@pytest.fixture
def sole(robot: RobotModel) -> np.ndarray:
    """Centre of the left front sole."""
    pose = robot.stance_pose(Stance(robot.posture("scan"), robot.legs, (0, 0, -1)))
    return np.asarray(pose.soles_in_footprint[list(pose.support_feet_used).index("lf")])


def test_over_level_ground_it_is_the_legs_own_less_the_confidence(robot: RobotModel, sole: np.ndarray) -> None:
    """Equals `foothold_clearance` above ground that is two sigma higher."""
    pose = robot.stance_pose(Stance(robot.posture("scan"), robot.legs, (0, 0, -1)))
    expected = foothold_clearance(pose, "lf", [*sole[:2], 0.0], lambda x, _: np.full_like(x, 2 * SIGMA_M)).leg
    found = standing(level()).leg_clearance(*sole[:2], "lf")
    assert found == pytest.approx(expected, abs=1e-6) and found > 0


def test_a_bound_below_the_calf_is_a_height_and_without_one_it_is_unknown(sole: np.ndarray) -> None:
    """Light that passed below the leg gives a clearance; light above its parts does not show that they are free."""
    known = standing(level()).leg_clearance(*sole[:2], "lf")
    unknown = with_patch(np.nan, sole)
    assert np.isnan(standing(unknown).leg_clearance(*sole[:2], "lf"))
    bounded = standing(unknown, ceiling=0.0).leg_clearance(*sole[:2], "lf")
    assert known - 2 * CEILING_SIGMA_M <= bounded <= known
    assert standing(unknown, ceiling=0.4).leg_clearance(*sole[:2], "lf") < 0
    # The bound allows no foothold.
    assert not standing(unknown, ceiling=0.0).check_foothold(sole[0] + 0.1, sole[1])


def test_what_bounds_nothing_gives_no_number(sole: np.ndarray) -> None:
    """Stale ground, the edge of the grid, a sole on unknown ground or out of reach: NaN."""
    terrain = standing(level())
    hazard = terrain.hazard | np.where(np.isfinite(with_patch(np.nan, sole)), 0, gp.Hazard.STALE).astype(np.uint16)
    traversability = np.where(hazard != 0, np.float32(0), terrain.traversability)
    layers = {**terrain.layers, "hazard": hazard, "traversability": traversability}
    assert np.isnan(dataclasses.replace(terrain, layers=layers).leg_clearance(*sole[:2], "lf"))
    assert np.isnan(standing(level()[:, : round((sole[0] + 0.61) / 0.005)]).leg_clearance(*sole[:2], "lf"))
    assert np.isnan(terrain.leg_clearance(sole[0] + 0.5, sole[1], "lf"))
    assert np.isnan(terrain.leg_clearance(9.0, 0.0, "lf")) and np.isnan(terrain.leg_clearance(np.nan, 0.0, "lf"))
    with pytest.raises(UnknownName):
        terrain.leg_clearance(*sole[:2], "xx")
    with pytest.raises(gp.InvalidInput, match=r"x and y have shapes \(2,\) and \(\); two numbers"):
        terrain.leg_clearance([0.1, 0.2], 0.0, "lf")  # type: ignore[arg-type]
    with pytest.raises(gp.InvalidInput, match="lacks"):
        gp.assess_terrain(level(), 0.005, (-0.6, -0.4)).leg_clearance(*sole[:2], "lf")


@pytest.mark.slow
@settings(max_examples=examples(20), deadline=None)
@given(
    low=st.floats(-0.05, 0.3),
    more=st.floats(0.0, 0.2),
    x=st.floats(-0.04, 0.04),
    leg=st.sampled_from(("lf", "rh")),
)
def test_higher_ground_or_a_higher_bound_never_gives_more_room(low: float, more: float, x: float, leg: str) -> None:
    """For any known or bounded ground beside the sole."""
    at = np.array([0.3 + x if leg == "lf" else -0.3 + x, 0.18 if leg == "lf" else -0.18])
    for lower, higher in (
        (standing(with_patch(low, at)), standing(with_patch(low + more, at))),
        (standing(with_patch(np.nan, at), ceiling=low), standing(with_patch(np.nan, at), ceiling=low + more)),
    ):
        assert higher.leg_clearance(*at, leg) <= lower.leg_clearance(*at, leg)


def test_a_grid_of_the_compact_encoding_gives_no_more_room(sole: np.ndarray) -> None:
    """The rounding error is subtracted; ground between the steps of the encoding, and a wall beside it."""
    for height in (0.0, 0.0001, 0.05, 0.20013):
        terrain = standing(with_patch(height, sole) + 0.00013)
        received = message_to_terrain(
            decode_terrain(encode_compact(terrain_to_message(terrain, robot="guara", sequence=1)))
        )
        exact, rounded = (grid.leg_clearance(*sole[:2], "lf") for grid in (terrain, received))
        assert exact - 0.003 < rounded <= exact


def test_the_highest_ground_is_what_bounds_it() -> None:
    """Highest sample or ceiling plus two sigma; NaN without both, on stale ground and off the grid."""
    heights = level()
    heights[80, 100], heights[80, 120] = 0.02, np.nan
    x, y = -0.6 + 0.005 * (np.array([50, 100, 120, 4000]) + 0.5), np.full(4, -0.4 + 0.005 * 80.5)
    known = [2 * SIGMA_M, 0.02 + 2 * SIGMA_M]
    np.testing.assert_allclose(standing(heights).highest_at(x, y), [*known, np.nan, np.nan], atol=1e-6)
    bounded = standing(heights, ceiling=0.05)
    np.testing.assert_allclose(bounded.highest_at(x, y), [*known, 0.05 + 2 * CEILING_SIGMA_M, np.nan], atol=1e-6)
    assert bounded.highest_at(float(x[1]), float(y[1])) == pytest.approx(known[1], abs=1e-6)
    hazard = bounded.hazard.copy()
    hazard[80, 50] |= gp.Hazard.STALE
    traversability = np.where(hazard != 0, np.float32(0), bounded.traversability)
    layers = {**bounded.layers, "hazard": hazard, "traversability": traversability}
    assert np.isnan(dataclasses.replace(bounded, layers=layers).highest_at(x[:1], y[:1])).all()
