"""Write a robot as an MJCF file for MuJoCo: `python -m testbed.physics ROBOT -o FILE`.

The file contains the shapes, masses and limits of the URDF, a free base, a position servo on every joint, and the
postures of the SRDF as keyframes. The ground belongs to the scene that includes the file.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from kinematics import load_robot
from testbed.physics.mujoco_robot import mjcf


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m testbed.physics", description=__doc__)
    parser.add_argument("robot", help="robot folder, or a robot by name")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="FILE", help="file to write (.xml)")
    options = parser.parse_args(arguments)
    robot = load_robot(options.robot)
    options.out.write_text(mjcf(robot), "utf-8")
    print(f"{options.out}: {len(robot.joint_names)} servos, postures {', '.join(robot.posture_names)}")


if __name__ == "__main__":
    main()
