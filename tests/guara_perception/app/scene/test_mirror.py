"""Topics of `guara run --ros2` as ROS 2 receives them over real Zenoh."""

import signal
import threading
from pathlib import Path

import numpy as np
import pytest
import zenoh.ext

import guara_perception as gp
from guara_perception.app.main import run
from guara_perception.app.publisher import send_terrain
from guara_perception.app.scene.live import SceneMirror
from guara_perception.app.scene.scene import Scene
from guara_perception.scanning.process import run_scan
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from guara_perception.terrain.map.terrain_map import TerrainMap
from kinematics import LegOdometry, PoseInOdom, RobotModel
from tests.forked import ForkedProcess
from transport import PerceptionServer, open_client, open_node, zenoh_api
from transport.messages.codec import decode

pytestmark = pytest.mark.slow
PATIENCE = 180.0
ALWAYS = {
    "diagnostics",
    "guara/occupancy",
    "guara/grid_map",
    "guara/map/occupancy",
    "guara/map/grid_map",
    "guara/map/points",
    "guara/scan/points",
    "guara/markers",
    "guara/camera/camera_info",
}
OF_THE_ROBOT = {"guara/tf", "guara/tf_static", "guara/robot_description"}


@pytest.mark.parametrize(("with_tf", "unknown"), [(False, 100), (True, -1)])
def test_every_topic_arrives(
    free_endpoint: str,
    robot: RobotModel,
    calibration: gp.Calibration,
    paper_scan: gp.Scan,
    paper_terrain: gp.TerrainGrid,
    with_tf: bool,
    unknown: int,
) -> None:
    """A late transient-local subscriber gets the last of each; the robot's own topics only on request, below its name.

    What is unknown is -1 for ROS where that is asked for, and 100 on the key that planners read all the same.
    """
    wanted = ALWAYS | (OF_THE_ROBOT if with_tf else set())
    arrived: dict[str, tuple[str, bytes]] = {}
    changed = threading.Condition()

    def note(sample) -> None:
        _, *topic, kind, _ = str(sample.key_expr).split("/")
        with changed:
            arrived["/".join(topic)] = (kind, sample.payload.to_bytes())
            changed.notify_all()

    pose = LegOdometry(robot).update(paper_scan.stance)
    fused = TerrainMap(robot).update(paper_terrain, PoseInOdom(pose.transform_footprint_to_odom, pose.covariance))
    with open_node(listen=free_endpoint) as session:
        server = PerceptionServer(session, ros2_domain=5)
        mirror = SceneMirror(server, Scene(robot, calibration), unknown=unknown, with_tf=with_tf)
        mirror.begin(paper_scan.stance, paper_terrain.stamp)
        mirror.points(run_scan(paper_scan, calibration, robot).points, paper_terrain.stamp)
        for terrain in (paper_terrain, fused):
            send_terrain(server, terrain)
        server.flush(PATIENCE)
        with open_client(free_endpoint) as client, gp.TerrainClient(free_endpoint) as planner:
            # Declared before the tokens of late subscribers are queried, so that every newcomer is seen.
            subscriber = zenoh.ext.declare_advanced_subscriber(
                client.raw,
                "5/**",
                zenoh_api.direct(note),
                history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
                recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
            )
            with changed:
                assert changed.wait_for(lambda: wanted <= set(arrived), PATIENCE), wanted - set(arrived)
            received = planner.latest(max_age=float("inf"))
            del subscriber
    assert set(arrived) == wanted
    kind, payload = arrived["guara/occupancy"]
    assert kind == "nav_msgs::msg::dds_::OccupancyGrid_"
    data = decode(payload, "nav_msgs/msg/OccupancyGrid").data.reshape(paper_terrain.shape)
    np.testing.assert_array_equal(data, paper_terrain.to_occupancy(unknown))
    never_seen = (paper_terrain.hazard & UNKNOWN_MASK) != 0
    assert (data[never_seen] == unknown).all() and never_seen.any()
    assert (received.to_occupancy()[never_seen] == 100).all()
    layers = decode(arrived["guara/map/grid_map"][1], "grid_map_msgs/msg/GridMap")
    flags = layers.data[layers.layers.index("hazard")].data.reshape(fused.shape)[::-1, ::-1]
    np.testing.assert_array_equal(flags.astype(np.uint16), fused.hazard)
    assert decode(arrived["diagnostics"][1], "diagnostic_msgs/msg/DiagnosticArray").status[0].name == "transport"
    if with_tf:
        children = [
            t.child_frame_id for t in decode(arrived["guara/tf_static"][1], "tf2_msgs/msg/TFMessage").transforms
        ]
        assert "camera_optical_frame" in children


@pytest.mark.heavy
def test_ctrl_c_while_the_robot_walks_is_no_error(free_endpoint: str) -> None:
    """Exit code 0 and no output on standard error."""
    arguments = ["run", "--simulated", "--ros2", "--ros2-tf", "--mode", "coarse", "--listen", free_endpoint]
    node = ForkedProcess("-m", "guara_perception.app.main", *arguments)
    try:
        with gp.TerrainClient(free_endpoint, timeout=PATIENCE) as client:
            client.wait_for_step(1, timeout=PATIENCE)
        node.send_signal(signal.SIGINT)
        printed, complained = node.communicate(timeout=PATIENCE)
    finally:
        node.kill()
    assert (node.returncode, printed.splitlines()[-1], complained) == (0, "stopped, laser off", "")


@pytest.mark.parametrize("arguments", [["--ros2-tf"], ["--ros2-unknown", "-1"]])
def test_choices_of_the_mirror_need_the_mirror(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 2; the message names the missing option."""
    assert run(["run", "--simulated", *arguments]) == 2
    assert "require --ros2" in capsys.readouterr().err


def test_the_launch_file_and_its_picture_name_topics_that_are_there(root: Path) -> None:
    """Every topic in the RViz configuration is published by the bridge."""
    text = (root / "ros" / "guara_msgs" / "rviz" / "guara.rviz").read_text()
    named = {line.split()[-1].strip("/") for line in text.splitlines() if line.strip().startswith("Value: /")}
    assert named and named <= ALWAYS | OF_THE_ROBOT
