"""`guara run --simulated --gait external`: a gait in another process drives the simulated robot."""

import dataclasses
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.demo.check import true_elevation
from guara_perception.app.main import run
from guara_perception.app.messages import stance_to_message
from guara_perception.app.node.node_status import NodeStatus
from guara_perception.app.node.simulated import SimulatedRobot
from guara_perception.app.node.simulated_gaits import ExternalGait, stand_on_ground
from guara_perception.simulation.walk import WalkNoise, WalkPause, simulate_walk
from guara_perception.simulation.world import parse_world
from kinematics import RobotModel, Stance, load_robot
from testbed.altered_robot import telescopic_guara
from tests.forked import ForkedProcess
from tests.guara_perception.app.node.developed_gait import jumped
from transport import MessageError, PausePhase, StancePause

PATIENCE = 180.0
GAIT = Path(__file__).with_name("developed_gait.py")
WORLD = """
x = [-1.0, 3.0]
y = [-0.8, 0.8]
undulation = 0.002
flat_until = 0.55

[[box]]
x = 0.75
y = 0.0
size = [0.10, 0.10]
height = 0.06
"""


@pytest.fixture
def world(tmp_path: Path) -> Path:
    """World with a 60 mm box in the scanned area."""
    path = tmp_path / "world.toml"
    path.write_text(WORLD)
    return path


class Follower:
    """`ExternalGait` before a node that only receives, with the reported lines."""

    def __init__(self, world: str = WORLD, robot: str | Path = "guara") -> None:
        self.heard: list[StancePause | MessageError] = []
        self.told: list[str] = []
        self.poses: list[np.ndarray] = []
        self.robot = SimulatedRobot(robot, world=parse_world(world, "world"), size=(64, 64))
        self.status = NodeStatus()
        node = SimpleNamespace(status=self.status, on_pause=self.heard.append, on_refused=self.heard.append)
        place = self.robot.place
        self.robot.place = lambda pose, joints: (self.poses.append(pose), place(pose, joints))[1]  # type: ignore[method-assign]
        self.gait = ExternalGait(self.robot, node, self.told.append)  # type: ignore[arg-type]

    def begin(self, pause: WalkPause, epoch: str = "walk") -> None:
        self.stand(pause.stance, pause.step, epoch)

    def stand(self, stance: Stance, step: int = 0, epoch: str = "walk") -> None:
        message, stamp = stance_to_message(stance), time.time_ns()
        self.gait.on_pause(
            StancePause(robot="guara", step=step, phase=PausePhase.BEGIN, stamp=stamp, stance=message, epoch=epoch)
        )


def pauses_of(robot: RobotModel, cycles: float, imu: float | None = 0.00175) -> list[WalkPause]:
    """Pauses of a walk over WORLD."""
    return list(simulate_walk(parse_world(WORLD, "world"), robot, cycles=cycles, noise=WalkNoise(imu=imu)))


@pytest.mark.slow
@pytest.mark.parametrize("imu", [0.00175, None])
def test_the_robot_stands_where_the_joints_put_it(robot: RobotModel, imu: float | None) -> None:
    """Position, heading and tilt over eight steps agree with the gait's own simulation, from joints and feet alone."""
    follower = Follower()
    pauses = pauses_of(robot, 2, imu)
    for pause in pauses:
        follower.begin(pause)
    assert follower.told == [] and len(follower.heard) == len(pauses) == len(follower.poses)
    first = np.linalg.inv(pauses[0].transform_footprint_to_world) @ pauses[0].transform_base_to_world
    start = pauses[0].transform_base_to_world @ np.linalg.inv(first)
    for pause, pose in zip(pauses, follower.poses, strict=True):
        error = np.linalg.inv(pose) @ np.linalg.inv(start) @ pause.transform_base_to_world
        assert np.linalg.norm(error[:3, 3]) < 0.02
        assert np.linalg.norm(error[:3, :3] - np.eye(3)) < 0.05
    assert not [item for item in follower.status.items() if item.name == "gait"]


@pytest.mark.slow
def test_a_new_walk_begins_at_the_origin(robot: RobotModel) -> None:
    """A new epoch begins a new walk; a late BEGIN moves nothing."""
    follower = Follower()
    pauses = pauses_of(robot, 1)
    for pause in pauses[:3]:
        follower.begin(pause)
    follower.begin(pauses[1])
    assert len(follower.poses) == 3 and len(follower.heard) == 4
    follower.begin(pauses[0], "another walk")
    np.testing.assert_allclose(follower.poses[3], follower.poses[0], atol=1e-9)


@pytest.mark.slow
def test_what_does_not_fit_the_world_is_told(robot: RobotModel) -> None:
    """Joints beyond limits, hanging feet, wrong gravity and a jump are reported, and solved by the next pause."""
    follower = Follower()
    pauses = pauses_of(robot, 0.25)
    follower.begin(pauses[0])
    knee = robot.tree.leg("lf").joints[-1]
    for change, told in (
        ({"joint_positions": {**pauses[1].stance.joint_positions, knee: 1.4}}, "beyond its limits"),
        ({"gravity_in_base": (0.2, 0.0, -1.0)}, "gravity_in_base is 11."),
    ):
        follower.begin(dataclasses.replace(pauses[1], stance=dataclasses.replace(pauses[1].stance, **change)))
        assert told in follower.told[-1] and follower.told[-1].startswith("gait: step 1: ")
        assert [item.message for item in follower.status.items() if item.name == "gait"] == [follower.told[-1][6:]]
    count = len(follower.told)
    jump = jumped(robot, pauses[1])
    follower.begin(jump)
    assert "the gait jumped: " in follower.told[-1] and "is set down where it stood" in follower.told[-1]
    follower.begin(dataclasses.replace(jump, step=3))
    assert len(follower.told) == count + 1
    assert not [item for item in follower.status.items() if item.name == "gait"]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::kinematics.exceptions.JointLimitWarning")
def test_joints_that_slide_are_metres(tmp_path: Path) -> None:
    """A prismatic knee 5 mm beyond its limit is reported; its encoder bias is below a millimetre, not 3.5 mm."""
    folder = telescopic_guara(tmp_path)
    follower, robot = Follower(robot=folder), load_robot(folder)
    placed: list[dict[str, float]] = []
    place = follower.robot.place
    follower.robot.place = lambda pose, joints: (placed.append(joints), place(pose, joints))[1]  # type: ignore[method-assign]
    still = robot.posture("scan")
    follower.stand(Stance(still, robot.legs))
    assert follower.told == []
    knees = [name for name in still if "kfe" in name]
    assert 0.0 < max(abs(placed[0][name] - still[name]) for name in knees) < 0.0025
    follower.stand(Stance({**still, knees[0]: -0.005}, robot.legs), 1)
    assert f"joint {knees[0]} is 0.005 m beyond its limits" in follower.told[-1]


@pytest.mark.slow
def test_a_camera_in_a_wall_sees_nothing(robot: RobotModel) -> None:
    """The node receives an error instead of the pause; the next walk proceeds."""
    follower = Follower(WORLD.replace("x = 0.75", "x = 1.0").replace("0.06", "0.9").replace("0.10, 0.10", "0.6, 0.2"))
    pauses = pauses_of(robot, 3)
    for pause in pauses:
        follower.begin(pause)
        if follower.told:
            break
    assert "above the ground; allowed: 0.05 m or more" in follower.told[0]
    assert isinstance(follower.heard[-1], MessageError) and len(follower.heard) > 1
    follower.begin(pauses[0], "another walk")
    assert isinstance(follower.heard[-1], StancePause)


def test_feet_that_do_not_fit_the_ground_are_measured() -> None:
    """On an inclined plane the body tilts with it; a foot 40 mm short hangs."""
    ramp = "x = [-1.0, 3.0]\ny = [-0.8, 0.8]\n[[ramp]]\nx = 0.5\ny = 0.0\nsize = [2.0, 1.4]\nheight = 0.2\n"
    soles = np.array([[0.2, 0.2, -0.4], [0.2, -0.2, -0.4], [-0.2, 0.2, -0.4], [-0.2, -0.2, -0.4]])
    start = np.eye(4)
    start[:3, 3] = 0.5, 0.0, 0.6
    pose, heights = stand_on_ground(parse_world(ramp, "ramp"), start, soles, (0.001, 0.001))
    assert np.abs(heights).max() < 1e-3
    assert -pose[2, 0] == pytest.approx(-np.sin(np.arctan(0.1)), abs=0.01)
    np.testing.assert_allclose(pose[:2, 3], start[:2, 3], atol=0.05)
    soles[0, 2] += 0.08
    _, heights = stand_on_ground(parse_world(ramp, "ramp"), start, soles, (0.001, 0.001))
    assert sorted(np.round(np.abs(heights), 3)) == pytest.approx([0.02] * 4, abs=0.002)


@pytest.fixture
def node(free_endpoint: str, world: Path) -> Iterator[ForkedProcess]:
    """The command as a developer starts it."""
    arguments = ["run", "--simulated", "--gait", "external", "--world", str(world), "--listen", free_endpoint]
    process = ForkedProcess("-m", "guara_perception.app.main", *arguments, "--mode", "coarse")
    yield process
    process.kill()


@pytest.mark.heavy
def test_a_gait_in_another_process_drives_the_robot(
    node: ForkedProcess, free_endpoint: str, world: Path, robot: RobotModel
) -> None:
    """Grids show the world from where the gait stands; contradictions are reported, and the node continues."""
    with gp.TerrainClient(free_endpoint, timeout=PATIENCE) as client:
        with pytest.raises(gp.ReceiveTimeout):
            client.wait_for_step(0, timeout=3.0)
        for mistake in ("", "limits", "impossible", "jump"):
            arguments = [str(GAIT), free_endpoint, str(world), *([mistake] if mistake else [])]
            gait = ForkedProcess(*arguments)
            printed, _ = gait.communicate(timeout=PATIENCE)
            assert gait.returncode == 0 and printed.splitlines()[-1] == "step 2 is over"
            if not mistake:
                grid = client.wait_for_step(2, timeout=PATIENCE)
    pause = list(simulate_walk(parse_world(WORLD, "world"), robot, cycles=3))[2]
    error = np.abs(grid.elevation - true_elevation(parse_world(WORLD, "world"), pause, grid))
    assert np.nanmedian(error) < 0.004
    assert max(obstacle.height for obstacle in grid.obstacles()) == pytest.approx(0.06, abs=0.006)
    node.send_signal(signal.SIGINT)
    printed, _ = node.communicate(timeout=PATIENCE)
    lines = printed.splitlines()
    assert node.returncode == 0 and lines[-1] == "stopped, laser off"
    assert "guara: waiting for your gait to announce stance pauses on guara/gait/v1/stance" in lines
    scans = [line for line in lines if line.startswith("step ")]
    assert [line.split(",")[0] for line in scans] == [f"step {n}" for n in (0, 1, 2, 0, 1, 2, 0, 1, 0, 1, 2)]
    told = [line for line in lines if line.startswith("gait: ")]
    assert ["beyond its limits" in told[0], "impossible" in told[1]] == [True, True]
    assert "the gait jumped" in told[2]


@pytest.mark.parametrize("more", [["--gait", "external"], ["--world", "sunlit"]])
def test_a_real_robot_has_no_simulated_world(more: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 2 with the remedy."""
    assert run(["run", *more]) == 2
    assert "--gait and --world require --simulated" in capsys.readouterr().err


def test_a_world_that_is_not_there_is_named(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Exit 2 with the list of worlds."""
    assert run(["run", "--simulated", "--gait", "external", "--world", str(tmp_path / "no.toml")]) == 2
    assert "worlds that come with the package: demo" in capsys.readouterr().err
