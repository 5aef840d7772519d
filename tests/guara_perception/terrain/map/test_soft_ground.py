"""Ground that gives way under a foot or is slippery, and its marks in the map."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.terrain.map.soft_ground import REACH_M, SoftFoothold, remembered, slid_feet, soft_cells, sunk_feet
from guara_perception.terrain.map.support_feet import SoleError, support_feet
from kinematics import LegOdometry, RobotModel
from testbed.analytic_walk import CompliantGround, Ground, Pause, free_soft_cells, scan, walk

LEGS = ("lf", "rf", "lh", "rh")
LEVEL = np.zeros((2, 2))


def soles(*residuals: float, sigma: float = 0.001) -> dict[str, SoleError]:
    """Errors of soles [m]."""
    arms = ((0.2, -0.3), (-0.2, -0.3), (0.2, 0.3), (-0.2, 0.3))
    return {leg: SoleError(r, sigma**2, arm) for leg, r, arm in zip(LEGS, residuals, arms, strict=False)}


@pytest.mark.parametrize("common", [0.0, 0.020, -0.020])
def test_a_foot_is_deeper_than_the_others(common: float) -> None:
    """For any error of odometry that all soles share."""
    found = sunk_feet(soles(common, common - 0.015, common, common + 0.001), 0.05**2, LEVEL)
    assert found == {"rf": pytest.approx(0.0153, abs=0.0002)}
    assert sunk_feet(soles(common, common + 0.015, common, common), 0.05**2, LEVEL) == {}


def test_feet_that_sank_one_after_the_other_are_all_found() -> None:
    """The height of the walk so far reveals all four; without it, none would stand out."""
    assert set(sunk_feet(soles(-0.015, -0.016, -0.020, -0.012), 0.0002**2, LEVEL)) == set(LEGS)
    assert sunk_feet(soles(-0.015, -0.016, -0.020, -0.016), 0.05**2, LEVEL) == {}
    assert sunk_feet({}, 0.0, LEVEL) == {}


def test_a_sole_beside_an_edge_did_not_sink() -> None:
    """The edge may be misplaced in the map: a sole at the height of the lower ground stands on it."""
    standing = soles(0.0, -0.020, 0.0, 0.0)
    assert sunk_feet(standing, 1e-6, LEVEL).keys() == {"rf"}
    assert sunk_feet({**standing, "rf": replace(standing["rf"], relief=0.018)}, 1e-6, LEVEL) == {}


@pytest.mark.parametrize("standing", [(0.0013, 0.0438), (0.0, 0.044, 0.0005), (0.0, 0.044, -0.020, 0.0)])
def test_beside_a_foot_that_stands_on_what_the_map_lacks_no_other_sank(standing: tuple[float, ...]) -> None:
    """On stairs, the map may have the lower tread under a sole on the upper one; a foot that sank is still found."""
    tilt = 0.0018**2 * np.eye(2)
    found = sunk_feet(soles(*standing, sigma=0.0013), 0.0008**2, tilt)
    assert set(found) == {leg for leg, height in zip(LEGS, standing, strict=False) if height < -0.01}


def test_a_foot_that_sank_stands_out_from_any_tilt() -> None:
    """Without an IMU, a tilt of three degrees lifts feet as a plane; a foot that sank is off this plane.

    The diagonally opposite foot may have sunk as well; with three feet at unknown height, a foot that sank looks like a
    tilt.
    """
    open_tilt = np.radians(3.0) ** 2 * np.eye(2)
    tilted = (0.016, 0.010, -0.006, -0.012)
    assert sunk_feet(soles(*tilted), 1e-6, open_tilt) == {}
    sunk = soles(tilted[0], tilted[1] - 0.020, *tilted[2:])
    found = sunk_feet(sunk, 1e-6, open_tilt)
    assert found == {"rf": pytest.approx(0.020, abs=0.002), "lh": pytest.approx(0.020, abs=0.003)}
    assert sunk_feet({leg: sunk[leg] for leg in ("lf", "rf", "lh")}, 0.05**2, open_tilt) == {}
    assert sunk_feet(soles(0.0, -0.010, 0.0, 0.0), 1e-6, np.radians(0.1) ** 2 * np.eye(2)).keys() == {"rf"}
    assert sunk_feet(soles(0.0, -0.010, 0.0, 0.0, sigma=0.002), 1e-6, open_tilt) == {}


def test_a_foot_slid_further_than_the_others() -> None:
    """A slide common to all feet is drift; beyond creep plus four sigma of two readings, ground is slippery."""
    aside = dict.fromkeys(LEGS, 0.002**2)
    assert slid_feet({"lf": 0.002, "rf": 0.048, "lh": 0.003}, ("rf",), aside) == {"rf": pytest.approx(0.0455)}
    assert slid_feet({"lf": 0.022, "rf": 0.048, "lh": 0.022}, ("rf",), aside) == {}
    assert slid_feet({"lf": 0.002, "rf": 0.048}, (), aside) == {}
    assert slid_feet({"lf": 0.002, "rf": 0.032}, ("rf",), dict.fromkeys(LEGS, 0.001**2)).keys() == {"rf"}
    assert slid_feet({"lf": 0.002, "rf": 0.032}, ("rf",), aside) == {}


def test_the_surface_goes_on_alike_until_it_steps_or_ends() -> None:
    """A level surface within reach; not beyond a step of a centimetre, nor beyond unknown ground."""
    heights = np.zeros((160, 160))
    heights[:, 100:] = 0.010
    heights[120, :] = np.nan
    found = soft_cells(heights, (-80, -80), 0.005, (SoftFoothold(0.0, 0.0),), 0.05)
    y, x = ((np.arange(160) - 80 + 0.5) * 0.005 for _ in range(2))
    near = np.hypot(x, y[:, None]) <= REACH_M
    expected = near & (np.arange(160) < 100) & (np.arange(160) < 120)[:, None]
    np.testing.assert_array_equal(found, expected)
    # Ground under the sole is soft whatever its steps.
    heights[75:85, 75:85] = np.arange(10) * 0.02
    assert soft_cells(heights, (-80, -80), 0.005, (SoftFoothold(0.0, 0.0),), 0.05)[76:84, 76:84].all()


def test_a_foothold_is_remembered_once() -> None:
    centres = [np.array([0.0, 0.0, 0.1]), np.array([0.01, 0.0, 0.1]), np.array([0.2, 0.0, 0.0])]
    soft = remembered((), centres)
    assert soft == (SoftFoothold(0.0, 0.0), SoftFoothold(0.2, 0.0))
    assert remembered(soft, centres) == soft


def foam(depth: float, seed: int = 0) -> CompliantGround:
    """Ground with a patch across the path that gives way, and nothing else before a ramp."""
    base = Ground.random(seed)
    return CompliantGround(base.boxes[:0], base.dark[:0], base.phases, soft=(0.5, 0.78), depth=depth)


def walked(robot: RobotModel, ground: Ground, cycles: int) -> tuple[gp.TerrainMap, list[gp.TerrainGrid], list[Pause]]:
    terrain_map, odometry = gp.TerrainMap(robot), LegOdometry(robot)
    *pauses, _ = walk(robot, ground, cycles, 0)
    fused = [terrain_map.update(scan(robot, ground, pause, 0), odometry.update(pause.stance)) for pause in pauses]
    return terrain_map, fused, pauses


@pytest.mark.slow
def test_hard_ground_raises_no_alarm(robot: RobotModel) -> None:
    """Boxes, ramps and joint noise: no foot sank, and no cell is soft."""
    _, fused, _ = walked(robot, Ground.random(0), 5)
    assert all(grid.record.sunk_feet is None for grid in fused)
    assert not any((grid.hazard & np.uint16(gp.Hazard.SOFT)).any() for grid in fused)


@pytest.mark.slow
def test_ground_that_gave_way_is_soft_and_no_foothold(robot: RobotModel, tmp_path: Path) -> None:
    """After a foot sank by 2 cm, no cell of the patch within reach is free; the map reports where and why."""
    ground = foam(0.020)
    terrain_map, fused, pauses = walked(robot, ground, 5)
    first = next(number for number, grid in enumerate(fused) if grid.record.sunk_feet)
    sank: list[np.ndarray] = []
    for grid, pause in zip(fused[first:], pauses[first:], strict=True):
        sank += [pause.soles_in_world[leg] for leg in grid.record.sunk_feet or {}]
        assert free_soft_cells(ground, pause.transform_base_to_world, grid, sank) == 0
        for leg in grid.record.sunk_feet or {}:
            assert ground.sink(*pause.soles_in_world[leg][:2]) > 0
            assert any(f"gave way under {leg}" in reason for reason in grid.record.health.reasons)
    soft = np.isfinite(fused[-1].elevation) & ((fused[-1].hazard & np.uint16(gp.Hazard.SOFT)) != 0)
    assert soft.any()
    iy, ix = (int(each[0]) for each in np.nonzero(soft))
    x, y = (float(axis[i]) for axis, i in zip(fused[-1].geometry.centres(), (ix, iy), strict=True))
    verdict = fused[-1].check_foothold(x, y)
    assert not verdict.ok and "soft" in {reason.test for reason in verdict.reasons}
    # Soft footholds are in the file.
    terrain_map.save(tmp_path / "map.npz")
    again = gp.TerrainMap.load(tmp_path / "map.npz", robot)
    odometry, upcoming = LegOdometry(robot), list(walk(robot, ground, 5, 0))
    poses = [odometry.update(pause.stance) for pause in upcoming]
    last = scan(robot, ground, upcoming[-1], 0)
    seen = terrain_map.view(last, poses[-1]).hazard
    assert (seen & np.uint16(gp.Hazard.SOFT)).any()
    np.testing.assert_array_equal(again.view(last, poses[-1]).hazard, seen)


@pytest.mark.slow
def test_a_sole_that_sank_does_not_become_known_ground(robot: RobotModel) -> None:
    """Unobserved cells under it stay unknown; those under a standing sole become known."""
    ground = foam(0.020)
    _, fused, pauses = walked(robot, ground, 3)
    number = next(number for number, grid in enumerate(fused) if grid.record.sunk_feet)
    before, odometry = gp.TerrainMap(robot), LegOdometry(robot)
    for pause in pauses[:number]:
        before.update(scan(robot, ground, pause, 0), odometry.update(pause.stance))
    pose, terrain, record = (
        odometry.update(pauses[number].stance),
        scan(robot, ground, pauses[number], 0),
        fused[number].record,
    )
    feet = support_feet(
        before._cells, robot, terrain, np.array(record.transform_footprint_to_odom), record.required_limits
    )
    # A third of the known cells under each sole is forgotten, as if no scan had observed it.
    memory = before._cells.memory
    gone = {foot.leg: foot.slot[::3] for foot in feet}
    for slot in gone.values():
        memory["height"][slot], memory["cause"][slot], memory["looks"][slot] = np.nan, int(gp.Hazard.UNSCANNED), 0
    sunk = set(before.update(terrain, pose).record.sunk_feet or {})
    assert sunk and sunk < set(gone)
    for leg, slot in gone.items():
        assert np.isfinite(memory["height"][slot]).all() == (leg not in sunk)
