"""Gait of `guara run --simulated`, which makes a simulated robot walk for a running node."""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Callable

from guara_perception.app.node.node import PerceptionNode
from guara_perception.app.node.simulated import SimulatedGait, SimulatedRobot
from guara_perception.simulation.gait import OutOfReach
from guara_perception.simulation.planner import plan_swing
from guara_perception.simulation.walk import Choice, WalkEnded, WalkPause
from transport import Session
from transport.stance_link import StancePublisher

logger = logging.getLogger(__name__)

SCAN_TIMEOUT_S = 60.0
# Interval at which a stop is checked for while waiting for a scan.
STOP_POLL_S = 0.2
# Rest after each scan, for planners that are slow to subscribe.
REST_S = 1.0
# Number of gait cycles of a walk, which stays within the demo's world.
CYCLES = 11


def walk_until_stopped(
    robot: SimulatedRobot,
    node: PerceptionNode,
    session: Session,
    instance: str,
    stop: threading.Event,
    tell: Callable[[str], None] = logger.info,
) -> None:
    """Walk with a scan at each pause; start again from the origin after each walk, until stopped.

    Args:
        robot: simulated robot with open devices.
        node: running node with the same rangefinder.
        session: session of the node, through which the gait also publishes.
        instance: name of the robot in the keys.
        stop: event that ends the walk.
        tell: called with a line of text at the end of each walk.
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
        tell(f"the simulated walk {end}; the robot returns to the start for another walk")


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
