"""What neighbouring cells of the map do not share: their own noise, and looks that one of them lacks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.terrain.layers.hazard import Hazard
from kinematics import PoseInOdom, RobotModel
from tests.guara_perception.terrain.map.poses import ZERO, MakeScan, at

# A pitch known to 0.2 degrees: 2.4 mm at x = 0.7, that all cells of a look share.
TILTED = np.zeros((6, 6))
TILTED[4, 4] = np.radians(0.2) ** 2
RECORD = {"pose_covariance": TILTED.tolist(), "attitude_source": "imu", "attitude_sigma": float(np.radians(0.2))}
LOOK_SIGMA_M, NOISE_M = 0.0005, 0.0002


def looked_at(fused: gp.TerrainGrid, x: float, y: float) -> tuple[float, float]:
    """Variance and local variance of a cell [m^2]."""
    iy, ix = (int(i) for i in fused.geometry.indices(x, y))
    return float(fused.variance[iy, ix]), float(fused.variance_local[iy, ix])


def test_looks_that_all_cells_have_are_shared(robot: RobotModel, make_scan: MakeScan) -> None:
    """The noise of a cell falls with its looks; the tilt that they share is in the total alone."""
    terrain_map = gp.TerrainMap(robot)
    for step in range(4):
        fused = terrain_map.update(make_scan(0.0, step=step, metadata=RECORD), PoseInOdom(at(), ZERO))
        total, local = looked_at(fused, 0.70, 0.0)
        assert local == pytest.approx(NOISE_M**2 / (step + 1), rel=0.02)
        # However many looks: the robot may see all of them with the same error.
        assert total >= (np.radians(0.2) * 0.70) ** 2


def test_a_look_that_a_neighbour_lacks_is_not_shared(robot: RobotModel, make_scan: MakeScan) -> None:
    """At the border of a second look: what one more look moves the mean by, and a last look of their own."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.0, metadata=RECORD), PoseInOdom(at(), ZERO))
    flags = np.zeros((108, 90), np.uint16)
    flags[:, 45:] = np.uint16(Hazard.UNSCANNED)
    fused = terrain_map.update(make_scan(0.0, flags=flags, step=1, metadata=RECORD), PoseInOdom(at(), ZERO))
    inside, twice, once = (looked_at(fused, x, 0.0)[1] for x in (0.60, 0.7175, 0.7325))
    look = (np.radians(0.2) * 0.725) ** 2 + LOOK_SIGMA_M**2
    assert inside == pytest.approx(NOISE_M**2 / 2, rel=0.02)
    # The means of one look and of two, the second its own: half a look's variance. No less is claimed.
    assert min(twice, once) > 0.5 * look
    assert looked_at(fused, 0.80, 0.0)[1] == pytest.approx(NOISE_M**2, rel=0.02)


def test_a_cell_of_many_looks_beside_one_of_a_single_look(robot: RobotModel, make_scan: MakeScan) -> None:
    """The last of four looks saw both: their difference has three quarters of the variance of one look, for both."""
    terrain_map = gp.TerrainMap(robot)
    flags = np.zeros((108, 90), np.uint16)
    flags[:, 45:] = np.uint16(Hazard.UNSCANNED)
    for step in range(3):
        terrain_map.update(make_scan(0.0, flags=flags, step=step, metadata=RECORD), PoseInOdom(at(), ZERO))
    fused = terrain_map.update(make_scan(0.0, step=3, metadata=RECORD), PoseInOdom(at(), ZERO))
    often, once = (looked_at(fused, x, 0.0)[1] for x in (0.7175, 0.7325))
    look = (np.radians(0.2) * 0.725) ** 2 + LOOK_SIGMA_M**2
    errors = np.random.default_rng(0).normal(0.0, np.sqrt(look), (20_000, 4))
    difference = float((errors.mean(axis=1) - errors[:, 3]).var())
    assert difference == pytest.approx(0.75 * look, rel=0.05)
    assert min(often, once) > 0.95 * difference


def test_cells_last_seen_at_different_pauses_each_have_a_look_of_their_own(
    robot: RobotModel, make_scan: MakeScan
) -> None:
    """Four looks beside one that none of them was: the difference has one and a quarter of a look's variance."""
    terrain_map = gp.TerrainMap(robot)
    flags = np.zeros((108, 90), np.uint16)
    flags[:, 45:] = np.uint16(Hazard.UNSCANNED)
    for step in range(4):
        terrain_map.update(make_scan(0.0, flags=flags, step=step, metadata=RECORD), PoseInOdom(at(), ZERO))
    others = np.uint16(Hazard.UNSCANNED) - flags
    fused = terrain_map.update(make_scan(0.0, flags=others, step=4, metadata=RECORD), PoseInOdom(at(), ZERO))
    look = (np.radians(0.2) * 0.725) ** 2 + LOOK_SIGMA_M**2
    assert min(looked_at(fused, x, 0.0)[1] for x in (0.7175, 0.7325)) > 1.25 * 0.95 * look


def test_ground_that_no_scan_saw_shares_nothing(robot: RobotModel, make_scan: MakeScan) -> None:
    """Beside declared ground a scanned height may err by all that the scan errs by."""
    flags = np.zeros((108, 90), np.uint16)
    flags[:, :20] = np.uint16(Hazard.UNSCANNED)
    declared = gp.KnownGround(((0.4, -0.3), (0.6, -0.3), (0.6, 0.3), (0.4, 0.3)), height=0.0, sigma=0.001)
    scan = make_scan(0.0, flags=flags, metadata=RECORD)
    fused = gp.TerrainMap(robot).update(scan, PoseInOdom(at(), ZERO), known_ground=[declared])
    _, beside = looked_at(fused, 0.6075, 0.0)
    assert beside > (np.radians(0.2) * 0.6) ** 2
    assert looked_at(fused, 0.58, 0.0)[1] == pytest.approx(0.001**2, rel=0.01)


@pytest.mark.parametrize("sigma", [float("nan"), float("inf"), -0.1, "2 degrees"])
def test_an_attitude_of_no_sigma_is_refused(robot: RobotModel, make_scan: MakeScan, sigma: object) -> None:
    """A comparison with NaN is False: no slope would be too steep."""
    scan = make_scan(0.0, metadata={**RECORD, "attitude_sigma": sigma})
    with pytest.raises(gp.InvalidInput, match="attitude_sigma = "):
        gp.TerrainMap(robot).update(scan, PoseInOdom(at(), ZERO))


def test_a_map_of_before_has_the_total_alone(robot: RobotModel, make_scan: MakeScan, tmp_path: Path) -> None:
    """Its file is read: all of the variance counts as the cell's own."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.0, metadata=RECORD), PoseInOdom(at(), ZERO))
    terrain_map.save(tmp_path / "now.npz")
    with np.load(tmp_path / "now.npz") as file:
        old = {name: array for name, array in file.items() if name != "local"}
    np.savez(tmp_path / "before.npz", **old)
    nothing = make_scan(0.0, flags=np.full((108, 90), Hazard.UNSCANNED, np.uint16), step=1, metadata=RECORD)
    fused = gp.TerrainMap.load(tmp_path / "before.npz", robot).update(nothing, PoseInOdom(at(), ZERO))
    _, local = looked_at(fused, 0.70, 0.0)
    assert local == pytest.approx((np.radians(0.2) * 0.70) ** 2 + LOOK_SIGMA_M**2 + NOISE_M**2, rel=0.02)
