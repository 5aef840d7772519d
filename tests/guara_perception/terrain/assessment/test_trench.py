"""Width barred by a trench for a ball foot in a map; no wall of the trench comes under the foot."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from guara_perception.arrays import Float, Mask
from guara_perception.settings import Settings
from guara_perception.terrain.assessment.assess import assess_layers
from guara_perception.terrain.assessment.raster import Raster
from guara_perception.terrain.layers.hazard import Hazard
from kinematics import RobotModel
from tests.thorough import examples

CELL_M, FINE = 0.005, 5
# Ball foot like those of a Go2, with the sole and disc that `guara robot new` suggests for it.
BALL_M, SOLE_M, DISC_M = 0.043, 0.023, 0.015
SHAPE = (60, 120)


def trench(width: float, yaw: float, middle: float) -> Float:
    """Distance of each fine point of the grid from the nearer wall of a trench [m]; negative inside."""
    y, x = (np.indices([n * FINE for n in SHAPE]) + 0.5) * CELL_M / FINE
    across = (x - middle) * np.cos(yaw) + (y - SHAPE[0] * CELL_M / 2) * np.sin(yaw)
    return np.asarray(np.abs(across) - width / 2)


def free_of(inside: Mask, robot: RobotModel, depth: float | None, rim: int, drift: tuple[int, int] = (0, 0)) -> Mask:
    """Free cells of a map with such a trench (at fine points), of unknown depth with a rim if no depth is given.

    The unknown rim is `rim` cells wide. The map may have drifted by `drift` cells along y and x.
    """
    limits = dataclasses.replace(
        Settings.of(robot).limits, sole_length=SOLE_M, sole_width=SOLE_M, disc_radius=DISC_M, step=0.030, drop=0.020
    )
    heights = np.where(inside, -(depth or 0.0), 0.0).reshape(SHAPE[0], FINE, SHAPE[1], FINE)
    low, high = heights.min(axis=(1, 3)), heights.max(axis=(1, 3))
    unknown = np.zeros(SHAPE, bool)
    if depth is None:
        touched = inside.reshape(SHAPE[0], FINE, SHAPE[1], FINE).any(axis=(1, 3)).astype(np.uint8)
        unknown = cv2.dilate(touched, np.ones((1, 2 * rim + 1), np.uint8)) > 0
    raster = Raster(*(np.where(unknown, np.nan, value) for value in (high, np.zeros(SHAPE), low, high)))
    flags = np.where(unknown, np.uint16(Hazard.DROPOUT), np.uint16(0))
    layers = assess_layers(raster, flags, CELL_M, limits, np.full((*SHAPE, 2), drift))
    return np.asarray(layers["hazard"] == 0)


@pytest.mark.parametrize("depth", [0.060, None])
def test_a_trench_of_80_mm_bars_140(depth: float | None, robot: RobotModel) -> None:
    """Six cells on each side: half the sole, the disc and one more cell."""
    free = free_of(trench(0.080, 0.0, 0.300) < 0, robot, depth, rim=0)
    assert (~free[SHAPE[0] // 2])[20:-20].sum() * CELL_M <= 0.140 + 1e-9


def test_no_wall_comes_under_the_ball_by_a_drift_of_a_cell(robot: RobotModel) -> None:
    """Around a free cell, the ground is level for the ball's radius plus 8 mm, with known or unknown bottom."""
    rng = np.random.default_rng(0)
    for _ in range(examples(60)):
        away = trench(rng.uniform(0.04, 0.10), rng.uniform(-0.8, 0.8), rng.uniform(0.25, 0.35))
        depth = None if rng.random() < 0.5 else rng.uniform(0.035, 0.10)
        free = free_of(away < 0, robot, depth, rim=int(rng.integers(0, 3)))
        nearest = np.abs(away).reshape(SHAPE[0], FINE, SHAPE[1], FINE).min(axis=(1, 3))[free]
        assert free.any() and nearest.min() > BALL_M / 2 + 0.008


def test_no_wall_comes_under_the_contact_by_the_drift_that_the_map_allows_for(robot: RobotModel) -> None:
    """With a drift of up to 2 sigma in any direction, no wall comes under the contact area of a ball."""
    rng = np.random.default_rng(1)
    for _ in range(examples(60)):
        sigma = rng.uniform(0.0, 0.015, 2)
        width, yaw, middle = rng.uniform(0.04, 0.10), rng.uniform(-0.8, 0.8), rng.uniform(0.27, 0.33)
        depth = None if rng.random() < 0.5 else rng.uniform(0.035, 0.10)
        drift = np.ceil(2 * sigma[::-1] / CELL_M).astype(int)
        free = free_of(trench(width, yaw, middle) < 0, robot, depth, 0, (int(drift[0]), int(drift[1])))
        direction = rng.uniform(0, 2 * np.pi)
        aside = 2 * sigma * rng.uniform(0.9, 1.0) * np.array([np.cos(direction), np.sin(direction)])
        # A shift along the trench has no effect; one across it equals a shift along x.
        away = trench(width, yaw, middle + aside[0] + aside[1] * np.tan(yaw))
        nearest = np.abs(away).reshape(SHAPE[0], FINE, SHAPE[1], FINE).min(axis=(1, 3))[free]
        assert free.any() and nearest.min() > SOLE_M / 2
