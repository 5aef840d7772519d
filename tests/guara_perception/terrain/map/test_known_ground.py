"""Ground that no scan observed: under the soles, and declared by the gait."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.settings import Settings
from guara_perception.terrain.layers.geometry import inside_polygon
from guara_perception.terrain.layers.hazard import Hazard
from kinematics import PoseInOdom, RobotModel
from tests.guara_perception.terrain.map.poses import AROUND, POINT, ZERO, MakeScan, at, drift, only, stance_metadata


def test_soles_make_ground_known_that_no_scan_saw(robot: RobotModel, make_scan: MakeScan) -> None:
    """Under each sole z = 0 is known, with looks 0; 50 mm beside it nothing is; no such cell is traversable."""
    fused = gp.TerrainMap(robot).update(make_scan(0.0, metadata=stance_metadata(robot)), PoseInOdom(at(), ZERO))
    for x in (-0.3, 0.3):
        for y in (-0.18, 0.18):
            assert fused.height_at(x, y) == pytest.approx(0.0, abs=1e-6)
            iy, ix = (int(i) for i in fused.geometry.indices(x, y))
            assert fused.looks[iy, ix] == 0
            assert not fused.is_traversable(x, y)
            assert np.isnan(fused.height_at(x, y + 0.05))
    assert set(fused.metadata["support_residuals"]) == set(robot.legs)
    assert all(residual is None for residual in fused.metadata["support_residuals"].values())


def test_the_residual_of_each_sole_is_published_and_holds_the_height(robot: RobotModel, make_scan: MakeScan) -> None:
    """A map 3 mm below the soles, with uncertain odometry: residuals of 3 mm, and the walk's height is corrected."""
    terrain_map = gp.TerrainMap(robot)
    # Two scans from farther back bring the ground under all four feet into the map.
    for step, x in enumerate((-1.1, -0.75, -0.5)):
        terrain_map.update(make_scan(0.0, step=step), PoseInOdom(at(x), ZERO))
    pause = make_scan(0.0, step=3, metadata=stance_metadata(robot))
    fused = terrain_map.update(pause, PoseInOdom(at(0.0, z=0.003), drift(0.01)))
    residuals = fused.metadata["support_residuals"]
    assert all(residual == pytest.approx(0.003, abs=3e-4) for residual in residuals.values() if residual is not None)
    assert sum(residual is not None for residual in residuals.values()) == 4
    assert fused.metadata["height_correction"] == pytest.approx(-0.003, abs=3e-4)
    assert fused.metadata["transform_footprint_to_odom"][2][3] == pytest.approx(0.0, abs=3e-4)
    assert fused.height_at(-0.3, 0.18) == pytest.approx(0.0, abs=5e-4)


def test_a_sole_that_stands_far_off_is_not_used_but_named(robot: RobotModel, make_scan: MakeScan) -> None:
    """20 mm are no drift of 1 mm: nothing is corrected, and the map's health names the soles."""
    terrain_map = gp.TerrainMap(robot)
    for step, x in enumerate((-1.1, -0.75, -0.5)):
        terrain_map.update(make_scan(0.0, step=step), PoseInOdom(at(x), ZERO))
    pause = make_scan(0.0, step=3, metadata=stance_metadata(robot))
    fused = terrain_map.update(pause, PoseInOdom(at(0.0, z=0.020), drift(0.001)))
    assert fused.metadata["height_correction"] == 0.0
    assert fused.metadata["health"]["level"] == "degraded"
    assert any("the sole of lf is ignored: it is +20" in reason for reason in fused.metadata["health"]["reasons"])


def test_declared_ground_is_known_and_marked(robot: RobotModel, make_scan: MakeScan, scan_grid: Any) -> None:
    """Known only inside the polygon, with its height and sigma, looks 0, listed in the metadata; scans weigh more."""
    ground = gp.KnownGround(np.array([[-0.5, -0.3], [0.45, -0.3], [0.45, 0.3], [-0.5, 0.3]]), 0.0, 0.002)
    dark = only(Hazard.DROPOUT, scan_grid, AROUND)
    fused = gp.TerrainMap(robot).update(make_scan(0.0, flags=dark), PoseInOdom(at(), ZERO), known_ground=[ground])
    assert fused.height_at(0.0, 0.0) == 0.0
    assert fused.is_traversable(0.0, 0.0)
    iy, ix = (int(i) for i in fused.geometry.indices(0.0, 0.0))
    assert fused.looks[iy, ix] == 0
    assert np.sqrt(fused.variance[iy, ix]) == pytest.approx(0.002)
    assert np.isnan(fused.height_at(0.475, 0.0))
    assert np.isnan(fused.height_at(-0.55, 0.0))
    (patch,) = fused.metadata["known_ground"]
    assert patch["step"] == 0
    assert patch["cells"] == 190 * 120
    everywhere = gp.KnownGround(np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), 0.05, 0.0)
    over = gp.TerrainMap(robot).update(make_scan(0.0, flags=dark), PoseInOdom(at(), ZERO), known_ground=[everywhere])
    assert over.height_at(0.6, 0.1) == 0.0
    assert over.hazard_at(*POINT) & Hazard.DROPOUT


def test_a_notch_narrower_than_a_cell_stays_unknown(robot: RobotModel, make_scan: MakeScan) -> None:
    """A notch between centre and corner of a cell is detected, because nobody declared it."""
    notch = [[0.001, -0.3], [0.001, 0.1], [0.002, 0.1], [0.002, -0.3]]
    ground = gp.KnownGround(np.array([[-0.5, -0.3], *notch, [0.45, -0.3], [0.45, 0.3], [-0.5, 0.3]]), 0.0, 0.002)
    fused = gp.TerrainMap(robot).update(make_scan(flags=4), PoseInOdom(at(), ZERO), known_ground=[ground])
    assert np.isnan(fused.height_at(0.0025, 0.0)) and not fused.is_traversable(0.0025, 0.0)
    assert fused.height_at(-0.0025, 0.0) == fused.height_at(0.0025, 0.1025) == 0.0
    (patch,) = fused.metadata["known_ground"]
    assert patch["cells"] == 190 * 120 - 80


def test_declared_ground_that_a_scan_contradicts_is_a_conflict(robot: RobotModel, make_scan: MakeScan) -> None:
    """The gait declared 0, the scan measures 30 mm: CONFLICT until a second observation agrees with the first."""
    terrain_map = gp.TerrainMap(robot)
    nothing = np.full((108, 90), np.uint16(Hazard.UNSCANNED))
    ground = gp.KnownGround(np.array([[0.5, -0.2], [0.9, -0.2], [0.9, 0.2], [0.5, 0.2]]), 0.0, 0.001)
    terrain_map.update(make_scan(0.0, flags=nothing), PoseInOdom(at(), ZERO), known_ground=[ground])
    assert terrain_map.update(make_scan(0.03, step=1), PoseInOdom(at(), ZERO)).hazard_at(*POINT) & Hazard.CONFLICT
    assert terrain_map.update(make_scan(0.03, step=2), PoseInOdom(at(), ZERO)).height_at(*POINT) == pytest.approx(
        0.03, abs=1e-4
    )


@pytest.mark.parametrize(
    ("outline", "height", "sigma"),
    [
        ([[0, 0], [1, 0]], 0.0, 0.0),
        ([[0, 0], [1, 0], [1, np.nan]], 0.0, 0.0),
        (np.eye(3), np.inf, 0.0),
        (np.eye(3), 0, 0),
        (np.zeros((30_000, 2)), 0.0, 0.0),
    ],
)
def test_invalid_known_ground_is_refused(outline: Any, height: float, sigma: float) -> None:
    """Two corners, NaN, three columns, infinite height and very long outlines are rejected."""
    with pytest.raises(gp.InvalidInput, match="known ground"):
        gp.KnownGround(outline, height, sigma)
    with pytest.raises(gp.InvalidInput, match="sigma 0 or more"):
        gp.KnownGround(np.array([[0, 0], [1, 0], [1, 1]]), 0.0, -1.0)


def test_patches_one_over_the_other_test_each_cell_once(
    robot: RobotModel, make_scan: MakeScan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of sixteen patches over the whole map, half of it covered by the first, later ones test the other half only."""
    tested: list[int] = []

    def counted(corners: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        tested.append(x.size)
        return inside_polygon(corners, x, y)

    monkeypatch.setattr("guara_perception.terrain.map.known_ground.inside_polygon", counted)
    half = gp.KnownGround([(0.0, -9.0), (9.0, -9.0), (9.0, 9.0), (0.0, 9.0)], 0.0, 0.002)
    edge = np.linspace(-9.0, 9.0, 8)
    comb = gp.KnownGround([*((x, -9.0) for x in edge), *((x, 9.0) for x in edge[::-1])], 0.0, 0.002)
    fused = gp.TerrainMap(robot).update(make_scan(flags=4), PoseInOdom(at(), ZERO), known_ground=[half, *[comb] * 15])
    assert np.isfinite(fused.elevation).all()
    assert tested[1] == tested[0] > 100_000
    assert max(tested[2:]) == 0


def test_ground_declared_over_a_wide_area_costs_no_more_than_the_map(robot: RobotModel, make_scan: MakeScan) -> None:
    """A square kilometre: only the part in the map's window is processed, in bounded memory."""
    terrain_map = gp.TerrainMap(robot)
    whole = gp.KnownGround([(-500.0, -500.0), (500.0, -500.0), (500.0, 500.0), (-500.0, 500.0)], 0.0, 0.002)
    tracemalloc.start()
    fused = terrain_map.update(make_scan(flags=4), PoseInOdom(at(), ZERO), known_ground=[whole])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert np.isfinite(fused.elevation).all() and peak < 300e6


@pytest.mark.slow
def test_declared_ground_in_the_metadata_does_not_grow_without_end(robot: RobotModel, make_scan: MakeScan) -> None:
    """Declared at each pause: of patches that filled nothing, only the newest is listed; none after its validity."""
    terrain_map, pauses = gp.TerrainMap(robot), Settings.of(robot).validity_pauses + 10
    patch = gp.KnownGround(np.array([(-0.2, -0.1), (0.2, -0.1), (0.2, 0.1), (-0.2, 0.1)]), 0.0, 0.005)
    counts, steps = [], []
    for step in range(pauses):
        fused = terrain_map.update(
            make_scan(0.0, step=step), PoseInOdom(at(0.01 * step), drift(1e-6 * step)), known_ground=[patch]
        )
        named = fused.metadata["known_ground"]
        counts.append(len(named))
        steps.append(min(entry["step"] for entry in named))
        assert all(entry["cells"] for entry in named[:-1]) and named[-1]["step"] == step
    assert max(counts) <= Settings.of(robot).validity_pauses + 1
    assert steps[-1] >= pauses - 1 - Settings.of(robot).validity_pauses
