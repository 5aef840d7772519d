"""Running node: duration of a scan, latency of its grid, processor time; rates at which it keeps up with a camera.

`python -m benchmarks.node DATA [--scans N] [--rates FPS ...] [--lights NAME ...]`: scans of a recorded
scene at 30 frames per second; then for each rate and light two of the simulated scene, of which the second counts.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.command import Table, options
from benchmarks.peers import free_endpoint, peers, standing
from drivers import CameraSettings, Image, LaserBoard, StripeCapture, timing
from drivers.emulator import ExposureView
from drivers.sweep.acquisition import StripeStream
from guara_perception.app.messages import message_to_terrain, terrain_to_message
from guara_perception.app.node.node import PerceptionNode
from guara_perception.app.node.node_status import NodeStatus
from guara_perception.app.node.pause_scanner import PauseScanner
from guara_perception.app.node.rangefinder import Rangefinder
from guara_perception.app.node.simulated import SimulatedGait
from guara_perception.simulation import real_light
from guara_perception.simulation.walk import WalkPause
from kinematics import RobotModel, Stance, load_robot
from testbed import scenes
from testbed.bench_board import BenchBoard, BenchCamera, bench_backend
from testbed.emulated_sweeps import view_of
from testbed.recorded_view import RecordedView
from testbed.truth import truth_calibration
from transport import (
    StancePublisher,
    StanceReceiver,
    decode_terrain,
    encode_terrain,
    open_client,
    open_node,
)
from transport.server import PerceptionServer

TIMEOUT_S = 120.0
FPS = 30.0
SIZE = (640, 512)


@dataclass
class Bench:
    """A running node over a scan."""

    standing: WalkPause
    gait: SimulatedGait
    node: PerceptionNode
    status: NodeStatus
    endpoint: str

    def pause(self, step: int) -> tuple[float, float, float]:
        """One pause: seconds of the sweep, milliseconds from last frame to published, processor seconds."""
        before, pause = time.process_time(), replace(self.standing, step=step)
        self.gait.begin(pause)
        if not self.node.wait_for_step(step, TIMEOUT_S):
            raise SystemExit(f"step {step} gave no grid within {TIMEOUT_S:.0f} s")
        spent = time.process_time() - before
        values = next(item for item in self.status.items() if item.name == "scanner").values
        self.gait.end(pause)
        return float(values["duration_s"]), float(values["latency_ms"]), spent


def showing(
    render: Callable[[ExposureView, CameraSettings], Image], *, exposure: float, latency: float, fps: float = FPS
) -> Rangefinder:
    """Emulated board and camera in real time, which sees what `render` gives; times in seconds."""
    board = BenchBoard()
    camera = BenchCamera(board, render, fps=fps, exposure=exposure, latency=latency)
    return Rangefinder(LaserBoard(backend=bench_backend(board)), camera)


@contextmanager
def listening(
    robot: RobotModel, calibration: gp.Calibration, rangefinder: Rangefinder, mode: str, endpoint: str
) -> Iterator[tuple[PerceptionNode, NodeStatus]]:
    """Run a node, with its own router, that receives announcements of pauses."""
    with rangefinder, open_node(listen=endpoint) as session:
        status = NodeStatus(calibration)
        server = PerceptionServer(session, collect_status=status.items)
        with PerceptionNode(PauseScanner(robot, calibration, rangefinder, server, status=status), mode) as node:
            StanceReceiver(session, on_pause=node.on_pause, on_refused=node.on_refused)
            yield node, status


@contextmanager
def running(
    robot: RobotModel, calibration: gp.Calibration, rangefinder: Rangefinder, mode: str, stance: Stance
) -> Iterator[Bench]:
    """Run the node of a standing robot."""
    endpoint = free_endpoint()
    with (
        listening(robot, calibration, rangefinder, mode, endpoint) as (node, status),
        open_client(endpoint, timeout=TIMEOUT_S) as session,
    ):
        yield Bench(standing(robot, stance), SimulatedGait(StancePublisher(session), "guara"), node, status, endpoint)


def print_way_to_planner(bench: Bench, first: int, scans: int) -> None:
    """Further scans: from the finished grid to a TerrainGrid in a planner, a process of its own."""
    made: list[tuple[float, gp.TerrainGrid]] = []
    finish = gp.ScanProcessor.finish

    def noted(processor: gp.ScanProcessor, area: str = "footprint", **keywords: Any) -> gp.TerrainGrid:
        terrain = finish(processor, area, **keywords)
        if area == "footprint":
            made.append((time.monotonic(), terrain))
        return terrain

    waits, work = [], []
    with peers() as start, patch.object(gp.ScanProcessor, "finish", noted):
        planner = start("waiter", bench.endpoint)
        for step in range(first, first + scans):
            made.clear()
            planner.send(step=step)
            bench.pause(step)
            waits.append(planner.receive()["at"] - made[0][0])
            before = time.thread_time()
            message = terrain_to_message(made[0][1], robot="guara", sequence=step)
            message_to_terrain(decode_terrain(encode_terrain(message)))
            work.append(time.thread_time() - before)
    print(
        f"grid -> planner                  median {1e3 * np.median(waits):5.1f} ms, quickest {1e3 * min(waits):5.1f} "
        f"ms (another process, loopback, wall clock); processor time {1e3 * np.median(work):.1f} ms, quickest "
        f"{1e3 * min(work):.1f} ms: message with its obstacles, encoding, decoding, checks on both sides"
    )


@contextmanager
def noting_turns() -> Iterator[list[tuple[list[float], float]]]:
    """Work on groups of stripes while the block lasts: when all frames of each stripe had arrived, and its end [s]."""
    turns: list[tuple[list[float], float]] = []
    groups = StripeStream.groups

    def noted(stream: StripeStream) -> Iterator[tuple[StripeCapture, ...]]:
        for group in groups(stream):
            yield group
            stamps = [(c.on_stamp, c.off_stamp, c.dark_stamp) for c in group]
            turns.append((np.nanmax(stamps, axis=1).tolist(), timing.monotonic()))

    with patch.object(StripeStream, "groups", noted):
        yield turns


def most_waiting(turns: list[tuple[list[float], float]]) -> int:
    """Largest number of stripes of which all frames had arrived while others were worked on."""
    arrived = np.concatenate([stamps for stamps, _ in turns])
    done = np.cumsum([len(stamps) for stamps, _ in turns])
    return max(int(np.count_nonzero(arrived[n:] <= end)) for n, (_, end) in zip(done, turns, strict=True))


def print_rates(rates: list[float], lights: list[str]) -> None:
    """Print how well the node keeps up with fast cameras, in clean and in hard light at strength 1."""
    table = Table(
        "light:<9 | frames/s:8.0f | stripes:7d | sweep s:7.3f | frame periods a stripe:22.2f | most waiting:12d | "
        "share of a core:15.2f | last frame to grid ms:21.1f"
    )
    for light, fps in itertools.product(lights, rates):
        scan = scenes.simulated(SIZE, 70, real_light({} if light == "clean" else {light: 1.0}))
        rangefinder = showing(view_of(scan), exposure=0.4 / fps, latency=0.4 / fps, fps=fps)
        node_over_it = running(scan.robot, scan.calibration, rangefinder, scan.mode, scan.stance)
        with noting_turns() as turns, node_over_it as bench:
            bench.pause(0)
            turns.clear()
            sweep, tail, spent = bench.pause(1)
        stripes = len(scan.frames)
        table.row(light, fps, stripes, sweep, sweep * fps / stripes, most_waiting(turns), spent / sweep, tail)


def main() -> None:
    """Command line."""
    asked = options(
        __doc__,
        DATA=(Path, "data folder with calibration/truth.json and scans/paper"),
        scans=(7, "timed scans at 30 frames per second; 0: none"),
        rates=([120.0], "frames per second of the cameras that the node has to keep up with"),
        lights=(["clean", "clipping", "ambient"], "clean, or effects of real light at strength 1"),
    )
    cv2.setNumThreads(1)
    if asked.scans:
        print_scans(asked.data, asked.scans)
    print_rates(asked.rates, asked.lights)


def print_scans(data: Path, scans: int) -> None:
    """Scans of the recorded scene at FPS: sweep, delay of the grid, processor time, and the way to a planner."""
    folder = data / "scans" / "paper"
    recorded = gp.open_scan(folder)
    rangefinder = showing(RecordedView(recorded).render, exposure=0.008, latency=0.008)
    robot, calibration = load_robot("guara"), truth_calibration(data)
    with running(robot, calibration, rangefinder, recorded.mode, recorded.stance) as bench:
        # The first one is not timed: it makes things at their first use.
        rows = np.array([bench.pause(step) for step in range(scans + 1)])[1:]
        frames = len(recorded.stripes) + 1
        needed = frames / FPS
        print(f"{frames - 1} stripes and one off frame at {FPS:.0f} frames per second; {len(rows)} scans")
        table = Table("of a scan:<60 | median:8.3f | worst:8.3f")
        for name, values in (
            (f"sweep over the {needed:.3f} s that its frames need", rows[:, 0] / needed),
            ("last frame to the grid handed over [ms]", rows[:, 1]),
            ("processor time [ms]: driver, devices, grid, map, messages", 1e3 * rows[:, 2]),
        ):
            table.row(name, np.median(values), values.max())
        print_way_to_planner(bench, scans + 1, scans)


if __name__ == "__main__":
    main()
