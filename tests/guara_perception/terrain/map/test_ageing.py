"""Heights of the rolling map age by pauses and by seconds, and become stale."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.settings import Settings
from guara_perception.terrain.layers.hazard import Hazard
from kinematics import PoseInOdom, RobotModel
from tests.guara_perception.terrain.map.poses import AROUND, POINT, ZERO, MakeScan, at, drift, only


def test_time_that_runs_backwards_makes_what_was_seen_before_stale(robot: RobotModel, make_scan: MakeScan) -> None:
    """If a clock is set back by an hour, the age of the cells is unknown: they are STALE, with a health reason."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.0, stamp=10_000 * 10**9), PoseInOdom(at(), ZERO))
    away = at(0.3)
    later = terrain_map.update(make_scan(0.0, step=1, stamp=(10_000 + 1_000 - 3_600) * 10**9), PoseInOdom(away, ZERO))
    old = np.isfinite(later.elevation) & (later.age > 0)
    assert old.any() and ((later.hazard[old] & Hazard.STALE) != 0).all()
    assert any("went back by 2.6e+03 s" in reason for reason in later.metadata["health"]["reasons"])


def test_cells_age_by_the_clock_that_is_given(robot: RobotModel, make_scan: MakeScan) -> None:
    """The wall clock was set back, but on a monotonic clock 1,000 s exceed the validity of 420 s."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.0, stamp=10_000 * 10**9), PoseInOdom(at(), ZERO), time=50.0)
    later = terrain_map.update(make_scan(0.0, step=1, stamp=7_400 * 10**9), PoseInOdom(at(0.3), ZERO), time=1_050.0)
    old = np.isfinite(later.elevation) & (later.age > 0)
    assert old.any() and ((later.hazard[old] & Hazard.STALE) != 0).all()
    assert later.metadata["health"]["level"] == "ok"


def test_ground_turns_stale_by_pauses_and_by_seconds(robot: RobotModel, make_scan: MakeScan, scan_grid: Any) -> None:
    """A height beyond either validity of robot.toml is STALE; a new observation makes it fresh."""
    validity = Settings.of(robot)
    hidden = only(Hazard.UNSCANNED, scan_grid, AROUND)
    by_pauses = gp.TerrainMap(robot)
    by_pauses.update(make_scan(0.0, step=0, stamp=1), PoseInOdom(at(), ZERO))
    last = validity.validity_pauses
    still = by_pauses.update(make_scan(0.0, flags=hidden, step=last, stamp=2), PoseInOdom(at(), ZERO))
    assert still.hazard_at(*POINT) == Hazard.NONE
    stale = by_pauses.update(make_scan(0.0, flags=hidden, step=last + 1, stamp=3), PoseInOdom(at(), ZERO))
    assert stale.hazard_at(*POINT) & Hazard.STALE
    assert stale.height_at(*POINT) == 0.0
    fresh = by_pauses.update(make_scan(0.0, step=last + 2, stamp=4), PoseInOdom(at(), ZERO))
    assert fresh.hazard_at(*POINT) == Hazard.NONE
    by_seconds = gp.TerrainMap(robot)
    by_seconds.update(make_scan(0.0, step=0, stamp=10**9), PoseInOdom(at(), ZERO))
    late = 10**9 + int((validity.validity_seconds + 1) * 1e9)
    assert (
        by_seconds.update(make_scan(0.0, flags=hidden, step=1, stamp=late), PoseInOdom(at(), ZERO)).hazard_at(*POINT)
        & Hazard.STALE
    )


def test_validity_outlasts_what_a_hind_foot_needs(robot: RobotModel) -> None:
    """Nine cycles of four pauses of 18.7 s each."""
    validity = Settings.of(robot)
    assert validity.validity_pauses >= 36
    assert validity.validity_seconds >= 9 * 18.7


@pytest.mark.slow
def test_cells_seen_by_another_clock_are_stale(robot: RobotModel, make_scan: MakeScan, tmp_path: Path) -> None:
    """A map filled by the wall clock, then updated by a clock that started at boot: the age of cells is unknown."""
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.0, stamp=10_000 * 10**9), PoseInOdom(at(), ZERO))
    terrain_map.save(tmp_path / "map.npz")
    loaded = gp.TerrainMap.load(tmp_path / "map.npz", robot)
    later = loaded.update(make_scan(0.0, step=1, stamp=10_001 * 10**9), PoseInOdom(at(0.3), ZERO), time=50.0)
    old = np.isfinite(later.elevation) & (later.age > 0)
    assert old.any() and ((later.hazard[old] & Hazard.STALE) != 0).all()


@pytest.mark.parametrize("is_registered", [True, False])
def test_a_view_drifts_as_far_as_its_pose_may(robot: RobotModel, make_scan: MakeScan, is_registered: bool) -> None:
    """From a pose that is sure to 30 mm no ground of before is safe, as after a scan of nothing; from 7 mm, less is."""
    hidden = np.full(make_scan(0.0).shape, np.uint16(Hazard.UNSCANNED))
    free = {}
    for sigma in (0.0, 0.007, 0.030):
        unsure = drift(shift=sigma, turn=0.3 * sigma)
        poses = [PoseInOdom(at(), each, each if is_registered else None) for each in (ZERO, unsure)]
        terrain_map = gp.TerrainMap(robot)
        before = terrain_map.update(make_scan(0.0, step=0), poses[0])
        viewed = terrain_map.view(make_scan(0.0, step=1), poses[1])
        fused = terrain_map.update(make_scan(0.0, flags=hidden, step=1), poses[1])
        free[sigma] = int((viewed.hazard == 0).sum())
        assert not ((viewed.hazard == 0) & (fused.hazard != 0)).any() and (before.hazard == 0).any()
        if sigma == 0.030:
            assert (viewed.hazard[np.isfinite(viewed.elevation)] & Hazard.STALE).all()
    assert free[0.0] >= free[0.007] > free[0.030] == 0
