"""Rangefinder over a recorded scan: the real driver, an emulated board, and a camera that replays the recording."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pytest

import guara_perception as gp
from drivers import LaserBoard
from guara_perception.app.node.rangefinder import Rangefinder
from kinematics import RobotModel
from testbed.bench_board import BenchBoard, BenchCamera, bench_backend
from testbed.recorded_view import RecordedView

if TYPE_CHECKING:
    from tests.guara_perception.app.node.live_bench import Bench

# The emulated devices run in real time; at this rate a coarse scan takes 0.3 s.
FPS = 120.0


@dataclass
class Rig:
    """Open rangefinder and its parts."""

    rangefinder: Rangefinder
    board: BenchBoard
    camera: BenchCamera
    processor: Callable[[], gp.ScanProcessor]
    firing_order: list[tuple[int, float]]
    reference: gp.TerrainGrid

    def never_safer(self, terrain: gp.TerrainGrid) -> bool:
        """True if every cell that is safe is also safe in the complete scan."""
        return not np.any((terrain.hazard == 0) & (self.reference.hazard != 0))


@pytest.fixture(scope="session")
def recorded_view(paper_scan: gp.Scan) -> RecordedView:
    return RecordedView(paper_scan)


@pytest.fixture
def rig(
    recorded_view: RecordedView,
    paper_scan: gp.Scan,
    paper_terrain: gp.TerrainGrid,
    calibration: gp.Calibration,
    robot: RobotModel,
) -> Iterator[Rig]:
    """Open the devices."""
    board = BenchBoard()
    camera = BenchCamera(board, recorded_view.render, fps=FPS, exposure=0.004, latency=0.002)
    rangefinder = Rangefinder(LaserBoard(backend=bench_backend(board)), camera)
    with rangefinder:
        yield Rig(
            rangefinder,
            board,
            camera,
            lambda: gp.ScanProcessor(calibration, robot, paper_scan.stance, paper_scan.mode),
            [(stripe.index, stripe.mirror_angle) for stripe in calibration.stripes],
            paper_terrain,
        )
    assert not board.view().laser_on


@pytest.fixture
def bench_with(
    rig: Rig, free_endpoint: str, robot: RobotModel, calibration: gp.Calibration, paper_scan: gp.Scan
) -> "Callable[..., AbstractContextManager[Bench]]":
    """Make a running node over the rig, with the arguments of `running` from `recorder` on."""
    # Imported here, because that module imports `Rig` from this one.
    from tests.guara_perception.app.node.live_bench import running

    return partial(running, rig, free_endpoint, robot, calibration, paper_scan.stance)


@pytest.fixture
def bench(bench_with: "Callable[..., AbstractContextManager[Bench]]") -> "Iterator[Bench]":
    """Running node over the rig."""
    with bench_with() as made:
        yield made
