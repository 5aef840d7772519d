"""Foothold checks: every failed test is reported, and nothing unknown is accepted."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.assessment.raster import Raster
from guara_perception.terrain.layers.hazard import Hazard
from guara_perception.terrain.layers.record import ScanRecord, known_limits
from kinematics import KinematicsError, RobotModel, RobotNotFound, Stance, describe_robot, load_robot
from tests.guara_perception.terrain.questions.ground import ORIGIN, PROPERTY, grid, world


def sole_cells(terrain: gp.TerrainGrid, x: float, y: float) -> tuple[np.ndarray, bool]:
    """Flags of every cell that the 80 x 60 mm sole overlaps, by brute force; True if all of it is on the grid."""
    cx, cy = terrain.geometry.centres()
    half = 0.0025
    columns = np.abs(cx - x) < 0.040 + half - 1e-8
    rows = np.abs(cy - y) < 0.030 + half - 1e-8
    on_x = x - 0.040 >= cx[0] - half - 1e-8 and x + 0.040 <= cx[-1] + half + 1e-8
    on_y = y - 0.030 >= cy[0] - half - 1e-8 and y + 0.030 <= cy[-1] + half + 1e-8
    return terrain.hazard[np.ix_(rows, columns)], bool(on_x and on_y)


@pytest.mark.slow
@PROPERTY
@given(st.integers(0, 500), st.lists(st.tuples(st.floats(0.35, 1.05), st.floats(-0.35, 0.35)), min_size=1, max_size=30))
def test_a_foothold_is_accepted_only_where_the_whole_sole_is_known_and_safe(
    seed: int, places: list[tuple[float, float]]
) -> None:
    """Brute force: no accepted foothold overlaps an unknown, hazardous or missing cell."""
    terrain = world(seed)
    x, y = np.array(places).T
    verdicts = terrain.check_foothold(x, y)
    for i, (px, py) in enumerate(places):
        flags, on_grid = sole_cells(terrain, px, py)
        clean = on_grid and not (flags & np.uint16(0xFFFF & ~Hazard.EDGE)).any()
        expected = clean and bool(terrain.is_traversable(px, py))
        assert bool(verdicts.ok[i]) == expected
        assert verdicts[i].ok == expected
        assert bool(verdicts[i].reasons) == (not expected)
        assert (verdicts.score[i] > 0) == expected


def test_numbers_and_arrays_agree() -> None:
    """A single position gets the same verdict, with the same reasons, as among others."""
    terrain = world(3)
    x, y = np.meshgrid(np.linspace(0.4, 1.0, 9), np.linspace(-0.3, 0.3, 7))
    verdicts = terrain.check_foothold(x, y)
    assert verdicts.ok.shape == verdicts.score.shape == (7, 9)
    assert len(verdicts) == 63
    for i, verdict in enumerate(verdicts):
        assert terrain.check_foothold(float(x.flat[i]), float(y.flat[i])) == verdict


def reasons(terrain: gp.TerrainGrid, x: float, y: float) -> dict[str, gp.Reason]:
    """Failed tests by name."""
    verdict = terrain.check_foothold(x, y)
    assert not verdict
    return {reason.test: reason for reason in verdict.reasons}


def test_every_failed_test_has_its_value_and_limit() -> None:
    """A box of 50 mm under the sole: step, drop and slope fail, with values of the layers and limits of the robot."""
    heights = np.zeros((120, 120))
    heights[:, 60:] = 0.05
    failed = reasons(grid(heights), 0.7, 0.0)
    assert failed["step"].value == pytest.approx(0.05)
    assert failed["step"].limit == 0.030
    assert failed["drop"].limit == 0.020
    assert failed["slope"].value > failed["slope"].limit == 0.35
    assert failed["roughness"].value > failed["roughness"].limit
    assert str(failed["step"]) == "step 50 mm, allowed 30 mm (plus 2 sigma)"


def test_unknown_reasons_name_cause_and_share() -> None:
    """One unknown column of 17 under the sole: its fraction and cause; off the grid is reported as well."""
    heights = np.zeros((120, 120))
    heights[:, 62] = np.nan
    failed = reasons(grid(heights), 0.7025, 0.0025)
    assert failed["unknown"].value == pytest.approx(1 / 17)
    assert "UNSCANNED" in failed["unknown"].detail
    assert "off the grid" in reasons(grid(heights), 0.41, 0.0)["unknown"].detail
    assert reasons(grid(heights), 5.0, 0.0)["unknown"].value == 1.0
    assert reasons(grid(heights), np.nan, 0.0)["unknown"].value == 1.0


def test_uncertain_conflicting_and_stale_ground_is_reported(robot: RobotModel) -> None:
    """Flags set by fusion have their own reasons."""
    from guara_perception.settings import Settings
    from guara_perception.terrain.assessment.assess import assess_layers

    limits = Settings.of(robot).limits
    flat = np.zeros((120, 120))
    hazard = np.full(flat.shape, np.uint16(Hazard.CONFLICT | Hazard.STALE))
    layers = assess_layers(Raster(flat, np.full(flat.shape, 1e-4), flat, flat), hazard, 0.005, limits)
    layers["age"] = np.full(flat.shape, 77, np.uint8)
    layers["looks"] = np.ones(flat.shape, np.uint8)
    base = grid(flat)
    metadata = {**base.metadata, "validity_pauses": 40, "validity_seconds": 420.0}
    terrain = gp.TerrainGrid(layers=layers, geometry=base.geometry, record=ScanRecord.from_json(metadata))
    failed = reasons(terrain, 0.7, 0.0)
    assert failed["sigma"].value == pytest.approx(0.01)
    assert failed["sigma"].limit == 0.005
    assert failed["conflict"].value == 16 * 12
    assert (failed["age"].value, failed["age"].limit) == (77, 40)
    assert failed["age"].detail == "or last seen more than 420 s ago"


def test_ground_beside_something_unknown_says_how_much_clearance_is_enough() -> None:
    """The sole fits, but its tests read an unknown cell: EDGE, with a sufficient clearance."""
    heights = np.zeros((120, 120))
    heights[60, 70] = np.nan
    terrain = grid(heights)
    x, y = terrain.geometry.centres()
    failed = reasons(terrain, x[60], y[60])
    assert set(failed) == {"edge"}
    assert failed["edge"].value == pytest.approx(9.5 * 0.005)
    enough = failed["edge"].limit
    open_ground = (terrain.clearance > enough) & (terrain.hazard & ~np.uint16(Hazard.EDGE) == 0)
    assert open_ground.any()
    assert not (terrain.hazard[open_ground] & Hazard.EDGE).any()


@pytest.fixture
def standing(robot: RobotModel) -> gp.TerrainGrid:
    """Flat known ground under and in front of the robot in its scan posture."""
    stance = Stance(robot.posture("scan"), robot.legs, (0, 0, -1))
    pose = robot.stance_pose(stance)
    base = gp.assess_terrain(np.zeros((200, 400)), 0.005, origin=(-1.0, -0.5))
    metadata = {
        **base.metadata,
        "robot": "guara",
        "stance": stance.to_dict(),
        "transform_base_to_footprint": pose.transform_base_to_footprint.tolist(),
    }
    return gp.TerrainGrid(layers=base.layers, geometry=base.geometry, record=ScanRecord.from_json(metadata))


def test_reach_is_that_of_the_leg(standing: gp.TerrainGrid, robot: RobotModel) -> None:
    """A leg reaches the ground below its hip; half a metre farther it does not, and the reason names the leg."""
    assert standing.check_foothold(0.3, 0.18, leg="lf")
    assert standing.check_foothold(0.8, 0.18)
    far = standing.check_foothold(0.8, 0.18, leg="lf")
    assert not far
    assert [reason.test for reason in far.reasons] == ["reach"]
    assert "lf" in far.reasons[0].detail
    assert not standing.check_foothold(0.3, 0.18, leg="rh")
    assert standing.check_foothold(0.3, 0.18, leg="lf", robot=robot)


def test_reach_agrees_with_the_kinematics(standing: gp.TerrainGrid, robot: RobotModel) -> None:
    """On perfect ground, the accepted area is the one that inverse kinematics reaches."""
    x, y = np.meshgrid(np.linspace(0.1, 0.5, 21), np.linspace(0.05, 0.35, 13))
    verdicts = standing.check_foothold(x, y, leg="lf")
    pose = robot.stance_pose(Stance.from_dict(standing.metadata["stance"]))
    in_base = np.stack((x, y, np.zeros_like(x)), axis=-1) - pose.transform_base_to_footprint[:3, 3]
    np.testing.assert_array_equal(verdicts.ok, robot.reachable("lf", in_base))
    assert verdicts.ok.any()
    assert not verdicts.ok.all()


@pytest.mark.slow
def test_a_grid_carries_its_robot(standing: gp.TerrainGrid) -> None:
    """The grid contains the description of an unknown robot; without it, the message says what to give."""
    tapir = load_robot(Path(__file__).parents[3] / "robots" / "tapir")
    stance = Stance(tapir.posture("scan"), tapir.legs)
    metadata = {
        **standing.metadata,
        "robot": "tapir",
        "robot_description": describe_robot(tapir),
        "stance": stance.to_dict(),
        "transform_base_to_footprint": tapir.stance_pose(stance).transform_base_to_footprint.tolist(),
    }
    carrying = dataclasses.replace(standing, record=ScanRecord.from_json(metadata))
    x, y = (values.ravel() for values in np.meshgrid(np.linspace(0.3, 0.6, 20), np.linspace(-0.2, 0.2, 9)))
    without_robot, with_robot = (
        carrying.check_foothold(x, y, leg="fl"),
        carrying.check_foothold(x, y, leg="fl", robot=tapir),
    )
    np.testing.assert_array_equal(without_robot.ok, with_robot.ok)
    np.testing.assert_allclose(without_robot.beyond, with_robot.beyond, atol=1e-9)
    assert np.isfinite(without_robot.beyond).any()
    bare = dataclasses.replace(standing, record=ScanRecord.from_json({**metadata, "robot_description": None}))
    with pytest.raises(RobotNotFound, match=r"give robot=load_robot\(FOLDER\)"):
        bare.check_foothold(0.45, 0.1, leg="fl")


def test_asking_for_a_leg_needs_a_stance(standing: gp.TerrainGrid) -> None:
    """A grid without a stance, and a leg that the robot does not have, are rejected."""
    with pytest.raises(gp.InvalidInput, match="lacks robot, stance, transform_base_to_footprint.*leg=None"):
        world(0).check_foothold(0.7, 0.0, leg="lf")
    with pytest.raises(KinematicsError, match="lf"):
        standing.check_foothold(0.3, 0.18, leg="left")


def test_a_limit_of_a_newer_version_is_left_out_and_its_flag_stays_a_hazard() -> None:
    """A grid with a newer limit is read; cells flagged by this limit are rejected, with the reason."""
    plain = grid(np.zeros((120, 120)))
    hazard, traversability = plain.hazard.copy(), plain.traversability.copy()
    hazard[40:60, 40:60] |= np.uint16(Hazard.STEP)
    traversability[40:60, 40:60] = 0.0
    metadata = {
        **plain.metadata,
        "limits": {**plain.metadata["limits"], "softness": 0.25},
        "limit_flags": {"softness": "STEP"},
    }
    layers = {**plain.layers, "hazard": hazard, "traversability": traversability}
    newer = dataclasses.replace(plain, layers=layers, record=ScanRecord.from_json(metadata))
    assert newer.record.required_limits == plain.record.required_limits
    flagged = (ORIGIN[0] + 50.5 * 0.005, ORIGIN[1] + 50.5 * 0.005)
    verdict = newer.check_foothold(*flagged)
    assert not verdict.ok
    assert "softness 0.25" in " ".join(str(reason) for reason in verdict.reasons)
    assert not newer.is_traversable(*flagged) and newer.best_foothold(*flagged, radius=0.02) is None
    away = (ORIGIN[0] + 0.45, ORIGIN[1] + 0.45)
    assert newer.check_foothold(*away).ok and newer.check_foothold(*away) == plain.check_foothold(*away)
    # The same without the name of the flag that the limit sets: the cells are rejected too.
    silent = {**metadata, "limit_flags": {}}
    assert not dataclasses.replace(newer, record=ScanRecord.from_json(silent)).check_foothold(*flagged).ok


def test_a_grid_of_an_older_version_lacks_the_limits_that_came_later() -> None:
    """A limit that the grid lacks keeps its default, with which nothing is rejected."""
    later = dataclasses.make_dataclass(
        "Later", [(name, float) for name in TraversabilityLimits.__slots__] + [("softness", float, np.inf)], slots=True
    )
    plain = grid(np.zeros((120, 120)))
    limits = later(**known_limits(plain.metadata["limits"], later))
    assert limits.softness == np.inf and limits.step == plain.record.required_limits.step


def test_a_grid_without_limits_is_refused() -> None:
    """Layers alone do not contain the limits of their assessment."""
    import dataclasses

    bare = dataclasses.replace(world(0), record=ScanRecord.from_json({}))
    with pytest.raises(gp.InvalidInput, match="limits = None; this query needs"):
        bare.check_foothold(0.7, 0.0)
