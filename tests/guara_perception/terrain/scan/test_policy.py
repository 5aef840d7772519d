"""Scan policy: coarse while the path is clear, stripes in between at obstacles, and back only after some pauses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.terrain.layers.hazard import Hazard
from guara_perception.terrain.scan.policy import CLEAR_PAUSES
from kinematics import RobotModel

MakeScan = Any


@pytest.fixture(scope="module")
def pairs(robot: RobotModel, calibration: gp.Calibration, paper_scan: gp.Scan) -> np.ndarray:
    """Pair of coarse stripes that encloses each cell."""
    return gp.ScanProcessor(calibration, robot, paper_scan.stance, "coarse").pairs


def box(scan_grid: Any, x: float, y: float, height: float) -> np.ndarray:
    """Flat ground with a box of 60 mm edge."""
    gx, gy = np.meshgrid(*scan_grid.centres())
    return np.where((np.abs(gx - x) < 0.03) & (np.abs(gy - y) < 0.03), height, 0.0)


def test_empty_ground_stays_coarse(robot: RobotModel, make_scan: MakeScan, pairs: np.ndarray) -> None:
    """Without obstacles, the coarse stripes are the scan; EDGE at the border of the area is no obstacle."""
    policy = gp.ScanPolicy(robot)
    assert policy.first_stripes == tuple(range(0, 70, 2))
    decision = policy.decide(make_scan(0.0), pairs)
    assert decision == gp.ScanDecision("coarse", (), False, ())
    assert policy.mode == "coarse"


def test_an_obstacle_calls_for_the_stripes_between(
    robot: RobotModel, make_scan: MakeScan, pairs: np.ndarray, scan_grid: Any
) -> None:
    """A box of 12 mm exceeds the height limit: all 35 odd stripes, ascending, with a reason."""
    decision = gp.ScanPolicy(robot).decide(make_scan(box(scan_grid, 0.7, 0.1, 0.012)), pairs)
    assert decision.mode == "standard"
    assert decision.stripes == tuple(range(1, 70, 2))
    assert decision.is_whole
    assert any("over 10 mm off the support plane" in reason for reason in decision.reasons)


def test_unknown_ground_calls_for_them_too(
    robot: RobotModel, make_scan: MakeScan, pairs: np.ndarray, scan_grid: Any
) -> None:
    """A dropout in the corridor is a hazard, because it may be a hole."""
    gx, gy = np.meshgrid(*scan_grid.centres())
    hole = np.where(np.hypot(gx - 0.7, gy) < 0.01, np.uint16(Hazard.DROPOUT), 0)
    decision = gp.ScanPolicy(robot).decide(make_scan(0.0, flags=hole), pairs)
    assert decision.mode == "standard"
    assert any("DROPOUT" in reason for reason in decision.reasons)


def test_ground_beyond_the_last_stripe_is_no_reason_but_a_lost_frame_is(
    robot: RobotModel, make_scan: MakeScan, pairs: np.ndarray, scan_grid: Any
) -> None:
    """UNSCANNED at the ends of rows is no obstacle; a gap within, a dropout or a lost frame there is."""
    gx, _ = np.meshgrid(*scan_grid.centres())
    beyond = (gx < 0.51) | (gx > 0.94)
    unscanned = np.where(beyond, np.uint16(Hazard.UNSCANNED), 0).astype(np.uint16)
    assert gp.ScanPolicy(robot).decide(make_scan(0.0, flags=unscanned), pairs).mode == "coarse"
    gap = np.where((gx > 0.7) & (gx < 0.72), np.uint16(Hazard.UNSCANNED), unscanned).astype(np.uint16)
    dark = np.where(beyond, np.uint16(Hazard.DROPOUT), 0).astype(np.uint16)
    lost = [[int(ix), 0, scan_grid.shape[0]] for ix in np.flatnonzero(beyond[0])]
    for scan, reason in (
        (make_scan(0.0, flags=gap), "UNSCANNED"),
        (make_scan(0.0, flags=dark), "DROPOUT"),
        (make_scan(0.0, flags=unscanned, metadata={"lost_cells": lost}), "DROPOUT"),
    ):
        decision = gp.ScanPolicy(robot).decide(scan, pairs)
        assert decision.mode == "standard" and reason in decision.reasons[0]


def test_with_little_time_only_the_needed_stripes_are_fired(
    robot: RobotModel, make_scan: MakeScan, pairs: np.ndarray, scan_grid: Any
) -> None:
    """With time for five, those over the box and its steps; without time, coarse with a reason."""
    scan = make_scan(box(scan_grid, 0.7, 0.1, 0.03))
    decision = gp.ScanPolicy(robot).decide(scan, pairs, time_left=0.5, stripe_time=0.1)
    assert len(decision.stripes) == 5
    assert not decision.is_whole
    found = (scan.elevation > 0.01) | ((scan.hazard & ~np.uint16(Hazard.EDGE)) != 0)
    assert set(decision.stripes) <= {int(first) + 1 for first in np.unique(pairs[found])}
    none = gp.ScanPolicy(robot).decide(scan, pairs, time_left=0.05, stripe_time=0.1)
    assert (none.mode, none.stripes) == ("coarse", ())
    assert none.reasons[-1] == "no time is left for the stripes in between"


def test_back_to_coarse_only_after_some_clear_pauses(
    robot: RobotModel, make_scan: MakeScan, pairs: np.ndarray, scan_grid: Any
) -> None:
    """Hysteresis: standard continues until enough successive pauses were clear; an obstacle restarts the count."""
    policy = gp.ScanPolicy(robot)
    clear, blocked = make_scan(0.0), make_scan(box(scan_grid, 0.7, 0.1, 0.03))
    policy.decide(blocked, pairs)
    modes = [policy.decide(clear, pairs).mode for _ in range(CLEAR_PAUSES)]
    assert modes == ["standard"] * (CLEAR_PAUSES - 1) + ["coarse"]
    policy.decide(blocked, pairs)
    policy.decide(clear, pairs)
    policy.decide(blocked, pairs)
    assert [policy.decide(clear, pairs).mode for _ in range(CLEAR_PAUSES)] == modes


@pytest.mark.slow
def test_a_coarse_scan_that_is_extended_equals_a_standard_scan(
    robot: RobotModel, calibration: gp.Calibration, paper_scan: gp.Scan
) -> None:
    """Coarse stripes, then extended, equal a standard scan of the same stripes; none is fired twice."""
    frames = {stripe.index: (on, off) for stripe, on, off in paper_scan.frames()}
    coarse = gp.ScanProcessor(calibration, robot, paper_scan.stance, "coarse")
    direct = gp.ScanProcessor(calibration, robot, paper_scan.stance, "standard")
    for index, (on, off) in frames.items():
        coarse.add(index, on, off)
        direct.add(index, on, off)
    extended = coarse.extended()
    assert extended.mode == "standard"
    for name, layer in direct.finish().layers.items():
        np.testing.assert_array_equal(extended.finish().layer(name), layer, err_msg=name)
    with pytest.raises(gp.InvalidInput, match="was added before"):
        extended.add(0, *frames[0])
    with pytest.raises(gp.InvalidInput, match="mode 'standard' cannot be extended"):
        extended.extended()


def test_a_partly_extended_scan_keeps_the_coarse_ground(make_scan: MakeScan, scan_grid: Any) -> None:
    """Without a stripe in between, the coarse cell counts; with one, the new cell, even if unknown."""
    gx, gy = np.meshgrid(*scan_grid.centres())
    unfired = np.where(gx > 0.75, np.uint16(Hazard.UNSCANNED), 0).astype(np.uint16)
    hole = (np.abs(gx - 0.6) < 0.01) & (np.abs(gy) < 0.01)
    lost = (np.abs(gx - 0.8) < 0.01) & (np.abs(gy) < 0.01)
    flags = np.where(hole, np.uint16(Hazard.DROPOUT), unfired)
    iy, ix = np.nonzero(lost)
    runs = [[int(i), int(iy.min()), int(iy.max()) + 1] for i in np.unique(ix)]
    coarse = make_scan(0.001)
    joined = gp.refined(coarse, make_scan(0.0, flags=flags, metadata={"lost_cells": runs}))
    assert joined.height_at(0.65, 0.1) == 0.0
    assert joined.height_at(0.9, 0.1) == pytest.approx(0.001)
    assert joined.hazard_at(0.6025, 0.0025) & Hazard.DROPOUT
    assert joined.hazard_at(0.8025, 0.0025) & Hazard.DROPOUT
    whole = make_scan(0.0)
    assert gp.refined(coarse, whole) is whole
    with pytest.raises(gp.InvalidInput, match="do not belong to one scan"):
        gp.refined(make_scan(0.0, step=1), whole)


def test_bad_arguments_are_refused(robot: RobotModel, make_scan: MakeScan, pairs: np.ndarray) -> None:
    """A height limit of zero, pairs of another grid, no time for a stripe."""
    with pytest.raises(gp.InvalidInput, match="height_limit is 0; it must be above 0"):
        gp.ScanPolicy(robot, height_limit=0)
    policy = gp.ScanPolicy(robot)
    with pytest.raises(gp.InvalidInput, match="allowed: the grid of a scan"):
        policy.decide(make_scan(0.0), pairs[1:])
    with pytest.raises(gp.InvalidInput, match="stripe_time is 0"):
        policy.decide(make_scan(0.0), pairs, stripe_time=0)
