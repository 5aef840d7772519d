"""RViz on what `guara run --ros2 --ros2-tf` mirrors; `robot:=NAME` for another instance name than guara."""

from __future__ import annotations

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    """RViz with the configuration beside this file; TF is taken from below the robot's name."""
    robot = LaunchConfiguration("robot")
    names = ("occupancy", "grid_map", "map/occupancy", "map/grid_map", "map/points", "scan/points", "markers")
    remapped = [(f"/guara/{name}", ["/", robot, f"/{name}"]) for name in (*names, "robot_description")]
    remapped += [(f"/{name}", ["/", robot, f"/{name}"]) for name in ("tf", "tf_static")]
    configuration = PathJoinSubstitution([FindPackageShare("guara_msgs"), "rviz", "guara.rviz"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("robot", default_value="guara", description="instance name of the robot"),
            Node(package="rviz2", executable="rviz2", arguments=["-d", configuration], remappings=remapped),
        ]
    )
