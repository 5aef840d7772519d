"""Gaits of `guara run --simulated`: a walk of its own, and an adapter for the gait of another process."""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Callable

import cv2
import numpy as np

from guara_perception.app.node.announcements import stance_of
from guara_perception.app.node.node import PerceptionNode
from guara_perception.app.node.simulated import SimulatedGait, SimulatedRobot
from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from guara_perception.simulation.gait import OutOfReach
from guara_perception.simulation.planner import plan_swing
from guara_perception.simulation.walk import Choice, WalkEnded, WalkNoise, WalkPause
from guara_perception.simulation.world import World
from kinematics import KinematicsError, LegOdometry, OdometryLost, Stance
from kinematics.transforms import transform_points
from transport import MessageError, PausePhase, Session, StancePause
from transport.stance_link import StancePublisher

logger = logging.getLogger(__name__)
SCAN_TIMEOUT_S = 60.0
# Interval at which a stop is checked for while waiting for a scan.
STOP_POLL_S = 0.2
# Time for which the robot keeps standing after each scan, so that a planner that subscribes late still receives the
# grid during its pause [s].
REST_S = 1.0
# Number of gait cycles of a walk; few enough to stay within the demo's world.
CYCLES = 11
# Iterations of the least-squares fit of the body to the ground; several are needed because the ground is not flat.
FIT_STEPS = 8
# Tolerated distance between a sole and the ground [m]; covers joint biases and uneven ground under the sole.
HANGING_M = 0.020
# Largest tolerated excess of a joint reading over its limit [rad]; multiplied by `joint_scales` for prismatic joints.
# Covers encoder noise.
LIMIT_ERROR_RAD = 0.01
# Tolerated difference between the reported gravity and the tilt of the body on its feet [rad].
TILT_ERROR_RAD = 0.06


def walk_until_stopped(
    robot: SimulatedRobot,
    node: PerceptionNode,
    session: Session,
    instance: str,
    stop: threading.Event,
    report: Callable[[str], None] = logger.info,
) -> None:
    """Walk with a scan at each pause; start again from the origin after each walk, until stopped.

    Args:
        robot: simulated robot with open devices.
        node: running node with the same rangefinder.
        session: session of the node, through which the gait also publishes.
        instance: name of the robot in the keys.
        stop: event that ends the walk.
        report: called with a line of text at the end of each walk.
    """
    publisher = StancePublisher(session, robot=instance)

    def choose(pause: WalkPause) -> Choice:
        latest = node.latest_map
        if latest is None or latest.step != pause.step:
            return pause.nominal
        found = plan_swing(latest, pause.next_leg, pause.nominal, robot=robot.robot)
        return None if found is None else (found.foothold.x, found.foothold.y)

    for number in itertools.count():
        gait = SimulatedGait(publisher, instance, seed=number)
        end = "is over"
        try:
            for pause in robot.walk(choose, cycles=CYCLES, number=number):
                _stand(robot, node, gait, pause, stop)
                if stop.is_set():
                    return
        except (WalkEnded, OutOfReach) as error:
            end = f"ended early: {error}"
            node.status.problem("gait", str(error))
        report(f"the simulated walk {end}; the robot returns to the start for another walk")


def _stand(
    robot: SimulatedRobot, node: PerceptionNode, gait: SimulatedGait, pause: WalkPause, stop: threading.Event
) -> None:
    """Stand for one pause until its scan and all requested scans are done, then announce END.

    END is not announced after a stop, or if the requested scans take longer than SCAN_TIMEOUT_S.

    Raises:
        WalkEnded: no scan was done in time; the walk of another gait may have replaced this one.
    """
    robot.stand_at(pause)
    gait.begin(pause)
    if not _is_done(lambda: node.wait_for_step(pause.step, STOP_POLL_S, gait.epoch), stop):
        raise WalkEnded(f"step {pause.step}: no scan within {SCAN_TIMEOUT_S:g} s")
    node.status.solved("gait")
    gait.hold(pause)
    if not stop.wait(REST_S) and _is_done(lambda: node.wait_for_requests(STOP_POLL_S), stop) and not stop.is_set():
        gait.end(pause)


def _is_done(wait: Callable[[], bool], stop: threading.Event) -> bool:
    """Call `wait` until it returns True or the walk is stopped, and return True; return False after SCAN_TIMEOUT_S."""
    end = time.monotonic() + SCAN_TIMEOUT_S
    while not wait():
        if stop.is_set():
            return True
        if time.monotonic() > end:
            return False
    return True


class ExternalGait:
    """Adapter that places a simulated robot at the stance pauses of another process's gait.

    Announcements that contradict the robot model, the ground or the previous pause are reported.

    Position and heading follow from leg odometry, height and tilt from the support feet, which rest on the ground. The
    joint positions in the messages are treated as encoder readings with a constant bias, as on a real robot. A new walk
    begins at the origin of the world.

    Attributes:
        placed: number of placements of the robot so far.
    """

    def __init__(
        self, robot: SimulatedRobot, node: PerceptionNode, report: Callable[[str], None] = logger.info
    ) -> None:
        """Start with the robot at the origin.

        Args:
            robot: simulated robot, whose devices `node` uses.
            node: running node, which receives each announcement after the placement. It receives an error instead if
                the announcement is invalid or would place camera or laser below the ground. An announcement whose
                stance does not fit the robot is passed on without placement, for the node to reject.
            report: called with a line of text for each announcement that contradicts the robot model, the ground or the
                previous pause.
        """
        self._robot, self._node, self._show = robot, node, report
        tree = robot.robot.tree
        bias = WalkNoise().joint * tree.joint_scales * np.random.default_rng(0).standard_normal(len(tree.joint_names))
        self._bias = dict(zip(tree.joint_names, bias.tolist(), strict=True))
        self._odometry = LegOdometry(robot.robot)
        # Pose of `odom` in the world: set at the start of the walk and after a jump.
        self._odom_to_world: Float = np.eye(4)
        self._walk: tuple[str, int] | None = None
        self.placed = 0

    def on_pause(self, announcement: StancePause) -> None:
        """Place the robot at a BEGIN that is not late, then pass the announcement or an error to the node."""
        walk = self._walk
        is_late = walk is not None and walk[0] == announcement.epoch != "" and announcement.step < walk[1]
        if announcement.phase is PausePhase.BEGIN and not is_late:
            try:
                stance = stance_of(announcement, self._robot.robot)
                self._report(announcement.step, self._place(announcement, stance))
            except InvalidInput as error:
                self._report(announcement.step, [str(error)])
                self._node.on_refused(MessageError(f"step {announcement.step}: {error}"))
                return
            except KinematicsError as error:
                # The node rejects the announcement for the same reason.
                self._report(announcement.step, [str(error)])
        self._node.on_pause(announcement)

    def _place(self, announcement: StancePause, stance: Stance) -> list[str]:
        """Place the robot; return descriptions of the contradictions found.

        Raises:
            InvalidInput: camera or laser would be below the ground.
            KinematicsError: the stance does not fit the robot.
        """
        walk, self._walk = self._walk, (announcement.epoch, announcement.step)
        if walk is None or announcement.epoch != walk[0] or (not walk[0] and announcement.step < walk[1]):
            self._odometry.reset()
            self._odom_to_world = np.eye(4)
        last, misfits = self._odometry.last, list[str]()
        try:
            pose = self._odometry.update(stance)
        except OdometryLost as error:
            assert last is not None
            self._odom_to_world = self._odom_to_world @ last.transform_footprint_to_odom
            self._odometry.reset()
            pose = self._odometry.update(stance)
            misfits.append(f"the gait jumped: {error}. The robot is set down where it stood")
        tree = self._robot.robot.tree
        for name, beyond in pose.pose.state.beyond_limits.items():
            index = tree.joint_index(name)
            if beyond > LIMIT_ERROR_RAD * tree.joint_scales[index]:
                misfits.append(
                    f"joint {name} is {beyond:.3f} {tree.unit(index)} beyond its limits: the robot cannot take this "
                    "posture"
                )
        joints = {name: angle + self._bias[name] for name, angle in stance.joint_positions.items()}
        soles = self._robot.robot.state(joints).soles_in_base(stance.support_feet)
        transform, heights = stand_on_ground(
            self._robot.world, self._odom_to_world @ pose.transform_base_to_odom, soles, self._robot.robot.sole
        )
        self._robot.place(transform, joints)
        self.placed += 1
        misfits += [
            f"foot {foot} is {abs(height) * 1e3:.0f} mm {'above' if height > 0 else 'below'} the ground"
            for foot, height in zip(stance.support_feet, heights.tolist(), strict=True)
            if abs(height) > HANGING_M
        ]
        if stance.gravity_in_base is not None:
            down = np.asarray(stance.gravity_in_base) / np.linalg.norm(stance.gravity_in_base)
            tilt = float(np.arccos(np.clip(-transform[2, :3] @ down, -1.0, 1.0)))
            if tilt > TILT_ERROR_RAD:
                misfits.append(
                    f"gravity_in_base is {np.degrees(tilt):.1f} degrees off the tilt that these joints give on this "
                    "ground"
                )
        return misfits

    def _report(self, step: int, misfits: list[str]) -> None:
        if not misfits:
            self._node.status.solved("gait")
            return
        text = f"step {step}: {'; '.join(misfits)}"
        self._node.status.problem("gait", text)
        self._show(f"gait: {text}")


def stand_on_ground(
    world: World, transform_base_to_world: Float, soles_in_base: Float, sole: tuple[float, float]
) -> tuple[Float, Float]:
    """Fit height, roll and pitch of the body so that its soles rest on the ground.

    The centroid of the soles keeps its horizontal position; the heading is unchanged to first order.

    Args:
        world: the terrain.
        transform_base_to_world: (4, 4) pose of the body by odometry.
        soles_in_base: (n, 3) sole centres of the support feet [m].
        sole: length and width of a sole [m].

    Returns:
        transform_base_to_world (4, 4), and the height (n,) of each sole above the ground [m]. Heights are not zero if
        the feet do not fit the ground.
    """
    transform = np.array(transform_base_to_world)
    heights = np.zeros(len(soles_in_base))
    for _ in range(FIT_STEPS):
        soles = transform_points(transform, soles_in_base)
        heights = soles[:, 2] - [world.sole_height(x, y, *sole) for x, y, _ in soles]
        centre = soles.mean(axis=0)
        x, y = (soles - centre)[:, :2].T
        # A small rotation (roll, pitch) about the centre of the feet lifts a sole by roll * y - pitch * x.
        lift, roll, pitch = np.linalg.lstsq(np.column_stack((np.ones_like(x), y, -x)), -heights, rcond=None)[0]
        turn = np.eye(4)
        turn[:3, :3] = cv2.Rodrigues(np.array([roll, pitch, 0.0]))[0]
        turn[:3, 3] = centre - turn[:3, :3] @ centre + (0.0, 0.0, lift)
        transform = turn @ transform
    return transform, heights
