"""Stock quadrupeds of the package index, each from its URDF to a sound folder and a walk; extra `robots-test`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from guara_perception.app.robot_folder.check import walk_findings
from guara_perception.app.robot_folder.new_robot import new_robot
from guara_perception.app.robot_folder.trial_walk import trial_walk
from kinematics import LegOdometry, RobotModel, Stance, load_robot
from testbed.stock_results import StockResult, line, stock_result
from testbed.stock_robots import FILES, StockRobotsMissing, stock_urdf

pytestmark = pytest.mark.robots
pytest.importorskip("yourdfpy", reason="the extra `robots-test` is not installed")


@pytest.fixture(scope="module", params=FILES)
def result(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[StockResult, Path]:
    """Stock robot and its folder."""
    folder = tmp_path_factory.mktemp("stock") / request.param
    try:
        return stock_result(request.param, folder), folder
    except StockRobotsMissing as error:
        pytest.skip(str(error))


def test_it_loads_and_is_sound(result: tuple[StockResult, Path]) -> None:
    """`robot new` accepts the URDF as it is, and `robot check` finds no fault."""
    assert result[0].is_passed, line(result[0])


def test_its_stance_pose_is_that_of_another_reader(result: tuple[StockResult, Path]) -> None:
    """To a nanometre, in several stances and attitudes."""
    assert result[0].difference < 1e-9


@pytest.mark.slow
def test_it_walks_and_takes_nothing_unknown_for_safe(result: tuple[StockResult, Path]) -> None:
    """Ten pauses over boxes, a pit and a dark patch: no unknown cell is traversable, no foot is on a hazard."""
    walk = trial_walk(load_robot(result[1]))
    assert not list(walk_findings(walk)) and walk.pauses == 10 and walk.feet >= 9, walk


class RollingFoot:
    """Ball foot that rolls without slipping under a level body."""

    def __init__(self, robot: RobotModel, leg: str, x: float, y: float) -> None:
        """Place it with its centre above x and y in the world."""
        self._robot, self._leg, self._radius = robot, leg, robot.config.sole_radius
        self._level = self._tilt(robot.posture("scan"))
        self.set_down(x, y)

    def set_down(self, x: float, y: float) -> None:
        self._x, self._y, self._turned, self.turned = x, y, None, 0.0

    def _tilt(self, joints: dict[str, float]) -> float:
        x = self._robot.state(joints).transform_to_base(self._robot.tree.leg(self._leg).sole)[:3, 0]
        return float(np.arctan2(-x[2], x[0]))

    def joints(self, body_x: float, height: float) -> dict[str, float]:
        """Joints of its leg for a position of the body: the ball's centre moves by radius times angle."""
        names, posture = self._robot.tree.leg(self._leg).joints, self._robot.posture("scan")
        for _ in range(12):
            rolled = 0.0 if self._turned is None else self._radius * (self.turned - self._turned)
            # The point marked by the frame rotates away from the lowest one.
            x = self._x + rolled - self._radius * np.sin(self.turned) - body_x
            sole = np.array([x, self._y, -height])
            found = self._robot.reach(self._leg, sole).joint_positions.tolist()
            posture = {**posture, **dict(zip(names, found, strict=True))}
            self.turned = self._tilt(posture) - self._level
        self._turned = self.turned if self._turned is None else self._turned
        return {name: posture[name] for name in names}

    @property
    def rolled(self) -> float:
        """Distance by which its centre has rolled [m]."""
        return self._radius * (self.turned - (self._turned or 0.0))


def test_odometry_takes_ball_feet_where_they_touch_the_ground(tmp_path: Path) -> None:
    """Standing feet of the Go2 roll by more than 4 % of the distance walked; odometry errs by less than 0.5 %."""
    try:
        new_robot(stock_urdf("go2"), tmp_path / "go2")
    except StockRobotsMissing as error:
        pytest.skip(str(error))
    robot, advance, swing = load_robot(tmp_path / "go2"), 0.03, 0.12
    odometry, order = LegOdometry(robot), ("rh", "rf", "lh", "lf")
    soles = dict(zip(robot.legs, robot.state(robot.posture("scan")).soles_in_base(), strict=True))
    height = -float(np.mean([sole[2] for sole in soles.values()]))
    feet = {
        leg: RollingFoot(robot, leg, soles[leg][0] + (number - 1.5) * advance, soles[leg][1])
        for number, leg in enumerate(order)
    }
    rolled = []
    for step in range(17):
        leg, x = order[step % 4], step * advance
        if step:
            rolled.append(feet[leg].rolled)
            feet[leg].set_down(soles[leg][0] + x + 1.5 * advance, soles[leg][1])
        joints = {name: value for foot in feet.values() for name, value in foot.joints(x, height).items()}
        result = odometry.update(Stance(joints, robot.legs, (0.0, 0.0, -1.0)))
    way = 16 * advance
    assert robot.config.sole_radius == pytest.approx(0.023, abs=1e-4)
    assert abs(np.mean(rolled[4:])) > 0.04 * (swing - advance)
    # With rubber flattened by a fifth of the radius, the contact stays within the sole.
    assert np.abs(rolled).max() + 0.2 * robot.config.sole_radius < robot.sole[0] / 2
    assert abs(result.transform_footprint_to_odom[0, 3] - way) < 0.005 * way


def test_nothing_of_theirs_is_in_the_repository() -> None:
    """No stock URDF or part of one is in the repository."""
    root = Path(__file__).parents[4]
    files = [*(root / "robots").rglob("*.urdf"), *(root / "tests").rglob("*.urdf")]
    texts = [path.read_text() for path in files]
    for name in FILES:
        try:
            stock = stock_urdf(name).read_text()
        except StockRobotsMissing as error:
            pytest.skip(str(error))
        assert all(stock[1000:1400] not in text for text in texts)
