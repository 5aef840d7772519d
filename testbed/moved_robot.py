"""Scan of a robot that moves during the scan and reports it late, and the ground that is confirmed nevertheless."""

from __future__ import annotations

import dataclasses
import threading
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

import guara_perception as gp
from drivers import LaserBoard
from guara_perception.app.demo.check import true_elevation
from guara_perception.app.messages import stance_to_message
from guara_perception.app.node.node import PerceptionNode
from guara_perception.app.node.pause_scanner import PauseScanner
from guara_perception.app.node.rangefinder import Rangefinder
from guara_perception.app.node.simulated import DEMO_WORLD, SimulatedRobot
from guara_perception.app.node.sweep import Swept
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.simulated_camera import simulated_camera
from guara_perception.simulation.walk import fresh_reading
from guara_perception.simulation.world import load_world
from testbed.bench_board import BenchBoard, bench_backend
from transport import PausePhase, StancePause, open_node
from transport.server import PerceptionServer
from transport.stance_link import StancePublisher, StanceReceiver

# Ambient level, of 255. With a band-pass filter and short flashes, the scene is so dark that laser-off images do not
# show the motion of the camera.
AMBIENT = 3.0
WRONG_M = 0.005
TIMEOUT_S = 180.0


@dataclass(frozen=True, slots=True)
class MovedScan:
    """Numbers of cells in the grids of a scan during which the robot moved.

    A cell is wrong if its height is off by more than `WRONG_M`.

    Attributes:
        wrong_in_all_frames: wrong free cells if no frame is left out.
        confirmed: known cells of the last confirmed grid; 0 if there is none.
        confirmed_wrong: wrong free cells of a confirmed grid.
        map_wrong: wrong free cells of the map.
    """

    wrong_in_all_frames: int
    confirmed: int
    confirmed_wrong: int
    map_wrong: int


class _MovingView(SimulatedRangefinder):
    """Rangefinder that moves at one laser-on frame and signals the end of the pause at a later one."""

    def __init__(self, *arguments: Any, moves_at: int, ends_at: int, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._moves_at, self._ends_at, self._lit = moves_at, ends_at, 0
        self.moved_to, self.say_end, self.moved_stamp = np.eye(4), threading.Event(), 0

    def frame(self, *, laser: float = 1.0, **options: Any) -> Any:
        if laser > 0.5:
            self._lit += 1
            if self._lit == self._moves_at:
                self.moved_stamp = time.time_ns()
                self.set_pose(self.moved_to)
            if self._lit == self._ends_at:
                self.say_end.set()
        return super().frame(laser=laser, **options)


def scan_of_a_moved_robot(endpoint: str, *, fps: float = 30.0, size: tuple[int, int] = (320, 256)) -> MovedScan:
    """Scan 70 stripes of a dim world, during which the body moves by 6 mm in x and z at stripe 20.

    END is sent at stripe 58, with joint positions read 1 ms before the motion.
    """
    world = load_world(DEMO_WORLD)
    world = dataclasses.replace(world, light=dataclasses.replace(world.light, ambient=(AMBIENT, AMBIENT, AMBIENT)))
    simulated = SimulatedRobot(world=world, size=size)
    robot, calibration = simulated.robot, simulated.calibration
    pause = next(simulated.walk(cycles=0))
    view = _MovingView(world, calibration, robot, 0, moves_at=20, ends_at=58)
    view.set_pose(pause.transform_base_to_world)
    view.moved_to = pause.transform_base_to_world.copy()
    view.moved_to[[0, 2], 3] += 0.006
    board = BenchBoard()
    camera = simulated_camera(view, board, fps=fps, latency=0.001)
    rangefinder = Rangefinder(LaserBoard(backend=bench_backend(board)), camera)
    with rangefinder, open_node(listen=endpoint) as session:
        server, publisher = PerceptionServer(session), StancePublisher(session)
        node = PerceptionNode(PauseScanner(robot, calibration, rangefinder, server), mode="standard")
        swept: list[Swept] = []
        sweep = node._scanner._sweeper.sweep

        def watched(*arguments: Any) -> Swept:
            swept.append(sweep(*arguments))
            return swept[-1]

        node._scanner._sweeper.sweep = watched  # type: ignore[method-assign,assignment]
        rng = np.random.default_rng(0)

        def say(phase: PausePhase, stamp: int) -> None:
            stance = stance_to_message(fresh_reading(pause.stance, rng))
            publisher.publish(StancePause(robot="guara", step=0, phase=phase, stamp=stamp, stance=stance))

        with node, gp.TerrainClient(endpoint) as client:
            StanceReceiver(session, on_pause=node.on_pause, on_refused=node.on_refused)
            grids: list[gp.TerrainGrid] = []
            client.on_terrain(grids.append)
            say(PausePhase.BEGIN, time.time_ns())
            view.say_end.wait(TIMEOUT_S)
            say(PausePhase.END, view.moved_stamp - 1_000_000)
            if not node.wait_for_step(0, TIMEOUT_S):
                raise RuntimeError(f"no scan within {TIMEOUT_S:g} s")
            server.flush()
            confirmed = [grid for grid in grids if not grid.is_provisional]
            fused = node.latest_map

    def wrong(grid: gp.TerrainGrid) -> int:
        error = np.abs(grid.elevation - true_elevation(world, pause, grid))
        return int(np.count_nonzero((grid.hazard == 0) & (error > WRONG_M)))

    last = confirmed[-1] if confirmed else None
    return MovedScan(
        wrong(swept[0].terrain),
        0 if last is None else int(np.isfinite(last.elevation).sum()),
        max((wrong(grid) for grid in confirmed), default=0),
        0 if fused is None else wrong(fused),
    )
