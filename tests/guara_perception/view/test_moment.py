"""Tests of the order of moments and of what is shown of them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.terrain.layers.record import MapRecord
from guara_perception.view.moment import KEPT, Moment, Timeline


def moment(grid: gp.TerrainGrid, step: int, walk: str = "a", x: float = 0.0) -> Moment:
    transform = np.eye(4)
    transform[0, 3] = x
    metadata = {**grid.metadata, "epoch": walk, "transform_footprint_to_odom": transform.tolist()}
    return Moment({"map": dataclasses.replace(grid, step=step, record=MapRecord.from_json(metadata), extent="map")})


def test_the_newest_is_followed_while_it_is_shown(grid: gp.TerrainGrid) -> None:
    """After going back the same moment stays shown; after going to the end the newest is followed again."""
    timeline = Timeline()
    assert timeline.shown is None and timeline.is_newest and timeline.poses() == []
    for step in range(3):
        timeline.add(moment(grid, step))
        assert timeline.number == step and timeline.is_newest
    assert timeline.go_to(1) and not timeline.go_to(1)
    timeline.add(moment(grid, 3))
    assert timeline.number == 1 and timeline.shown is not None and timeline.shown.step == 1
    assert timeline.go_to(99) and timeline.number == 3
    timeline.add(moment(grid, 4))
    assert timeline.number == 4
    assert timeline.go_to(-5) and timeline.number == 0


def test_a_later_moment_of_a_pause_replaces_it(grid: gp.TerrainGrid) -> None:
    """Confirmed or withdrawn, it is the same pause; the same number of another walk is not."""
    timeline = Timeline()
    first, second, other = moment(grid, 1), moment(grid, 1), moment(grid, 1, walk="b")
    timeline.add(first)
    timeline.add(second)
    assert len(timeline) == 1 and timeline.shown is second
    timeline.add(other)
    assert len(timeline) == 2


def test_only_the_newest_moments_of_a_long_walk_are_kept(grid: gp.TerrainGrid) -> None:
    """The oldest are dropped; the one that is shown stays shown, or the next one once it is dropped."""
    timeline = Timeline()
    for step in range(KEPT):
        timeline.add(moment(grid, step))
    timeline.go_to(2)
    for step in range(KEPT, KEPT + 2):
        timeline.add(moment(grid, step))
        assert timeline.shown is not None and timeline.shown.step == 2
    timeline.add(moment(grid, KEPT + 2))
    assert len(timeline) == KEPT and timeline.shown.step == 3
    timeline.replace([moment(grid, step) for step in range(KEPT + 5)])
    timeline.go_to(10)
    timeline.add(moment(grid, KEPT + 5))
    assert len(timeline) == KEPT and timeline.shown.step == 10


def test_the_way_is_that_of_one_walk_up_to_what_is_shown(grid: gp.TerrainGrid) -> None:
    """Positions of another walk are in another odom."""
    timeline = Timeline()
    timeline.replace([moment(grid, 1, "a", 5.0), *(moment(grid, step, "b", 0.1 * step) for step in range(4))])
    assert [pose[0, 3] for pose in timeline.poses()] == [5.0]
    timeline.go_to(3)
    assert [pose[0, 3] for pose in timeline.poses()] == pytest.approx([0.0, 0.1, 0.2])
