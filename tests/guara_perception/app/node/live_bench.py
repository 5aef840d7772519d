"""Node in this process, with a gait and a planner in sessions of their own."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

import guara_perception as gp
from guara_perception.app.messages import stance_to_message
from guara_perception.app.node.journal import Journal
from guara_perception.app.node.node import PerceptionNode
from guara_perception.app.node.node_status import NodeStatus
from guara_perception.app.node.pause_scanner import PauseScanner
from guara_perception.app.node.recorder import ScanRecorder
from guara_perception.simulation.walk import fresh_reading
from kinematics import RobotModel, Stance
from tests.guara_perception.app.node.conftest import Rig
from transport import PausePhase, Session, StancePause, open_client, open_node
from transport.server import PerceptionServer
from transport.stance_link import StancePublisher, StanceReceiver

TIMEOUT = 60.0


class Gait:
    """A gait controller with a session of its own; it reads the joints anew for every HOLD and END.

    BEGIN says the exact stance: grids are compared bit for bit with one made at it.
    """

    def __init__(self, endpoint: str, stance: Stance) -> None:
        self.rng = np.random.default_rng(0)
        self.session = open_client(endpoint)
        self.publisher = StancePublisher(self.session)
        self.stance = stance
        self.first_stamp = time.time_ns()

    def say(self, step: int, phase: PausePhase, stance: Stance | None = None, **fields: Any) -> None:
        stance = stance or self.stance
        read = stance if phase is PausePhase.BEGIN else fresh_reading(stance, self.rng)
        reported = {
            "robot": "guara",
            "step": step,
            "phase": phase,
            "stamp": time.time_ns(),
            "stance": stance_to_message(read),
            **fields,
        }
        self.first_stamp = min(self.first_stamp, reported["stamp"])
        self.publisher.publish(StancePause(**reported))

    def moved(self, angle: float = 0.02) -> Stance:
        """Stance with all knees bent further, so that the camera moves down and forward."""
        joints = {name: at + angle * ("kfe" in name) for name, at in self.stance.joint_positions.items()}
        return Stance(joints, self.stance.support_feet, self.stance.gravity_in_base)


class Bench:
    """Running node with a gait and a planner."""

    def __init__(
        self,
        rig: Rig,
        gait: Gait,
        client: gp.TerrainClient,
        status: NodeStatus,
        node: PerceptionNode,
        session: Session,
    ) -> None:
        self.rig, self.gait, self.client, self.status = rig, gait, client, status
        self.node, self.session = node, session


@contextmanager
def running(
    rig: Rig,
    endpoint: str,
    robot: RobotModel,
    calibration: gp.Calibration,
    stance: Stance,
    recorder: ScanRecorder | None = None,
    journal: Journal | None = None,
    *,
    mode: str = "coarse",
    has_router: bool = False,
) -> Iterator[Bench]:
    """Run node, gait and planner over the node's own router, or over a router that already listens at `endpoint`."""
    status = NodeStatus(calibration)
    with open_node(connect=endpoint, timeout=TIMEOUT) if has_router else open_node(listen=endpoint) as session:
        server = PerceptionServer(session, collect_status=status.items)
        parts = (robot, calibration, rig.rangefinder, server)
        node = PerceptionNode(PauseScanner(*parts, recorder=recorder, journal=journal, status=status), mode)
        with node:
            StanceReceiver(session, on_pause=node.on_pause, on_refused=node.on_refused)
            gait = Gait(endpoint, stance)
            with gp.TerrainClient(endpoint) as client:
                yield Bench(rig, gait, client, status, node, session)
            gait.session.close()


def wait_until(condition: Callable[[], bool]) -> bool:
    deadline = time.monotonic() + TIMEOUT
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.02)
    return False
