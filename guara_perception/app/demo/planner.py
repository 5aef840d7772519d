"""Planner of the demo, a separate process: reads requests from stdin and receives grids through the public client.

The first output line, {"ready": true}, reports that the planner is connected. Each request is a JSON line {step, leg,
x, y, extent, is_course}. Each answer is a JSON line with the foothold and the swing chosen on the grid of that step, or
with the reasons why no foothold was found. On a course, strides are fitted to the ground: the planner also
chooses the leg, and the answer contains the position of the body during the swing.
"""

from __future__ import annotations

import json
import sys
from functools import lru_cache
from typing import Any

from guara_perception.app.client import TerrainClient
from guara_perception.exceptions import PerceptionError
from guara_perception.simulation.planner import plan_swing, refusals
from guara_perception.simulation.strides import SWING_CLEARANCES, StridePlanner
from guara_perception.terrain.grid import TerrainGrid
from kinematics import robot_from_description
from transport import TransportError

GRID_TIMEOUT_S = 60.0


def main() -> int:
    """Answer requests until standard input ends or an error occurs; return the exit code.

    The arguments of the program are the endpoint and the instance name of the robot.
    """
    endpoint, robot = sys.argv[1], sys.argv[2]
    try:
        with TerrainClient(endpoint, robot=robot) as client:
            print(json.dumps({"ready": True}), flush=True)
            steps: set[int] = set()
            for line in sys.stdin:
                print(json.dumps(answer(client, json.loads(line), steps)), flush=True)
    except (PerceptionError, TransportError) as error:
        print(f"planner: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        # Ctrl-C at a terminal also reaches this process. No message is needed: the demo reports that it stops.
        return 130
    return 0


def answer(client: TerrainClient, request: dict[str, Any], steps: set[int]) -> dict[str, Any]:
    """Answer a request: wait for the confirmed grids of the step, and choose foothold and swing.

    Args:
        client: connected client.
        request: request as described in the docstring of this module.
        steps: steps whose scans have been received; the step of this request's grid is added.
    """
    step = request["step"]
    steps.add(client.wait_for_step(step, timeout=GRID_TIMEOUT_S, confirmed=True).step)
    terrain = client.wait_for_step(step, timeout=GRID_TIMEOUT_S, extent=request["extent"], confirmed=True)
    x, y, leg = request["x"], request["y"], request["leg"]
    reply: dict[str, Any] = dict.fromkeys(("foothold", "swing", "clearance", "body"))
    reply |= {"step": terrain.step, "leg": leg, "received": len(steps), "reasons": []}
    if request["is_course"]:
        return {**reply, **fitted_stride(terrain)}
    found = plan_swing(terrain, leg, (x, y))
    if found is None:
        reply["reasons"] = [str(reason) for reason in refusals(terrain, leg, (x, y))]
    else:
        foothold = found.foothold
        reply.update(
            foothold=[foothold.x, foothold.y, foothold.z],
            score=foothold.score,
            swing=found.swing.points.tolist(),
            clearance=found.clearance,
        )
    return reply


def fitted_stride(terrain: TerrainGrid) -> dict[str, Any]:
    """Part of an answer: leg, foothold, swing, clearance and position of the body (x, y), or the reasons for none."""
    stride = stride_planner(str(terrain.record.robot_description)).next_stride(terrain)
    if stride is None or stride.swing is None:
        return {"reasons": ["no leg has a safe foothold and swing ahead"]}
    points, body = stride.swing.points.tolist(), stride.body[:2, 3].tolist()
    clearance = SWING_CLEARANCES[-1]
    return {"leg": stride.leg, "foothold": points[-1], "swing": points, "clearance": clearance, "body": body}


@lru_cache(maxsize=1)
def stride_planner(description: str) -> StridePlanner:
    """Stride planner for the robot that is described in the grids."""
    return StridePlanner(robot_from_description(description))


if __name__ == "__main__":
    sys.exit(main())
