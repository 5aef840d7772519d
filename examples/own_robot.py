"""Robot loaded from its folder; the pose of its camera over the ground follows from the joint positions.

    python examples/own_robot.py guara

Create a folder for your own robot with `guara robot new my.urdf -o robots/mine`.
"""

import numpy as np

import guara_perception as gp


def main(name: str) -> None:
    """Print position and viewing direction of the camera in the scan posture."""
    robot = gp.load_robot(name)
    stance = gp.Stance(robot.posture(robot.config.scan_posture), robot.legs, gravity_in_base=(0.0, 0.0, -1.0))
    pose = robot.stance_pose(stance)
    camera = pose.transform_camera_to_footprint
    print(f"{robot.name}: legs {', '.join(robot.legs)}, attitude from {pose.attitude_source}")
    print(f"camera {1e3 * camera[2, 3]:.0f} mm above the soles, {1e3 * camera[0, 3]:.0f} mm ahead of the body")
    print(f"optical axis {np.round(camera[:3, 2], 2)} in base_footprint")


if __name__ == "__main__":
    from arguments import call

    call(main)
