"""Variance that neighbouring cells of the map do not share: their own noise, and looks that one of them lacks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.terrain.layers.hazard import Hazard
from kinematics import PoseInOdom, RobotModel
from tests.guara_perception.terrain.map.poses import ZERO, MakeScan, at

# A pitch known to 0.2 degrees: 2.4 mm at x = 0.7, shared by all cells of a look.
TILTED = np.zeros((6, 6))
TILTED[4, 4] = np.radians(0.2) ** 2
RECORD = {"pose_covariance": TILTED.tolist(), "attitude_source": "imu", "attitude_sigma": float(np.radians(0.2))}
LOOK_SIGMA_M, NOISE_M = 0.0005, 0.0002


def looked_at(fused: gp.TerrainGrid, x: float, y: float) -> tuple[float, float]:
    """Variance and local variance of a cell [m^2]."""
    iy, ix = (int(i) for i in fused.geometry.indices(x, y))
    return float(fused.variance[iy, ix]), float(fused.variance_local[iy, ix])


def test_looks_that_all_cells_have_are_shared(robot: RobotModel, make_scan: MakeScan) -> None:
    """The noise of a cell decreases with its looks; the tilt that they share is only in the total variance."""
    terrain_map = gp.TerrainMap(robot)
    for step in range(4):
        fused = terrain_map.update(make_scan(0.0, step=step, metadata=RECORD), PoseInOdom(at(), ZERO))
        total, local = looked_at(fused, 0.70, 0.0)
        assert local == pytest.approx(NOISE_M**2 / (step + 1), rel=0.02)
        # For any number of looks, because all of them may have the same error.
        assert total >= (np.radians(0.2) * 0.70) ** 2


def seam(robot: RobotModel, make_scan: MakeScan, heights: list[float], first: list[bool]) -> gp.TerrainGrid:
    """Map of level looks, each with its own height; looks marked by `first` observed only cells nearer than 0.725 m."""
    terrain_map = gp.TerrainMap(robot)
    for step, (height, near) in enumerate(zip(heights, first, strict=True)):
        flags = np.zeros((108, 90), np.uint16)
        flags[:, 45:] = np.uint16(Hazard.UNSCANNED) * near
        scan = make_scan(height, flags=flags, step=step, metadata=RECORD)
        fused = terrain_map.update(scan, PoseInOdom(at(), ZERO))
    return fused


def unshared_at(fused: gp.TerrainGrid) -> tuple[float, float]:
    """Difference across the seam of `seam` [m], and its sigma from the cells' local variances [m]."""
    iy, ix = (int(i) for i in fused.geometry.indices(0.7225, 0.0))
    local = fused.variance_local[iy, ix : ix + 2].astype(np.float64)
    return float(fused.elevation[iy, ix + 1] - fused.elevation[iy, ix]), float(np.sqrt(local.sum()))


@pytest.mark.parametrize(
    ("heights", "first"),
    [
        # The near cells alone have the second look; the last of two, and of four, is the only look of the far cells.
        ([0.0, 0.003], [False, True]),
        ([0.0, 0.003], [True, False]),
        ([0.0, 0.0, 0.0, 0.003], [True, True, True, False]),
        ([0.0, 0.0, 0.004, 0.002, 0.0], [True, True, False, False, True]),
    ],
)
def test_looks_that_a_neighbour_lacks_are_not_shared(
    robot: RobotModel, make_scan: MakeScan, heights: list[float], first: list[bool]
) -> None:
    """If such looks deviate, the two cells differ, by as much as their variances predict."""
    fused = seam(robot, make_scan, heights, first)
    difference, sigma = unshared_at(fused)
    assert abs(difference) > 0.0003
    assert abs(difference) < 2.0 * sigma < 12.0 * abs(difference)
    # Within one set of looks, cells differ by their noise only.
    assert looked_at(fused, 0.60, 0.0)[1] == pytest.approx(NOISE_M**2 / len(heights), rel=0.02)


def test_looks_that_agree_are_no_reason_to_doubt(robot: RobotModel, make_scan: MakeScan) -> None:
    """An IMU with a constant error tilts all looks alike, so they measured the ground at one height."""
    _, sigma = unshared_at(seam(robot, make_scan, [0.0, 0.0], [False, True]))
    assert sigma == pytest.approx(np.sqrt(1.5) * NOISE_M, rel=0.02)


def test_a_seam_between_looks_is_in_the_sigma_of_slopes(robot: RobotModel, make_scan: MakeScan) -> None:
    """A step of 2 mm between looks may hide six degrees of the slope of a disc."""
    slope = np.tan(np.radians(16.0))
    x = np.broadcast_to(np.arange(90) * 0.005 * slope, (108, 90))
    steep = {}
    for height in (0.0, 0.004):
        terrain_map = gp.TerrainMap(robot)
        flags = np.zeros((108, 90), np.uint16)
        terrain_map.update(make_scan(x, metadata=RECORD), PoseInOdom(at(), ZERO))
        flags[:, 45:] = np.uint16(Hazard.UNSCANNED)
        fused = terrain_map.update(make_scan(x + height, flags=flags, step=1, metadata=RECORD), PoseInOdom(at(), ZERO))
        iy, ix = (int(i) for i in fused.geometry.indices(0.7225, 0.0))
        steep[height] = bool(fused.hazard[iy, ix] & np.uint16(Hazard.STEEP))
    assert steep == {0.0: False, 0.004: True}


@pytest.mark.parametrize("yaw", [0.0, 0.4])
def test_cells_of_a_turned_grid_lie_elsewhere_by_ways_of_their_own(
    robot: RobotModel, make_scan: MakeScan, yaw: float
) -> None:
    """On a slope of 15 degrees, nearest cells err by up to 1.3 mm, all alike in grids that are not rotated."""
    slope = np.tan(np.radians(15.0))
    along = np.broadcast_to(np.arange(90) * 0.005 * slope, (108, 90))
    terrain_map, seen, now = gp.TerrainMap(robot), at(0.0011, 0.0023, yaw), at(0.0, 0.0, -yaw)
    terrain_map.update(make_scan(along, metadata=RECORD), PoseInOdom(seen, ZERO))
    view = terrain_map.view(make_scan(0.0, step=1, metadata=RECORD), PoseInOdom(now, ZERO))
    x, y = np.meshgrid(*view.geometry.centres())
    to_scan = np.linalg.inv(seen) @ now
    error = view.elevation - slope * (to_scan[0, 0] * x + to_scan[0, 1] * y + to_scan[0, 3] - 0.5025)
    local = view.variance_local.astype(np.float64)
    ratios = (error[:, 3:] - error[:, :-3]) / np.sqrt(local[:, 3:] + local[:, :-3])
    ratios = ratios[np.isfinite(ratios)]
    assert ratios.size > 1000 and (np.abs(ratios) < 2.0).mean() > 0.93
    assert (float(np.std(ratios)) > 0.7) == (yaw > 0.0)


def test_cells_last_seen_at_different_pauses_each_have_a_look_of_their_own(
    robot: RobotModel, make_scan: MakeScan
) -> None:
    """Four looks beside one other look: the difference has 1.25 times the variance of one look."""
    terrain_map = gp.TerrainMap(robot)
    flags = np.zeros((108, 90), np.uint16)
    flags[:, 45:] = np.uint16(Hazard.UNSCANNED)
    for step in range(4):
        terrain_map.update(make_scan(0.0, flags=flags, step=step, metadata=RECORD), PoseInOdom(at(), ZERO))
    others = np.uint16(Hazard.UNSCANNED) - flags
    fused = terrain_map.update(make_scan(0.0, flags=others, step=4, metadata=RECORD), PoseInOdom(at(), ZERO))
    look = (np.radians(0.2) * 0.725) ** 2 + LOOK_SIGMA_M**2
    assert unshared_at(fused)[1] ** 2 > 1.25 * 0.95 * look


def test_ground_that_no_scan_saw_shares_nothing(robot: RobotModel, make_scan: MakeScan) -> None:
    """Beside declared ground, a scanned height may have the whole error of its scan."""
    flags = np.zeros((108, 90), np.uint16)
    flags[:, :20] = np.uint16(Hazard.UNSCANNED)
    declared = gp.KnownGround(((0.4, -0.3), (0.6, -0.3), (0.6, 0.3), (0.4, 0.3)), height=0.0, sigma=0.001)
    scan = make_scan(0.0, flags=flags, metadata=RECORD)
    fused = gp.TerrainMap(robot).update(scan, PoseInOdom(at(), ZERO), known_ground=[declared])
    declared_at, beside = (looked_at(fused, x, 0.0)[1] for x in (0.5925, 0.6075))
    assert declared_at + beside > (np.radians(0.2) * 0.6) ** 2 + 0.001**2
    assert looked_at(fused, 0.58, 0.0)[1] == pytest.approx(0.001**2, rel=0.01)


@pytest.mark.parametrize("sigma", [float("nan"), float("inf"), -0.1, "2 degrees"])
def test_an_attitude_of_no_sigma_is_refused(robot: RobotModel, make_scan: MakeScan, sigma: object) -> None:
    """Comparisons with NaN are False, so no slope would be too steep."""
    scan = make_scan(0.0, metadata={**RECORD, "attitude_sigma": sigma})
    with pytest.raises(gp.InvalidInput, match="attitude_sigma = "):
        gp.TerrainMap(robot).update(scan, PoseInOdom(at(), ZERO))


def test_looks_of_a_map_of_before_differ_as_claimed(robot: RobotModel, make_scan: MakeScan, tmp_path: Path) -> None:
    """Files of earlier versions lack the measured differences, so the stated variances are used."""
    terrain_map = gp.TerrainMap(robot)
    flags = np.zeros((108, 90), np.uint16)
    flags[:, 45:] = np.uint16(Hazard.UNSCANNED)
    for step, seen in enumerate((0, flags)):
        terrain_map.update(make_scan(0.0, flags=seen, step=step, metadata=RECORD), PoseInOdom(at(), ZERO))
    terrain_map.save(tmp_path / "now.npz")
    with np.load(tmp_path / "now.npz") as file:
        np.savez(tmp_path / "before.npz", **{name: array for name, array in file.items() if name != "apart"})
    now = make_scan(0.0, step=2, metadata=RECORD), PoseInOdom(at(), ZERO)
    before, after = (gp.TerrainMap.load(tmp_path / f"{name}.npz", robot).view(*now) for name in ("before", "now"))
    look = (np.radians(0.2) * 0.725) ** 2 + LOOK_SIGMA_M**2
    assert unshared_at(before)[1] ** 2 > 0.5 * look > unshared_at(after)[1] ** 2


def test_a_map_of_before_has_the_total_alone(robot: RobotModel, make_scan: MakeScan, tmp_path: Path) -> None:
    """In files of earlier versions, the whole variance counts as local."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.0, metadata=RECORD), PoseInOdom(at(), ZERO))
    terrain_map.save(tmp_path / "now.npz")
    with np.load(tmp_path / "now.npz") as file:
        old = {name: array for name, array in file.items() if name not in ("local", "apart")}
    np.savez(tmp_path / "before.npz", **old)
    nothing = make_scan(0.0, flags=np.full((108, 90), Hazard.UNSCANNED, np.uint16), step=1, metadata=RECORD)
    fused = gp.TerrainMap.load(tmp_path / "before.npz", robot).update(nothing, PoseInOdom(at(), ZERO))
    _, local = looked_at(fused, 0.70, 0.0)
    assert local == pytest.approx((np.radians(0.2) * 0.70) ** 2 + LOOK_SIGMA_M**2 + NOISE_M**2, rel=0.02)
