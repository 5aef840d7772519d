"""A walk goes on in a node that was ended by kill -9 and started again: real processes over real Zenoh."""

import random
from pathlib import Path

import numpy as np
import pytest

from benchmarks.journal import PATIENT_S, Gait
from guara_perception.simulation import World
from guara_perception.simulation.walk import simulate_walk
from kinematics import RobotModel
from testbed.journalled_node import Walk
from tests.guara_perception.app.node.live_bench import wait_until


@pytest.mark.heavy
def test_a_walk_goes_on_after_kill_9(robot: RobotModel, tmp_path: Path) -> None:
    """The second time with the newest journal cut. The ground behind the scanned area is that of the first node."""
    world = World(seed=1)
    pauses = tuple(simulate_walk(world, robot, cycles=0.75, seed=1))
    gait = Gait(Walk(world, 1, pauses), tmp_path, random.Random(0))
    journals: set[tuple[Path, int]] = set()

    def written() -> set[tuple[Path, int]]:
        files = (tmp_path / "state").glob("guara-*.journal")
        return {(path, path.stat().st_mtime_ns) for path in files} - journals

    try:
        # The last pause is kept twice: a cut journal loses none.
        for pause, scans in zip(pauses, (1, 2, 3, 4), strict=True):
            gait.gait.begin(pause)
            fused = gait.map_of(pause, PATIENT_S)
            assert fused is not None
            assert (fused.metadata["restarts"], fused.metadata["scans"]) == ([], scans)
            assert np.isfinite(fused.elevation).mean() > 0.8
            assert wait_until(lambda: bool(written()))
            journals.update(written())
            gait.gait.end(pause)
            if pause.step in (1, 2):
                gait.kill(is_cut=pause.step == 2)
    finally:
        gait.close()
