"""Lets a simulated robot walk under a running node: the gait that `guara run --simulated` brings along."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from guara_perception.app.node.node import PerceptionNode
from guara_perception.app.node.simulated import SimulatedGait, SimulatedRobot
from guara_perception.simulation.planner import plan_swing
from guara_perception.simulation.stand import OutOfReach
from guara_perception.simulation.walk import Choice, WalkEnded, WalkPause
from transport import Session
from transport.stance_link import StancePublisher

logger = logging.getLogger(__name__)

SCAN_TIMEOUT_S = 60.0
# How soon a stop is seen while a scan is waited for.
STOP_POLL_S = 0.2
# Time to look at a pause before the robot goes on: planners that are slow to subscribe still follow.
REST_S = 1.0
# A pause of unknown length ends when the gait is silent for long: a robot that stands after its walk repeats HOLD.
HOLD_PERIOD_S = 1.0
CYCLES = 11


def walk_until_stopped(
    robot: SimulatedRobot,
    node: PerceptionNode,
    session: Session,
    instance: str,
    stop: threading.Event,
    tell: Callable[[str], None] = logger.info,
) -> None:
    """Walk to the end of the world, scanning at each pause; then stand, so that scans can still be asked for.

    Args:
        robot: simulated robot with open devices.
        node: running node with the same rangefinder.
        session: session of the node; the gait speaks through it.
        instance: name of the robot in the keys.
        stop: ends the walk.
        tell: called with a line of text at the end of the walk.
    """
    gait = SimulatedGait(StancePublisher(session, robot=instance), instance)

    def choose(pause: WalkPause) -> Choice:
        latest = node.latest_map
        if latest is None or latest.step != pause.step:
            return pause.nominal
        found = plan_swing(latest, pause.next_leg, pause.nominal, robot=robot.robot)
        return None if found is None else (found.foothold.x, found.foothold.y)

    last: WalkPause | None = None
    try:
        for pause in robot.walk(choose, cycles=CYCLES):
            if last is not None:
                gait.end(last)
            robot.stand_at(pause)
            gait.begin(pause)
            last = pause
            if not _wait_for_scan(node, pause.step, stop):
                node.status.problem("gait", f"step {pause.step}: no scan within {SCAN_TIMEOUT_S:g} s, the walk goes on")
            gait.hold(pause)
            if stop.wait(REST_S):
                return
        tell("the simulated walk is over; the robot stands, and scans can still be asked for")
    except (WalkEnded, OutOfReach) as error:
        tell(f"the simulated walk ended early: {error}; the robot stands, and scans can still be asked for")
        node.status.problem("gait", str(error))
    while last is not None and not stop.wait(HOLD_PERIOD_S):
        gait.hold(last)


def _wait_for_scan(node: PerceptionNode, step: int, stop: threading.Event) -> bool:
    """Wait for the scan of a pause, but not past a stop; False when it did not come in time."""
    end = time.monotonic() + SCAN_TIMEOUT_S
    while not node.wait_for_step(step, STOP_POLL_S):
        if stop.is_set():
            return True
        if time.monotonic() > end:
            return False
    return True
