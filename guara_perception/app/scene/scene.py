"""Scene of a pause as ROS messages: robot with its frames, ground, clouds, camera, range images, next footholds."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from guara_perception.app.files.export import cell_cloud
from guara_perception.app.messages import message_to_terrain
from guara_perception.arrays import Array, Float, Float32
from guara_perception.calibration.calibration import Calibration
from guara_perception.exceptions import InvalidInput
from guara_perception.scanning.pictures import cause_image, sigma_image_mm
from guara_perception.terrain.grid import TerrainGrid
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
from transport.grids.grid_publishers import GRID_MAP_LAYERS
from transport.keys import RANGE_IMAGES
from transport.recording import CAMERA_FRAME
from transport.recording.records import image_message

if TYPE_CHECKING:
    from guara_perception.ranging.stripe_points import StripePoints

# Short name of a topic (transport.recording.topics) and a message on it.
Named = tuple[str, Any]
PREFIX = {"footprint": "", "map": "map/"}
Fields = dict[str, Array]


class Scene:
    """Converter of the pauses of one robot to ROS messages; stamps are in ns since the Unix epoch."""

    def __init__(self, robot: RobotModel, calibration: Calibration) -> None:
        """Create the scene of a robot and its rangefinder.

        Raises:
            InvalidInput: the calibration belongs to another robot.
        """
        if calibration.robot != robot.name:
            raise InvalidInput(f"the calibration belongs to robot {calibration.robot!r}, not {robot.name!r}")
        self._robot, self._calibration = robot, calibration

    def unchanging(self, stamp: int) -> Iterator[Named]:
        """Messages that do not change during a walk: the robot's URDF and its fixed frames."""
        yield "/robot_description", text_message(self._robot.tree.urdf.text)
        yield "/tf_static", frames_message(self._fixed(), stamp)

    def of_stance(self, stance: Stance, stamp: int) -> Iterator[Named]:
        """Messages of the robot's stance before a scan, and of its camera.

        Raises:
            kinematics.KinematicsError: the stance does not fit the robot.
        """
        mount, base = self._calibration.transform_camera_to_base, self._robot.config.base_frame
        to_footprint = self._robot.stance_pose(stance, transform_camera_to_base=mount).transform_base_to_footprint
        body = TransformMessage(source_frame=base, destination_frame=BASE_FOOTPRINT, matrix=to_footprint)
        yield "/tf", frames_message([body, *self._between_links(stance.joint_positions)], stamp)
        camera = self._calibration.camera
        yield (
            "camera/camera_info",
            camera_info_message(camera.size, camera.matrix, camera.distortion, CAMERA_FRAME, stamp),
        )

    def of_points(self, points: Mapping[int, StripePoints], stamp: int) -> Iterator[Named]:
        """Message of the points of a scan's stripes, by index."""
        yield "scan/points", point_cloud_message(stripe_cloud(points), BASE_FOOTPRINT, stamp)

    def of_grid(self, message: TerrainMessage, *, unknown: int = 100) -> Iterator[Named]:
        """Messages of a grid: occupancy and grid map; for a map also points, markers and the robot's pose in odom.

        Args:
            message: message of the grid as it was sent.
            unknown: value of unknown cells of the occupancy, 100 or -1.

        Raises:
            UnsafeGrid: the grid violates the safety invariant.
            InvalidInput: `unknown` is neither 100 nor -1.
            kinematics.KinematicsError: the stance of a map does not fit the robot.
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
        """Frames of the robot at the scan of a map, in `odom`."""
        base = self._robot.config.base_frame
        # Transforms of the body only; the camera's is among the fixed ones.
        body = [
            dataclasses.replace(item, source_frame=base if item.source_frame == "base_link" else item.source_frame)
            for item in message.transforms
            if item.source_frame in ("base_link", BASE_FOOTPRINT)
        ]
        return [*body, *self._between_links(message.stance.joint_positions)]

    def _fixed(self) -> list[TransformMessage]:
        """Transforms of fixed joints, and of CAMERA_FRAME if the camera's link has another name."""
        nominal = self._robot.posture(self._robot.config.scan_posture)
        fixed = self._between_links(nominal, of_fixed_joints=True)
        camera = self._robot.config.camera_frame
        if camera != CAMERA_FRAME:
            # Camera images are in CAMERA_FRAME, whatever the name of the camera's link in the URDF.
            fixed.append(TransformMessage(source_frame=CAMERA_FRAME, destination_frame=camera, matrix=np.eye(4)))
        return fixed

    def _between_links(
        self, joint_positions: Mapping[str, float], *, of_fixed_joints: bool = False
    ) -> list[TransformMessage]:
        """Transforms of the moving or fixed joints, with the camera at its calibrated mount instead of the URDF's."""
        state = self._robot.state(joint_positions)

        def to_base(link: str) -> Float:
            if link == self._robot.config.camera_frame:
                return self._calibration.transform_camera_to_base
            return state.transform_to_base(link)

        return [
            TransformMessage(
                source_frame=joint.child,
                destination_frame=joint.parent,
                matrix=np.linalg.inv(to_base(joint.parent)) @ to_base(joint.child),
            )
            for joint in self._robot.tree.urdf.joints
            if (joint.kind == "fixed") == of_fixed_joints
        ]


def stripe_cloud(stripes: Mapping[int, StripePoints]) -> Fields:
    """Points of all stripes of a scan in base_footprint: x, y, z, sigma [m], stripe index."""
    parts = [(index, stripe, np.isfinite(stripe.points).all(axis=1)) for index, stripe in stripes.items()]
    points = np.vstack([np.zeros((0, 3), np.float32), *(stripe.points[kept] for _, stripe, kept in parts)])
    variance = np.concatenate([np.zeros(0, np.float32), *(stripe.variance[kept] for _, stripe, kept in parts)])
    index = np.concatenate(
        [np.zeros(0, np.uint16), *(np.full(int(kept.sum()), number, np.uint16) for number, _, kept in parts)]
    )
    return {
        **{name: np.ascontiguousarray(points[:, axis]) for axis, name in enumerate(("x", "y", "z"))},
        "sigma": np.sqrt(variance).astype(np.float32),
        "stripe": index,
    }


def cloud_points(cloud: Any) -> Float32:
    """Points (n, 3) float32 of a PointCloud2 message."""
    return np.column_stack([cloud_field(cloud, name) for name in ("x", "y", "z")])


def cloud_field(cloud: Any, name: str) -> Array:
    """Values (n,) of one field of a PointCloud2 message that `point_cloud_message` made."""
    field = next(field for field in cloud.fields if field.name == name)
    kind = np.dtype({4: "<u2", 6: "<u4", 7: "<f4"}[field.datatype])
    rows = cloud.data.reshape(cloud.width, cloud.point_step)[:, field.offset : field.offset + kind.itemsize]
    return np.ascontiguousarray(rows).view(kind).reshape(-1)


def planned_footholds(robot: RobotModel, terrain: TerrainGrid) -> dict[str, tuple[float, float, float]]:
    """Next foothold (x, y, z) in base_footprint [m] by leg, where a simple planner finds one on this grid.

    Empty if the record of the grid lacks the robot, its stance, its limits or its transform to the footprint.
    """
    from guara_perception.simulation.gait import WaveGait
    from guara_perception.simulation.planner import plan_foothold

    record = terrain.record
    if None in (record.robot, record.stance, record.limits) or record.transform_base_to_footprint is None:
        return {}
    gait = WaveGait.of(robot)
    planned = {}
    for leg in robot.legs:
        x, y = gait.landing(leg)
        found = plan_foothold(terrain, leg, (x + gait.advance, y), robot=robot)
        if found is not None:
            planned[leg] = (found.x, found.y, found.z)
    return planned


def range_image_messages(terrain: TerrainGrid) -> dict[str, Any]:
    """Make the sensor_msgs/Image messages of a grid with pictures, by the names of RANGE_IMAGES.

    Heights and standard deviations in m, NaN = unknown; causes as flags of `Hazard`.
    """
    heights = terrain.pictures["ortho_image_mm"] * np.float32(1e-3)
    images = (heights, "32FC1"), (cause_image(terrain), "8UC1"), (sigma_image_mm(terrain) * np.float32(1e-3), "32FC1")
    return {
        name: image_message(pixels, encoding, terrain.frame, terrain.stamp)
        for name, (pixels, encoding) in zip(RANGE_IMAGES, images, strict=True)
    }
