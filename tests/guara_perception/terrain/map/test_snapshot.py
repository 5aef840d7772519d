"""A cell of a snapshot combines all map cells that it touches, at any rotation."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from guara_perception.settings import Settings
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import Hazard
from guara_perception.terrain.map.fuse_heights import MapPause, OdometryDrift
from guara_perception.terrain.map.odom_cells import SHRUNK_M, OdomCells
from guara_perception.terrain.map.snapshot import snapshot_layers
from guara_perception.terrain.map.walk_correction import SidewaysDrift
from kinematics import RobotModel

RESOLUTION = 0.005
GRID = GridGeometry.over((-0.15, 0.15), (-0.1, 0.1), RESOLUTION)
NOW = 200


def memory_of_a_walk(seed: int, reach: float) -> OdomCells:
    """Random cells in every state: known, unknown, in conflict, old."""
    rng = np.random.default_rng(seed)
    cells = OdomCells(RESOLUTION, 2 * (int(np.ceil(reach / RESOLUTION)) + 1))
    cells.centre_on(1.0, -0.5)
    memory, n = cells.memory, cells.side**2
    is_unknown = rng.random(n) < 0.03
    memory["height"][:] = np.where(is_unknown, np.nan, rng.normal(0, 0.002, n))
    memory["cause"][:] = np.where(is_unknown, rng.choice([1, 2, 4, 16, 33], n), 0)
    for name in ("below", "above"):
        memory[name][:] = np.abs(rng.normal(0, 0.001, n))
    memory["variance"][:] = 1e-8
    memory["conflict"][:] = ~is_unknown & (rng.random(n) < 0.02)
    memory["pause"][:] = np.where(rng.random(n) < 0.03, 1, NOW)
    memory["stamp"][:] = 0
    memory["looks"][:] = rng.integers(0, 9, n)
    return cells


@pytest.mark.parametrize("yaw", [0.0, 0.3, np.pi / 4, -2.0])
@pytest.mark.parametrize("reach", [0.5, 0.12], ids=["inside", "reaching out of the window"])
def test_each_cell_holds_what_the_cells_that_it_touches_hold(
    robot: RobotModel, make_scan: Any, yaw: float, reach: float
) -> None:
    """Union of their flags, their lowest and highest sample, and the height of the one under its centre."""
    cells, settings = memory_of_a_walk(int(10 * yaw) + 100, reach), Settings.of(robot)
    transform = np.eye(4)
    transform[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    transform[:3, 3] = 1.003, -0.497, 0.01
    now = MapPause(NOW, 0, OdometryDrift(), SidewaysDrift(), transform)
    layers = snapshot_layers(cells, GRID, make_scan(), now, settings)

    x, y = (a.ravel() for a in np.meshgrid(*GRID.centres()))
    in_odom = np.column_stack((x, y)) @ transform[:2, :2].T + transform[:2, 3]
    half = 0.5 * RESOLUTION * (abs(np.cos(yaw)) + abs(np.sin(yaw)))
    reached = half - SHRUNK_M
    memory = cells.memory
    flags = np.zeros(x.size, np.uint16)
    low, high = np.full(x.size, np.inf), np.full(x.size, -np.inf)
    # A square of less than two cells touches only the cells under its corners, edge centres and centre.
    for dx, dy in itertools.product((-reached, 0.0, reached), repeat=2):
        slot = cells.slots(*cells.indices(in_odom[:, 0] + dx, in_odom[:, 1] + dy))
        height = memory["height"][slot]
        is_old = (NOW - memory["pause"][slot] > settings.validity_pauses) & np.isfinite(height)
        of_cell = memory["cause"][slot] | np.where(memory["conflict"][slot], Hazard.CONFLICT, 0)
        of_cell = of_cell | np.where(is_old, Hazard.STALE, 0)
        flags |= np.where(slot < 0, Hazard.UNSCANNED, of_cell).astype(np.uint16)
        low = np.fmin(low, height - memory["below"][slot])
        high = np.fmax(high, height + memory["above"][slot])
    known = (flags & 0xFF) == 0
    centre = cells.slots(*cells.indices(in_odom[:, 0], in_odom[:, 1]))

    reported = layers["hazard"].ravel() & np.uint16(0xFF | Hazard.CONFLICT | Hazard.STALE)
    np.testing.assert_array_equal(reported, flags)
    assert known.any() and (flags & Hazard.CONFLICT).any() and (flags & Hazard.STALE).any()
    for name, expected in (
        ("elevation", memory["height"][centre] - 0.01),
        ("elevation_min", low - 0.01),
        ("elevation_max", high - 0.01),
    ):
        np.testing.assert_array_equal(layers[name].ravel()[known], expected[known].astype(np.float32))
        assert np.isnan(layers[name].ravel()[~known]).all()
    np.testing.assert_array_equal(layers["looks"].ravel(), np.where(known, memory["looks"][centre], 0))
    np.testing.assert_array_equal(layers["age"].ravel(), np.where(known, NOW - memory["pause"][centre], 255))
