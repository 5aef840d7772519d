"""Footholds for Quadruped-PyMPC: safe by the map, in the controller's world and in its own type where installed."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import guara_perception as gp
from kinematics.transforms import inverse
from tests.examples.test_examples import EXAMPLES

# The robot in the world of the controller.
YAW = 0.6
FOOTPRINT_TO_WORLD = np.array(
    [[np.cos(YAW), -np.sin(YAW), 0, 2.0], [np.sin(YAW), np.cos(YAW), 0, -1.0], [0, 0, 1, 0.3], [0, 0, 0, 1]]
)


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return importlib.import_module("quadruped_pympc")


@pytest.fixture(params=["dict", "gym_quadruped"])
def legs(request: pytest.FixtureRequest) -> type:
    """What holds a value for each leg: the controller's own class where it is installed."""
    if request.param == "dict":
        return dict
    legs: type = pytest.importorskip("gym_quadruped.utils.quadruped_utils").LegsAttr
    return legs


def in_world(x: float, y: float, z: float = 0.0) -> np.ndarray:
    return FOOTPRINT_TO_WORLD[:3, :3] @ (x, y, z) + FOOTPRINT_TO_WORLD[:3, 3]


def in_footprint(place: np.ndarray) -> np.ndarray:
    return np.asarray(FOOTPRINT_TO_WORLD[:3, :3].T @ (place - FOOTPRINT_TO_WORLD[:3, 3]))


@pytest.fixture
def terrain() -> gp.TerrainGrid:
    """Level ground at 20 mm with a gap between x = 0.40 and 0.48 m."""
    heights = np.full((120, 160), 0.02)
    heights[:, 80:96] = -0.3
    return gp.assess_terrain(heights, 0.005, origin=(0.0, -0.3))


def test_references_beside_a_gap_move_and_the_rest_stay(
    example: ModuleType, legs: Any, terrain: gp.TerrainGrid
) -> None:
    """Every foothold passes `check_foothold` and lies on the ground; one over the middle of a gap is not taken."""
    wishes = {"FL": (0.25, 0.1), "FR": (0.39, -0.1), "RL": (0.49, 0.1), "RR": (0.44, 5.0)}
    standing = legs(**{leg: in_world(0.2, 0.0, 0.02) for leg in example.LEGS})
    world_to_footprint = inverse(FOOTPRINT_TO_WORLD)
    adaptation = example.SafeFootholds(lambda: (terrain, world_to_footprint), standing)
    asked = legs(**{leg: in_world(*wish) for leg, wish in wishes.items()})
    before, _ = adaptation.get_footholds_adapted(asked)
    np.testing.assert_array_equal(before["FR"], in_world(*wishes["FR"]))
    assert not adaptation.compute_adaptation(example.LEGS, asked, None, None, None, None, None)
    footholds, constraints = adaptation.get_footholds_adapted(asked)
    assert adaptation.initialized and adaptation.refused == ("RR",)
    for leg in ("FL", "FR", "RL"):
        x, y, z = in_footprint(footholds[leg])
        assert terrain.check_foothold(x, y) and z == pytest.approx(0.02, abs=1e-6)
        assert np.hypot(x - wishes[leg][0], y - wishes[leg][1]) < example.RADIUS_M
        assert constraints[leg] is None
    assert in_footprint(footholds["FR"])[0] < 0.36 and in_footprint(footholds["RL"])[0] > 0.52
    np.testing.assert_array_equal(footholds["RR"], standing["RR"])


def test_without_a_fresh_map_every_foot_goes_back(example: ModuleType, legs: Any, terrain: gp.TerrainGrid) -> None:
    """The last foothold that was given, then; after a reset the references are the controller's again."""

    def ground() -> tuple[gp.TerrainGrid, np.ndarray]:
        if is_lost:
            raise gp.ScannerUnavailable("no node")
        return terrain, np.eye(4)

    is_lost = False
    standing = legs(**{leg: np.array([0.2, 0.0, 0.02]) for leg in example.LEGS})
    adaptation = example.SafeFootholds(ground, standing)
    first = legs(**{leg: np.array([0.25, 0.1, 0.0]) for leg in example.LEGS})
    assert adaptation.compute_adaptation(example.LEGS, first)
    given = np.array(adaptation.get_footholds_adapted(first)[0]["FL"])
    is_lost = True
    adaptation.reset()
    second = legs(**{leg: np.array([0.6, 0.1, 0.0]) for leg in example.LEGS})
    np.testing.assert_array_equal(adaptation.get_footholds_adapted(second)[0]["FL"], (0.6, 0.1, 0.0))
    assert not adaptation.compute_adaptation(example.LEGS, second)
    assert adaptation.refused == example.LEGS
    np.testing.assert_array_equal(adaptation.get_footholds_adapted(second)[0]["FL"], given)
