"""Walk of the demo, pause by pause: node, simulated robot and gait, with the planner in a second process."""

from __future__ import annotations

import json
import select
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from guara_perception.app.client import TerrainClient
from guara_perception.app.demo.check import CheckedFoothold, DemoCheck
from guara_perception.app.node.node import PerceptionNode
from guara_perception.app.node.node_status import NodeStatus
from guara_perception.app.node.pause_scanner import PauseScanner
from guara_perception.app.node.recorder import ScanRecorder
from guara_perception.app.node.simulated import DEMO_WORLD, SimulatedGait, SimulatedRobot
from guara_perception.app.scene.scene import Scene
from guara_perception.exceptions import InvalidInput, PlannerFailed
from guara_perception.simulation.walk import Choice, Landing, WalkPause
from guara_perception.simulation.world import World
from guara_perception.terrain.grid import TerrainGrid
from transport import DEFAULT_ROBOT, open_client, open_node
from transport.server import PerceptionServer
from transport.stance_link import StancePublisher, StanceReceiver

# [s] Longest wait for a grid. The simulated devices have their own clock: a scan takes as long as its computation,
# which is slow on a busy machine.
GRID_TIMEOUT_S = 60.0
# [s] Announced length of a pause: the longest wait for its four grids.
PAUSE_S = 4 * GRID_TIMEOUT_S
FPS = 120.0
# JPEG quality of recorded frames.
JPEG_QUALITY = 85
# Number of pauses that are recorded, 6 MB each: the last two cycles. They must be consecutive: after a gap of one
# cycle, the posture is the same again, and odometry would assume that the robot stood still.
RECORDED_PAUSES = 8
PAUSES_PER_CYCLE = 4
# A robot on a course whose feet gain less than this in two cycles is stuck [m].
STUCK_PAUSES, STUCK_M = 8, 0.05
START_TIMEOUT_S = 60.0
# [s] Longest wait for an answer: longer than the planner waits for the two grids of a step, so that the planner's error
# is reported.
ANSWER_TIMEOUT_S = 130.0
STOP_TIMEOUT_S = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class DemoPause:
    """Results of one pause of the demo.

    Attributes:
        pause: true state of the robot in the simulation.
        terrain: grid of the scan, received by a client.
        fused: grid of the map, received by a client.
        foothold: foothold of the leg that swings; None if the planner found none, or the walk ends here.
        answer: reply of the planner.
        error: median absolute height error of the scan [m]; NaN if no cell is known.
    """

    pause: WalkPause
    terrain: TerrainGrid
    fused: TerrainGrid
    foothold: CheckedFoothold | None
    answer: dict[str, Any]
    error: float


def demo_walk(
    check: DemoCheck,
    *,
    recording: Path | None,
    cycles: float,
    robot_name: str | Path = DEFAULT_ROBOT,
    world: str | Path = DEMO_WORLD,
    is_course: bool = False,
) -> Iterator[DemoPause]:
    """Run the demo's walk. Grids are sent over Zenoh, requests to the planner and its answers through pipes.

    Args:
        check: collector of the results.
        recording: MCAP file to write, or None.
        cycles: largest number of gait cycles; each advances 140 mm unless `is_course` is set.
        robot_name: name or folder of the robot.
        world: name of a world of the package, or a world file.
        is_course: True to fit strides to the ground; the walk then also ends beyond all features, where the planner
            finds no step, or after two cycles in which the feet hardly advanced.

    Yields:
        One DemoPause per stance pause.

    Raises:
        PlannerFailed: the planner process ended, or did not connect or answer in time.
        transport.ReceiveTimeout: a grid did not arrive in time.
        WalkEnded: the planner found no foothold.
        kinematics.KinematicsError: the robot cannot be loaded.
        MissingFile, FileFormatError: the world does not exist or is not valid.
        InvalidInput: `is_course` with a world without features, or a leg cannot reach its foothold.
    """
    endpoint = free_endpoint()
    with ExitStack() as stack:
        robot = SimulatedRobot(robot_name, world=world, fps=FPS)
        instance = robot.robot.name
        stack.enter_context(robot.rangefinder)
        session = stack.enter_context(open_node(listen=endpoint))
        status = NodeStatus(robot.calibration)
        server = PerceptionServer(session, robot=instance, collect_status=status.items)
        recorder = None
        if recording is not None:
            recorder = stack.enter_context(
                ScanRecorder(
                    recording,
                    robot=instance,
                    calibration=robot.calibration,
                    jpeg_quality=JPEG_QUALITY,
                    scene=Scene(robot.robot, robot.calibration),
                    first=first_recorded(cycles),
                )
            )
        parts = (robot.robot, robot.calibration, robot.rangefinder, server)
        scanner = PauseScanner(*parts, recorder=recorder, status=status)
        node = stack.enter_context(PerceptionNode(scanner, "adaptive"))
        StanceReceiver(session, robot=instance, on_pause=node.on_pause, on_refused=node.on_refused)
        publisher = StancePublisher(stack.enter_context(open_client(endpoint)), robot=instance)
        gait = SimulatedGait(publisher, instance, time_available=PAUSE_S)
        client = stack.enter_context(TerrainClient(endpoint, robot=instance))
        planner = stack.enter_context(PlannerProcess(endpoint, instance))
        choices: dict[int, Choice] = {}
        places: list[float] = []
        last, goal = round(cycles * PAUSES_PER_CYCLE), goal_of(robot.world) if is_course else np.inf
        for pause in robot.walk(lambda pause: choices[pause.step], cycles=cycles):
            robot.stand_at(pause)
            gait.begin(pause)
            client.wait_for_step(pause.step, timeout=GRID_TIMEOUT_S, extent="map")
            client.wait_for_step(pause.step, timeout=GRID_TIMEOUT_S)
            # HOLD confirms the provisional grids: the robot stood still throughout the scan.
            gait.hold(pause)
            fused = client.wait_for_step(pause.step, timeout=GRID_TIMEOUT_S, extent="map", confirmed=True)
            terrain = client.wait_for_step(pause.step, timeout=GRID_TIMEOUT_S, confirmed=True)
            x, y = pause.nominal
            answer = planner.choose(step=pause.step, leg=pause.next_leg, x=x, y=y, extent="map", is_course=is_course)
            check.grids_received = answer["received"]
            error = check.add_grids(robot.world, pause, terrain, fused)
            choice = answer["foothold"]
            leg, foothold = answer["leg"], None
            choices[pause.step] = None if choice is None else Landing(choice[0], choice[1], leg, answer["body"])
            is_over = pause.step == last or min(sole[0] for sole in pause.soles_in_world.values()) > goal
            places.append(float(np.mean([sole[0] for sole in pause.soles_in_world.values()])))
            is_stuck = len(places) > STUCK_PAUSES and places[-1] - places[-1 - STUCK_PAUSES] < STUCK_M
            is_over |= is_course and (choice is None or is_stuck)
            if choice is not None and not is_over:
                swing = fused.check_path(answer["swing"], answer["clearance"])
                foothold = check.add_foothold(robot.world, pause, fused, leg, choice[0], choice[1], swing)
            gait.end(pause)
            yield DemoPause(pause, terrain, fused, foothold, answer, error)
            if is_over:
                return


def goal_of(world: World) -> float:
    """Position along x beyond which a course has no features [m].

    Raises:
        InvalidInput: the course has no features.
    """
    if not world.features:
        raise InvalidInput("the course has no features to cross; allowed: one or more, as in worlds/stones.toml")
    return max(feature.bounds[1] for feature in world.features)


def first_recorded(cycles: float) -> int:
    """Number of the first step to record in a walk of `cycles` gait cycles."""
    return max(0, round(cycles * PAUSES_PER_CYCLE) + 1 - RECORDED_PAUSES)


def free_endpoint() -> str:
    """Zenoh endpoint at an unused TCP port of this machine."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


class PlannerProcess(AbstractContextManager["PlannerProcess"]):
    """Planner in its own process, as a context manager. It receives grids over Zenoh and requests through a pipe."""

    def __init__(self, endpoint: str, robot: str) -> None:
        """Start the process and wait until it is connected.

        Raises:
            PlannerFailed: the process ended or was not connected in time.
        """
        self._process = subprocess.Popen(
            [sys.executable, "-m", "guara_perception.app.demo.planner", endpoint, robot],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._stdin, self._stdout = cast("IO[str]", self._process.stdin), cast("IO[str]", self._process.stdout)
        try:
            self._read(START_TIMEOUT_S)
        except BaseException:
            self.__exit__()
            raise

    def __exit__(self, *error: object) -> None:
        """End the process. May be called twice."""
        with suppress(BrokenPipeError):
            self._stdin.close()
        try:
            self._process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._stdout.close()

    def choose(
        self, *, step: int, leg: str, x: float, y: float, extent: str = "footprint", is_course: bool = False
    ) -> dict[str, Any]:
        """Request a foothold near (x, y) [m], in base_footprint of `step`; see `planner` for the answer.

        Raises:
            PlannerFailed: the process ended or did not answer in time.
        """
        request = {"step": step, "leg": leg, "x": x, "y": y, "extent": extent, "is_course": is_course}
        try:
            self._stdin.write(json.dumps(request) + "\n")
            self._stdin.flush()
        except (OSError, ValueError):  # the pipe is broken, or was closed
            raise PlannerFailed(f"the planner process ended (exit code {self._process.poll()})") from None
        return self._read(ANSWER_TIMEOUT_S)

    def _read(self, timeout: float) -> dict[str, Any]:
        """Read the next answer; kill the process if none arrives within `timeout` [s].

        The planner writes one line for each request, and one when it is connected.
        """
        if not select.select([self._stdout], [], [], timeout)[0]:
            self._process.kill()
            raise PlannerFailed(f"the planner process did not answer within {timeout:g} s")
        line = self._stdout.readline()
        if not line:
            raise PlannerFailed(f"the planner process ended (exit code {self._process.wait()})")
        answer: dict[str, Any] = json.loads(line)
        return answer
