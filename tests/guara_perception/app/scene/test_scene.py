"""Scene of a pause: grids, clouds, transforms and markers agree with grid, robot and calibration."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.files.export import cell_cloud
from guara_perception.app.messages import terrain_to_message
from guara_perception.app.scene.scene import Scene, stripe_cloud
from guara_perception.scanning.process import run_scan
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from guara_perception.terrain.map.terrain_map import TerrainMap
from kinematics import LegOdometry, PoseInOdom, RobotModel, load_robot
from transport.recording import CAMERA_FRAME
from transport.recording.topics import TYPES

STAMP = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def scene(robot: RobotModel, calibration: gp.Calibration) -> Scene:
    return Scene(robot, calibration)


@pytest.fixture(scope="module")
def fused(paper_terrain: gp.TerrainGrid, robot: RobotModel, paper_scan: gp.Scan) -> gp.TerrainGrid:
    pose = LegOdometry(robot).update(paper_scan.stance)
    return TerrainMap(robot).update(paper_terrain, PoseInOdom(pose.transform_footprint_to_odom, pose.covariance))


def _to_root(messages: list, frame: str) -> tuple[str, np.ndarray]:
    """Root of the TF tree, and the transform of a frame to it."""
    parents = {t.child_frame_id: t for message in messages for t in message.transforms}
    matrix = np.eye(4)
    while frame in parents:
        t = parents[frame]
        q, p = t.transform.rotation, t.transform.translation
        x, y, z, w = q.x, q.y, q.z, q.w
        to_parent = np.eye(4)
        to_parent[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        to_parent[:3, 3] = p.x, p.y, p.z
        matrix, frame = to_parent @ matrix, t.header.frame_id
    return frame, matrix


def test_tf_says_where_camera_and_soles_are(
    scene: Scene, robot: RobotModel, calibration: gp.Calibration, paper_scan: gp.Scan
) -> None:
    """Chained as ROS does, the transforms give the calibrated camera and the feet on the ground; every link occurs
    once.
    """
    static = dict(scene.unchanging(STAMP))["/tf_static"]
    moving = dict(scene.of_stance(paper_scan.stance, STAMP))["/tf"]
    children = [t.child_frame_id for message in (static, moving) for t in message.transforms]
    assert len(children) == len(set(children)) and set(children) == set(robot.tree.links)
    pose = robot.stance_pose(paper_scan.stance, transform_camera_to_base=calibration.transform_camera_to_base)
    root, camera = _to_root([static, moving], CAMERA_FRAME)
    assert root == "base_footprint"
    wanted = pose.transform_base_to_footprint @ calibration.transform_camera_to_base
    np.testing.assert_allclose(camera, wanted, atol=1e-9)
    soles = [_to_root([static, moving], robot.tree.leg(leg).sole)[1][2, 3] for leg in paper_scan.stance.support_feet]
    assert np.abs(soles).max() < 0.002


def test_the_map_brings_odom(scene: Scene, fused: gp.TerrainGrid) -> None:
    """With the map, the robot has the pose in `odom` that the map states."""
    data = {**fused.metadata, "transform_footprint_to_odom": (0.5 * np.eye(4) + 0.5 * np.diag([1, 1, 1, 1])).tolist()}
    named = list(scene.of_grid(terrain_to_message(_with(fused, data), robot="guara", sequence=1)))
    static = dict(scene.unchanging(STAMP))["/tf_static"]
    assert _to_root([static, dict(named)["/tf"]], "lf_sole")[0] == "odom"


def _with(terrain: gp.TerrainGrid, metadata: dict) -> gp.TerrainGrid:
    import dataclasses

    return dataclasses.replace(terrain, record=type(terrain.record).from_json(metadata))


def test_every_message_fits_its_topic(
    scene: Scene, paper_terrain: gp.TerrainGrid, fused: gp.TerrainGrid, paper_scan: gp.Scan
) -> None:
    """The recorder knows topic and type of every message of a scene."""
    named = [
        *scene.unchanging(STAMP),
        *scene.of_stance(paper_scan.stance, STAMP),
        *scene.of_points({}, 0),
    ]
    for sequence, terrain in enumerate((paper_terrain, fused)):
        named += scene.of_grid(terrain_to_message(terrain, robot="guara", sequence=sequence))
    assert {short for short, _ in named} >= {
        "/robot_description",
        "/tf",
        "/tf_static",
        "camera/camera_info",
        "occupancy",
        "grid_map",
        "map/occupancy",
        "map/grid_map",
        "map/points",
        "scan/points",
        "markers",
    }
    assert all(TYPES[short] == message.__msgtype__ for short, message in named)


def test_a_cloud_of_cells_draws_nothing_where_nothing_was_seen(paper_terrain: gp.TerrainGrid) -> None:
    """One point per known cell with its height and flags; none for an unknown cell."""
    cloud = cell_cloud(paper_terrain)
    known = (paper_terrain.hazard & UNKNOWN_MASK) == 0
    assert cloud["z"].size == known.sum() > 1000
    np.testing.assert_array_equal(cloud["z"], paper_terrain.elevation[known])
    np.testing.assert_array_equal(cloud["hazard"], paper_terrain.hazard[known])
    assert all(np.isfinite(cloud[name]).all() for name in cloud)
    free = cloud["rgb"][cloud["hazard"] == 0]
    assert set(free.tolist()) == {0xBEEEC7}


def test_a_cloud_of_stripes_holds_every_point_with_its_sigma(
    paper_scan: gp.Scan, calibration: gp.Calibration, robot: RobotModel
) -> None:
    """Every column with a point, and no other."""
    points = run_scan(paper_scan, calibration, robot).points
    cloud = stripe_cloud(points)
    wanted = sum(int(np.isfinite(stripe.points).all(axis=1).sum()) for stripe in points.values())
    assert cloud["x"].size == wanted > 10_000
    assert set(np.unique(cloud["stripe"]).tolist()) <= set(points)
    assert (cloud["sigma"] > 0).all() and np.median(cloud["sigma"]) < 0.002


def test_a_robot_whose_camera_has_another_name_has_the_frame_of_its_pictures(root) -> None:
    """Images are in `camera_optical_frame`; TF connects it to the camera frame of the URDF."""
    tapir = load_robot(root / "tests" / "robots" / "tapir")
    mounted: Any = SimpleNamespace(robot=tapir.name, transform_camera_to_base=tapir.transform_camera_to_base)
    frames = {item.child_frame_id for item in dict(Scene(tapir, mounted).unchanging(0))["/tf_static"].transforms}
    assert CAMERA_FRAME in frames and tapir.config.camera_frame in frames


def test_another_robots_calibration_is_refused(root, calibration: gp.Calibration) -> None:
    """Robot and calibration of a scene must belong together."""
    with pytest.raises(gp.InvalidInput, match="calibration belongs to robot 'guara', not 'tapir'"):
        Scene(load_robot(root / "tests" / "robots" / "tapir"), calibration)
