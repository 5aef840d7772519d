"""Lets a simulated robot walk under a running node: the gait that `guara run --simulated` brings along."""

from __future__ import annotations

import threading

from guara_perception.app.node.node import PerceptionNode
from guara_perception.app.node.simulated import SimulatedGait, SimulatedRobot
from guara_perception.simulation.planner import plan_foothold
from guara_perception.simulation.walk import Choice, WalkEnded, WalkPause
from transport import Session
from transport.stance_link import StancePublisher

SCAN_TIMEOUT_S = 60.0
# Time to look at a pause before the robot goes on: planners that are slow to subscribe still follow.
REST_S = 1.0
CYCLES = 11


def walk_until_stopped(
    robot: SimulatedRobot, node: PerceptionNode, session: Session, instance: str, stop: threading.Event
) -> None:
    """Walk to the end of the world, scanning at each pause; then stand, so that scans can still be asked for.

    Args:
        robot: simulated, with open devices.
        node: running, with the same rangefinder.
        session: of the node; the gait speaks through it.
        instance: name of the robot in the keys.
        stop: ends the walk.
    """
    gait = SimulatedGait(StancePublisher(session), instance)

    def choose(pause: WalkPause) -> Choice:
        latest = node.latest_map
        if latest is None or latest.step != pause.step:
            return pause.nominal
        found = plan_foothold(latest, pause.next_leg, pause.nominal, robot=robot.robot)
        return None if found is None else (found.x, found.y)

    last: WalkPause | None = None
    try:
        for pause in robot.walk(choose, cycles=CYCLES):
            if last is not None:
                gait.end(last)
            robot.place(pause)
            gait.begin(pause)
            last = pause
            node.wait_for_step(pause.step, SCAN_TIMEOUT_S)
            if stop.wait(REST_S):
                return
    except WalkEnded as error:
        node.status.problem("gait", str(error))
