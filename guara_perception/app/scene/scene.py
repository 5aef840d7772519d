"""The scene of a pause as ROS messages: what a viewer needs to draw robot, ground, cloud and pictures together."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from guara_perception.app.messages import message_to_terrain
from guara_perception.app.scene.clouds import cell_cloud, stripe_cloud
from guara_perception.app.scene.planned_footholds import planned_footholds
from guara_perception.app.scene.robot_frames import RobotFrames
from guara_perception.calibration.calibration import Calibration
from guara_perception.exceptions import InvalidInput
from kinematics import BASE_FOOTPRINT, RobotModel, Stance
from transport import (
    TerrainMessage,
    TransformMessage,
    camera_info_message,
    frames_message,
    grid_map_message,
    markers_message,
    occupancy_message,
    point_cloud_message,
    text_message,
)
from transport.grid_publishers import GRID_MAP_LAYERS
from transport.recording import CAMERA_FRAME

if TYPE_CHECKING:
    from guara_perception.ranging.stripe_points import StripePoints

# Topic by its short name (transport.recording.topics) and message object.
Named = tuple[str, Any]
PREFIX = {"footprint": "", "map": "map/"}


class Scene:
    """Makes the messages of one robot's scenes; stamps are [ns] since the epoch."""

    def __init__(self, robot: RobotModel, calibration: Calibration) -> None:
        """For a robot and its rangefinder.

        Raises:
            InvalidInput: the calibration belongs to another robot.
        """
        if calibration.robot != robot.name:
            raise InvalidInput(f"the calibration is of robot {calibration.robot!r}, the robot is {robot.name!r}")
        self._robot, self._calibration = robot, calibration
        self._frames = RobotFrames(robot, calibration.transform_camera_to_base)

    def unchanging(self, stamp: int) -> Iterator[Named]:
        """What holds for the whole walk: the robot's URDF and what no joint moves."""
        yield "/robot_description", text_message(self._robot.tree.urdf.text)
        yield "/tf_static", frames_message(self._frames.fixed(), stamp)

    def of_stance(self, stance: Stance, stamp: int) -> Iterator[Named]:
        """The robot as it stands before a scan, and the camera that will look.

        Raises:
            kinematics.KinematicsError: the stance does not fit the robot.
        """
        yield "/tf", frames_message(self._frames.standing(stance), stamp)
        camera = self._calibration.camera
        yield (
            "camera/camera_info",
            camera_info_message(camera.size, camera.matrix, camera.distortion, CAMERA_FRAME, stamp),
        )

    def of_points(self, points: Mapping[int, StripePoints], stamp: int) -> Iterator[Named]:
        """The points of a scan's stripes, by index."""
        yield "scan/points", point_cloud_message(stripe_cloud(points), BASE_FOOTPRINT, stamp)

    def of_grid(self, message: TerrainMessage, *, unknown: int = 100) -> Iterator[Named]:
        """What is made of a grid: occupancy and grid map; of a map also cells as points, markers, odom.

        Args:
            message: message of the grid as it was sent.
            unknown: value of unknown cells of the occupancy, 100 or -1.

        Raises:
            UnsafeGrid: the grid breaks the safety invariant.
        """
        terrain = message_to_terrain(message)
        prefix = PREFIX[terrain.extent]
        geometry = (terrain.resolution, terrain.origin, terrain.frame, message.stamp)
        yield f"{prefix}occupancy", occupancy_message(terrain.to_occupancy(unknown), *geometry)
        yield f"{prefix}grid_map", grid_map_message({name: message.layers[name] for name in GRID_MAP_LAYERS}, *geometry)
        if terrain.extent != "map":
            return
        yield "/tf", frames_message(self._placed(message), message.stamp)
        yield "map/points", point_cloud_message(cell_cloud(terrain), terrain.frame, message.stamp)
        footholds = {} if message.withdrawn else planned_footholds(self._robot, terrain)
        regions = [] if message.withdrawn else [region.vertices for region in terrain.steppable_regions()]
        sole = self._robot.sole
        yield "markers", markers_message(message.obstacles, footholds, sole, terrain.frame, message.stamp, regions)

    def _placed(self, message: TerrainMessage) -> list[TransformMessage]:
        """The robot as it stood at the scan of a map, in `odom`."""
        base = self._robot.config.base_frame
        # Only the transforms of the body; that of the camera is among the fixed ones.
        body = [
            dataclasses.replace(item, source_frame=base if item.source_frame == "base_link" else item.source_frame)
            for item in message.transforms
            if item.source_frame in ("base_link", BASE_FOOTPRINT)
        ]
        return [*body, *self._frames.moving(message.stance.joint_positions)]
