"""Gait controller: announces the begin and end of each stance pause, and meanwhile that the robot still stands.

Start a node in one terminal (`guara run -c calibration.json`) and this in another:

    python examples/gait_side.py tcp/127.0.0.1:7447 --pauses 3
"""

import argparse
import threading
import time
import uuid

import numpy as np

import guara_perception as gp
from transport import PausePhase, StanceMessage, StancePause, StancePublisher, StanceStreamPublisher, open_client

# Interval between two HOLDs [s]. It takes many readings to distinguish a motion of 1 mm from encoder noise.
HOLD_PERIOD = 0.02
# Sampling period of the joint stream [s].
SAMPLE_PERIOD = 0.005
# Time for which a real gait would swing a leg, to a foothold on the confirmed grid [s].
SWING = 1.0


def main() -> None:
    """Stand in the scan posture for some pauses, with new noisy readings of joints and gravity in each message."""
    parser = argparse.ArgumentParser()
    parser.add_argument("endpoint")
    parser.add_argument("--pauses", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=4.0)
    options = parser.parse_args()
    robot = gp.load_robot("guara")
    posture, rng = robot.posture(robot.config.scan_posture), np.random.default_rng(0)
    walk = uuid.uuid4().hex
    confirmed: set[tuple[str, int]] = set()

    def take(grid: gp.TerrainGrid) -> None:
        if not grid.is_provisional:
            confirmed.add((grid.metadata["epoch"], grid.step))

    with open_client(options.endpoint) as session, gp.TerrainClient(options.endpoint, robot=robot.name) as client:
        publisher = StancePublisher(session, robot=robot.name)
        client.on_terrain(take)
        stream = StanceStreamPublisher(session, robot.legs, robot=robot.name, epoch=walk)
        is_over = threading.Event()

        def read() -> StanceMessage:
            joints = {name: angle + rng.normal(0.0, robot.noise.encoder_noise) for name, angle in posture.items()}
            gravity = tuple((np.array([0.0, 0.0, -1.0]) + rng.normal(0.0, robot.noise.imu_sigma, 3)).tolist())
            return StanceMessage(joint_positions=joints, support_feet=robot.legs, gravity_in_base=gravity)

        def sample() -> None:
            while not is_over.wait(SAMPLE_PERIOD):
                stream.add(time.time_ns(), read())

        def announce(step: int, phase: PausePhase, time_available: float = 0.0) -> None:
            publisher.publish(
                StancePause(
                    robot=robot.name,
                    step=step,
                    phase=phase,
                    stamp=time.time_ns(),
                    stance=read(),
                    time_available=time_available,
                    epoch=walk,
                    # In this example no foot swings; a foot set down since the previous pause would have 0. A restarted
                    # node continues with its map only if the gait reports these numbers.
                    standing_pauses=(step,) * len(robot.legs),
                )
            )

        sampling = threading.Thread(target=sample)
        sampling.start()
        for step in range(options.pauses):
            begun = time.monotonic()
            announce(step, PausePhase.BEGIN, options.seconds)
            # The robot stands until its scan is confirmed, and no longer than announced.
            while (walk, step) not in confirmed and (left := begun + options.seconds - time.monotonic()) > 0:
                time.sleep(min(HOLD_PERIOD, left))
                announce(step, PausePhase.HOLD)
            announce(step, PausePhase.END)
            stood = time.monotonic() - begun
            time.sleep(SWING)
            found = "confirmed" if (walk, step) in confirmed else "not confirmed"
            print(f"step {step}: END after {stood:.1f} s, its grid is {found}")
        is_over.set()
        sampling.join()
        stream.flush(5.0)
        publisher.flush(5.0)


if __name__ == "__main__":
    main()
