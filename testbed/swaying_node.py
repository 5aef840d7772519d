"""`guara run` with a simulated robot that sways continuously, and a gait in another process that streams its joints.

Start `python -m testbed.swaying_node node FOLDER ENDPOINT` and `python -m testbed.swaying_node gait ENDPOINT --rate
200`. The motion is a function of the machine's monotonic clock, which both processes read. The gait prints a line of
JSON for each pause. Joint readings have a bias, and joints and gravity have new white noise in every message.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import guara_perception as gp
from drivers import AcquireOptions, CameraSettings, OffFrames
from drivers.emulator import EmulatedCamera, ExposureView
from guara_perception.app.main import run
from guara_perception.app.messages import stance_to_message
from guara_perception.app.node import simulated
from guara_perception.app.node.rangefinder import STRIPES_TOGETHER, Rangefinder
from guara_perception.arrays import Float, Image
from guara_perception.calibration.file import save_calibration
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.simulated_camera import NOMINAL_EXPOSURE_S, renderer
from guara_perception.simulation.specimen import specimen
from guara_perception.simulation.sway import BIAS_RAD, WHITE_RAD, Sway, joints_of
from kinematics import RobotModel, Stance
from transport import PausePhase, StancePause, StancePublisher, StanceStreamPublisher, open_client

SIZE = (320, 256)
# White noise of a reading of gravity [rad].
IMU_RAD = np.radians(0.1)
# Duration of the stream before each pause, longest pause, duration of the stream after a pause, and time step of the
# table of joints [s].
BEFORE, LONGEST, AFTER, TABLE_STEP = 1.5, 60.0, 0.3, 0.002
ENDING_S = 0.02
MOST_PAUSES = 30


def standing(robot: RobotModel) -> Float:
    """Pose (4, 4) of `base_link` in the world without sway."""
    return robot.stance_pose(Stance(robot.posture("scan"), robot.legs, None)).transform_base_to_footprint


def swaying_camera(sway: Sway) -> Callable[..., EmulatedCamera]:
    """Create a substitute for `simulated_camera` that renders each exposure from the pose in its middle."""

    def make(view: SimulatedRangefinder, board: Any, *, fps: float, latency: float) -> EmulatedCamera:
        draw, still = renderer(view), standing(view.robot)

        def render(seen: ExposureView, settings: CameraSettings) -> Image:
            view.set_pose(still @ sway.at((seen.start + seen.end) / 2))
            return draw(seen, settings)

        return EmulatedCamera(board, render, fps=fps, exposure=NOMINAL_EXPOSURE_S, latency=latency)

    return make


def serve(folder: Path, endpoint: str, sway: Sway, arguments: list[str]) -> int:
    """Run the node until it is stopped; its calibration is written to `folder`."""
    save_calibration(specimen(gp.load_robot("guara"), SIZE), folder / "calibration.json")
    sweep = Rangefinder.sweep

    def in_time(rangefinder: Rangefinder, *given: Any) -> Any:
        # Needed even without a stream, because the sway follows the machine's clock.
        rangefinder.keep_time()
        # As in devices.toml of a swaying robot: a laser-off image from another pose would hide part of the line.
        rangefinder.options = AcquireOptions(off=OffFrames.PER_STRIPE, together=STRIPES_TOGETHER)
        return sweep(rangefinder, *given)

    for owner, name, changed in (
        (simulated, "simulated_camera", swaying_camera(sway)),
        (Rangefinder, "sweep", in_time),
    ):
        setattr(owner, name, changed)
    given = ["--simulated", "--gait", "external", "-c", str(folder / "calibration.json"), "--listen", endpoint]
    return run(["run", *given, *arguments])


class SwayingGait:
    """Noisy joint readings of a swaying body, for messages and stream."""

    def __init__(self, robot: RobotModel, sway: Sway, seed: int) -> None:
        """Compute the joint positions over one period of the sway."""
        self.robot, self._sway, self._rng = robot, sway, np.random.default_rng(seed)
        self._period = 5.0 / sway.frequency
        self._times = np.arange(0.0, self._period + TABLE_STEP, TABLE_STEP)
        self._joints = np.array([joints_of(robot, sway.at(time)) for time in self._times.tolist()])
        self._joints += self._rng.normal(0.0, BIAS_RAD, self._joints.shape[1])

    def read(self, time: float) -> Stance:
        """Return the stance at a time of the monotonic clock [s], with new noise."""
        at = time % self._period
        joints = [np.interp(at, self._times, column) for column in self._joints.T]
        joints += self._rng.normal(0.0, WHITE_RAD, len(joints))
        noise = Rotation.from_rotvec(self._rng.normal(0.0, IMU_RAD, 3)).as_matrix()
        down = noise @ self._sway.at(time)[:3, :3].T @ (0.0, 0.0, -1.0)
        return Stance(dict(zip(self.robot.tree.joint_names, joints, strict=True)), self.robot.legs, tuple(down))


def walk(endpoint: str, gait: SwayingGait, rate: float, pauses: int, known: int) -> Iterator[tuple[int, float]]:
    """Announce pauses at one position, each until its grid arrives or for `LONGEST`; stream meanwhile if rate > 0.

    After `pauses`, others follow until a grid with `known` known cells is confirmed, `MOST_PAUSES` in all: a busy
    machine may delay the samples of a scan until it no longer waits for them.

    Yields:
        Step of each pause after its end, and the time of its BEGIN on the monotonic clock [s].
    """
    offset = time.time_ns() - round(time.monotonic() * 1e9)
    with open_client(endpoint) as session, gp.TerrainClient(endpoint) as client:
        publisher = StancePublisher(session)
        streamer = StanceStreamPublisher(session, gait.robot.legs, epoch="walk")
        streamed = time.monotonic()

        def go_on(seconds: float, is_over: Callable[[], bool] = lambda: False) -> None:
            """Stream for a time [s]; samples that a busy machine delays are sent late, with their nominal stamps."""
            nonlocal streamed
            until = time.monotonic() + seconds
            while (now := time.monotonic()) < until and not is_over():
                while rate and streamed + 1.0 / rate < now:
                    streamed += 1.0 / rate
                    streamer.add(offset + round(streamed * 1e9), stance_to_message(gait.read(streamed)))
                time.sleep(0.2 / rate if rate else ENDING_S)

        def say(step: int, phase: PausePhase) -> float:
            now = time.monotonic()
            stance = stance_to_message(gait.read(now))
            stamp = offset + round(now * 1e9)
            publisher.publish(
                StancePause(robot="guara", step=step, phase=phase, stamp=stamp, stance=stance, epoch="walk")
            )
            return now

        def is_there(step: int) -> bool:
            return any(grid.step == step and not grid.record.refinement_follows for grid in seen)

        seen: list[gp.TerrainGrid] = []
        client.on_terrain(seen.append)

        def is_enough() -> bool:
            return known < 0 or any(
                not grid.is_provisional and np.isfinite(grid.elevation).sum() >= known for grid in seen
            )

        for step in range(MOST_PAUSES):
            if step >= pauses and is_enough():
                break
            go_on(BEFORE)
            begun = say(step, PausePhase.BEGIN)
            go_on(LONGEST, partial(is_there, step))
            go_on(AFTER)
            say(step, PausePhase.END)
            go_on(AFTER)
            yield step, begun
        streamer.flush(LONGEST)
        publisher.flush(LONGEST)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m testbed.swaying_node", description=__doc__)
    parser.add_argument("--degrees", type=float, default=0.5, help="amplitude of the turn")
    parser.add_argument("--shift", type=float, default=0.005, help="amplitude of the shift [m]")
    parser.add_argument("--frequency", type=float, default=1.0, help="frequency of the turn [1/s]")
    commands = parser.add_subparsers(dest="what", required=True)
    node = commands.add_parser("node", help="the node; further arguments are those of `guara run`")
    node.add_argument("folder", type=Path, help="folder for calibration.json")
    node.add_argument("endpoint")
    gait = commands.add_parser("gait", help="the gait")
    gait.add_argument("endpoint")
    gait.add_argument("--rate", type=float, default=200.0, help="samples per second; 0: no stream")
    gait.add_argument("--pauses", type=int, default=1, help="pauses at least")
    gait.add_argument("--known", type=int, default=-1, help="known cells of a confirmed grid that end the walk")
    gait.add_argument("--seed", type=int, default=0)
    given, rest = parser.parse_known_args()
    sway = Sway(float(np.radians(given.degrees)), given.shift, given.frequency)
    if given.what == "node":
        raise SystemExit(serve(given.folder, given.endpoint, sway, rest))
    swaying = SwayingGait(gp.load_robot("guara"), sway, given.seed)
    for step, begun in walk(given.endpoint, swaying, given.rate, given.pauses, given.known):
        print(json.dumps({"step": step, "begun": begun}), flush=True)


if __name__ == "__main__":
    main()
