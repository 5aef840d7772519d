"""A gait in development, in a process of its own: walks over a world that it knows, and makes mistakes when told to.

python developed_gait.py ENDPOINT WORLD [MISTAKE]; a line per pause.
"""

import dataclasses
import sys

import guara_perception as gp
from guara_perception.app.node.simulated import SimulatedGait
from guara_perception.simulation.gait import stand_on
from guara_perception.simulation.walk import WalkPause, simulate_walk
from guara_perception.simulation.world import load_world
from kinematics import RobotModel
from transport import StancePublisher, open_client

PATIENCE = 180.0
# Angle by which a knee is bent too far [rad].
MISTAKES = {"limits": 0.2, "impossible": 1.0}


def jumped(robot: RobotModel, pause: WalkPause) -> WalkPause:
    """Make the next pause, with all feet closer together."""
    soles = {leg: pause.soles_in_world[leg] * (0.8, 0.8, 1.0) for leg in robot.legs}
    _, joints = stand_on(robot, soles, (0.03, 0.0), 0.36)
    stance = dataclasses.replace(pause.stance, joint_positions=joints, gravity_in_base=None)
    return dataclasses.replace(pause, step=pause.step + 1, stance=stance)


def walk(world: str, mistake: str) -> list[WalkPause]:
    """Yield three pauses; with a mistake, the last one is wrong."""
    robot = gp.load_robot("guara")
    pauses = list(simulate_walk(load_world(world), robot, cycles=3))
    if mistake == "jump":
        return [*pauses[:2], jumped(robot, pauses[1])]
    if mistake:
        last = pauses[2].stance
        joint, upper = robot.tree.leg("lf").joints[-1], robot.tree.upper_limits
        bent = upper[robot.tree.joint_index(joint)] + MISTAKES[mistake]
        wrong = dataclasses.replace(last, joint_positions={**last.joint_positions, joint: bent})
        return [*pauses[:2], dataclasses.replace(pauses[2], stance=wrong)]
    return pauses[:3]


def main(endpoint: str, world: str, mistake: str = "") -> None:
    """Walk; do not wait for an impossible pause after its announcement."""
    with open_client(endpoint) as session, gp.TerrainClient(endpoint) as client:
        publisher = StancePublisher(session)
        gait = SimulatedGait(publisher, "guara", seed=1)
        for pause in walk(world, mistake):
            gait.begin(pause)
            if mistake != "impossible" or pause.step < 2:
                grid = client.wait_for_step(pause.step, timeout=PATIENCE)
                while grid.metadata["epoch"] != gait.epoch:
                    grid = client.wait_for_step(pause.step, timeout=PATIENCE)
                gait.hold(pause)
            gait.end(pause)
            print(f"step {pause.step} is over", flush=True)
        publisher.flush(PATIENCE)


if __name__ == "__main__":
    main(*sys.argv[1:])
