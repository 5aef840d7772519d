"""Simulated robot for the node: emulated laser board, simulated camera, and a gait with stance pauses."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from drivers import CameraSettings, LaserBoard
from drivers.emulator import EmulatedBoard, EmulatedClock, EmulatorConfig, emulated_backend
from guara_perception.app.messages import stance_to_message
from guara_perception.app.node.rangefinder import Rangefinder
from guara_perception.arrays import Float
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.file import load_calibration
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.scene_view import SceneView
from guara_perception.simulation.simulated_camera import NOMINAL_EXPOSURE_S, simulated_camera
from guara_perception.simulation.specimen import specimen
from guara_perception.simulation.walk import Choice, WalkPause, fresh_reading, simulate_walk
from guara_perception.simulation.world import World, load_world
from kinematics import RobotModel, load_robot
from transport import GroundPatch, PausePhase, StancePause
from transport.stance_link import StancePublisher

# World file of the default terrain.
DEMO_WORLD = Path(__file__).parents[2] / "simulation" / "worlds" / "demo.toml"
# Time from the end of an exposure to the frame's arrival on a fast link [s].
LATENCY_S = 0.001


class SimulatedRobot:
    """Simulated robot, world and rangefinder, whose laser and mirror belong to an emulated board.

    The devices run on their own clock: a scan takes as long as its computation, and no frame is lost on a busy machine.

    Attributes:
        robot: model of the robot.
        world: the terrain.
        calibration: true geometry of the rangefinder.
        rangefinder: emulated board with the real driver, and the simulated camera.
    """

    def __init__(
        self,
        robot: str | Path = "guara",
        calibration: Path | None = None,
        *,
        world: World | str | Path = DEMO_WORLD,
        size: tuple[int, int] = (640, 512),
        fps: float = 30.0,
        seed: int = 0,
    ) -> None:
        """Create the robot at the world's origin.

        Args:
            robot: name or folder of the robot.
            calibration: calibration file of the rangefinder; None = a random device with the errors of careful
                assembly.
            world: terrain, or the name or file of a world.
            size: width and height of the camera images if no calibration is given [px].
            fps: frame rate of the camera [1/s].
            seed: random seed of the noise and, without a calibration, of the device.
        """
        self.robot: RobotModel = load_robot(robot)
        self.world = world if isinstance(world, World) else load_world(world)
        self.calibration: Calibration = (
            specimen(self.robot, size, seed) if calibration is None else load_calibration(calibration)
        )
        self._rig = SimulatedRangefinder(self.world, self.calibration, self.robot, seed)
        self._seed = seed
        clock = EmulatedClock(time.monotonic())
        travel = EmulatorConfig.reaching(stripe.mirror_angle for stripe in self.calibration.stripes)
        board = EmulatedBoard(travel, clock=clock.monotonic)
        camera = simulated_camera(self._rig, board, fps=fps, latency=LATENCY_S)
        camera.identity = self.calibration.camera.identity or camera.identity
        settings = CameraSettings(exposure=NOMINAL_EXPOSURE_S, gain=1.0)
        self.rangefinder = Rangefinder(
            LaserBoard(backend=emulated_backend(board)), camera, settings=settings, clock=clock
        )
        self.stand_at(next(self.walk(cycles=0)))

    def stand_at(self, pause: WalkPause, view: SceneView | None = None) -> SceneView:
        """Move the robot to its pose at a pause; see `place`. Do not call this during a scan."""
        return self.place(pause.transform_base_to_world, pause.joint_positions, view)

    def place(
        self, transform_base_to_world: Float, joint_positions: Mapping[str, float], view: SceneView | None = None
    ) -> SceneView:
        """Set pose (4, 4) and joint positions [rad] of the robot. Do not call this during a scan.

        Returns the view of the scene. To avoid computing it again, pass as `view` the result of an earlier call
        with otherwise the same arguments.

        Raises:
            InvalidInput: camera or laser would be below the ground or too close to it.
            kinematics.KinematicsError: the joint positions do not fit the robot.
        """
        return self._rig.set_pose(transform_base_to_world, joint_positions, view)

    def walk(
        self, choose: Callable[[WalkPause], Choice] | None = None, *, cycles: float = 10, number: int = 0
    ) -> Iterator[WalkPause]:
        """Yield the pauses of a walk along x without moving the robot; see `simulate_walk`.

        Walks with different `number` have different noise.
        """
        return simulate_walk(self.world, self.robot, choose, cycles=cycles, seed=self._seed + number)


def standing_pauses(pause: WalkPause, before: Mapping[str, int]) -> dict[str, int]:
    """Number of previous pauses through which each supporting foot has stood; `before` is the previous result."""
    swung = None if pause.last_footstep is None else pause.last_footstep.leg
    return {leg: 0 if leg == swung else before.get(leg, -1) + 1 for leg in pause.stance.support_feet}


class SimulatedGait:
    """Simulated gait controller that announces the pauses of one walk, with joint readings in every message.

    Attributes:
        epoch: identity of the walk.
    """

    def __init__(
        self, publisher: StancePublisher, instance: str, time_available: float = 0.0, *, seed: int = 0
    ) -> None:
        """Create the gait of one walk.

        Args:
            publisher: publisher of the announcements.
            instance: instance name of the robot.
            time_available: announced length of each pause [s]; 0 = not known.
            seed: random seed of the joint readings.
        """
        self._rng = np.random.default_rng(seed)
        self._publisher, self._instance, self.epoch = publisher, instance, uuid.uuid4().hex
        self._time_available = time_available
        self._stood: dict[str, int] = {}

    def begin(self, pause: WalkPause) -> None:
        """Announce that the robot has begun to stand."""
        self._stood = standing_pauses(pause, self._stood)
        self._announce(pause, PausePhase.BEGIN, self._time_available)

    def hold(self, pause: WalkPause) -> None:
        """Announce that the robot still stands; after the last frame of a scan, this confirms the scan."""
        self._announce(pause, PausePhase.HOLD)

    def end(self, pause: WalkPause) -> None:
        """Announce that the robot moves on."""
        self._announce(pause, PausePhase.END)

    def _announce(self, pause: WalkPause, phase: PausePhase, time_available: float = 0.0) -> None:
        self._publisher.publish(
            StancePause(
                robot=self._instance,
                step=pause.step,
                phase=phase,
                stamp=time.time_ns(),
                stance=stance_to_message(fresh_reading(pause.stance, self._rng)),
                known_ground=tuple(
                    GroundPatch(outline=ground.outline, height=ground.height, sigma=ground.sigma)
                    for ground in pause.known_ground
                ),
                epoch=self.epoch,
                time_available=time_available,
                standing_pauses=tuple(self._stood[leg] for leg in pause.stance.support_feet),
            )
        )
