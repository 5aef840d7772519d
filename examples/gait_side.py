"""The gait's side: announce each stance pause, say while it lasts that the robot stands, and when it ends.

Start a node in one terminal (`guara run -c calibration.json`) and this in another:

    python examples/gait_side.py tcp/127.0.0.1:7447 --pauses 3
"""

import argparse
import time
import uuid

import numpy as np

import guara_perception as gp
from transport import PausePhase, StanceMessage, StancePause, StancePublisher, open_client


def main() -> None:
    """Three pauses in the scan posture; the joints are read anew for every message, here with an encoder's noise."""
    parser = argparse.ArgumentParser()
    parser.add_argument("endpoint")
    parser.add_argument("--pauses", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=4.0)
    options = parser.parse_args()
    robot = gp.load_robot("guara")
    posture, rng = robot.posture(robot.config.scan_posture), np.random.default_rng(0)
    walk = uuid.uuid4().hex
    with open_client(options.endpoint) as session:
        publisher = StancePublisher(session, robot=robot.name)
        for step in range(options.pauses):
            for phase in (PausePhase.BEGIN, PausePhase.HOLD, PausePhase.END):
                joints = {name: angle + rng.normal(0.0, robot.noise.encoder_noise) for name, angle in posture.items()}
                stance = StanceMessage(joint_positions=joints, support_feet=robot.legs)
                publisher.publish(
                    StancePause(
                        robot=robot.name,
                        step=step,
                        phase=phase,
                        stamp=time.time_ns(),
                        stance=stance,
                        time_available=options.seconds if phase is PausePhase.BEGIN else 0.0,
                        epoch=walk,
                    )
                )
                print(f"step {step}: {phase.name}")
                time.sleep(options.seconds / 2 if phase is not PausePhase.END else 0.0)
        publisher.flush(5.0)


if __name__ == "__main__":
    main()
